// Multiplies light by coefficients, if `weighted` is 1, and transforms it along x. The result is
// one plane for each entry of `work`, [row of the lower half][x frequency].

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
// The tile and the kernel of each plane.
@group(0) @binding(2) var<storage, read> work: array<vec2u>;
@group(0) @binding(3) var<storage, read> tables: array<u32>;
@group(0) @binding(4) var<storage, read> light: array<f32>;
@group(0) @binding(5) var<storage, read> roots: array<vec2f>;
@group(0) @binding(6) var<storage, read_write> planes: array<vec2f>;

var<private> tile: Tile;
var<private> kernel: u32;
var<private> first_row: u32;

fn lit(row: u32, column: u32) -> f32 {
    if (row >= tile.height || column >= tile.width) {
        return 0.0;
    }
    if (params.flip == 1u) {
        return light[tile.light + (tile.height - 1u - row) * tile.width + tile.width - 1u - column];
    }
    let value = light[tile.light + row * tile.width + column];
    if (params.weighted == 0u) {
        return value;
    }
    return weighted(value, tile.table, kernel, tile.row + row, tile.column + column);
}

fn load(line: u32, column: u32) -> vec2f {
    let row = first_row + line;
    return vec2f(lit(row, column), lit(row + HALF, column));
}

@compute @workgroup_size({{THREADS}})
fn weigh_rows(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let entry = work[params.first + group.y];
    let this_tile = tiles[entry.x];
    tile = this_tile;
    kernel = entry.y;
    first_row = group.x * LINES;
    // Rows without light are not transformed. All threads return together, because barriers follow.
    if (group.x * LINES >= min(this_tile.height, HALF)) {
        return;
    }
    let plane = (tile.plane + kernel) * HALF + first_row;
    {{REGISTERS v}}
    {{FORWARD}}
    {{EACH_RESULT planes[(plane + line) * NX + index] = v#;}}
}
