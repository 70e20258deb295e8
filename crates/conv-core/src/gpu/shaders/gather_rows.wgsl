// For each tile, transforms the kernels' planes (all planes but the tile's first) back along x,
// multiplies them by the kernels' coefficients and adds them to the panel. Tiles do not overlap in
// the panel.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> tables: array<u32>;
@group(0) @binding(3) var<storage, read> roots: array<vec2f>;
@group(0) @binding(4) var<storage, read> planes: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> panel: array<f32>;

var<private> tile: Tile;
var<private> plane: u32;
var<private> first_row: u32;

fn load(line: u32, column: u32) -> vec2f {
    return planes[(plane * HALF + first_row + line) * NX + column].yx;
}

// Rows and columns count from the plane's first pixel. The result is a part of the plane.
fn coefficient(kernel: u32, row: u32, column: u32) -> f32 {
    let y = row - tile.skip_row;
    let x = column - tile.skip_column;
    // Also true if the difference wraps around.
    if (y >= tile.out_height || x >= tile.out_width) {
        return 0.0;
    }
    return weighted(1.0, tile.table, kernel, tile.row + y, tile.column + x);
}

fn add(row: u32, column: u32, value: f32) {
    let y = row - tile.skip_row;
    let x = column - tile.skip_column;
    if (y >= tile.out_height || x >= tile.out_width) {
        return;
    }
    add_to_panel(tile.out_row, tile.out_column, y, x, value * tile.back);
}

// The coefficients of a pixel of the lower half of the rows and of one of the upper half.
fn coefficients(kernel: u32, row: u32, column: u32) -> vec2f {
    return vec2f(coefficient(kernel, row, column), coefficient(kernel, row + HALF, column));
}

// Adds a value of the lower half of the rows and one of the upper half.
fn add_both(row: u32, column: u32, values: vec2f) {
    add(row, column, values.x);
    add(row + HALF, column, values.y);
}

@compute @workgroup_size({{THREADS}})
fn gather_rows(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let this_tile = tiles[params.first + group.y];
    tile = this_tile;
    first_row = group.x * LINES;
    {{REGISTERS v}}
    {{REGISTERS sum}}
    for (var kernel = 0u; kernel < this_tile.kernels; kernel++) {
        plane = tile.plane + 1u + kernel;
        {{FORWARD}}
        {{EACH_RESULT sum# += v#.yx * coefficients(kernel, first_row + line, index);}}
    }
    {{EACH_RESULT add_both(first_row + line, index, sum#);}}
}
