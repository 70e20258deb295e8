// Transforms the first plane of each tile back along x and adds the result to the panel. The
// results of the tiles of one dispatch do not overlap.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> roots: array<vec2f>;
@group(0) @binding(3) var<storage, read> planes: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> panel: array<f32>;

var<private> tile: Tile;
var<private> first_row: u32;

fn load(line: u32, column: u32) -> vec2f {
    return planes[(tile.plane * HALF + first_row + line) * NX + column].yx;
}

fn add(row: u32, column: u32, value: f32) {
    if (row >= tile.out_height || column >= tile.out_width) {
        return;
    }
    add_to_panel(tile.out_row, tile.out_column, row, column, value * tile.back);
}

// Adds a value of the lower half of the rows and one of the upper half.
fn add_both(row: u32, column: u32, values: vec2f) {
    add(row, column, values.x);
    add(row + HALF, column, values.y);
}

@compute @workgroup_size({{THREADS}})
fn add_rows(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let this_tile = tiles[params.first + group.y];
    tile = this_tile;
    first_row = group.x * LINES;
    // All threads return together, because barriers follow.
    if (group.x * LINES >= min(this_tile.out_height, HALF)) {
        return;
    }
    {{REGISTERS v}}
    {{FORWARD}}
    {{EACH_RESULT add_both(first_row + line, index, v#.yx);}}
}
