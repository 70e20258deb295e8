// Transforms the planes of each tile along y, after their transform along x. Multiplies them by the
// kernels' spectra, sums them over the kernels, and transforms the sum back along y into the tile's
// first plane.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> roots: array<vec2f>;
@group(0) @binding(3) var<storage, read> spectra: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> planes: array<vec2f>;

@compute @workgroup_size({{THREADS}})
fn sum_columns(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let this_tile = tiles[params.first + group.y];
    tile = this_tile;
    first_column = group.x * LINES;
    {{REGISTERS v}}
    {{REGISTERS sum}}
    for (var kernel = 0u; kernel < this_tile.kernels; kernel++) {
        plane = tile.plane + kernel;
        let spectrum = (tile.spectrum + kernel) * HALF;
        {{FORWARD}}
        {{EACH_RESULT sum# += times(v#, spectra[(spectrum + index) * NX + first_column + line]);}}
    }
    {{EACH_RESULT v# = sum#.yx;}}
    {{BACK}}
    let into = tile.plane * HALF;
    // All threads must have read the first plane, which is part of the sum, before it is
    // overwritten.
    storageBarrier();
    {{EACH_RESULT_BACK planes[(into + index) * NX + first_column + line] = times(v#.yx, roots[UNTWIST + index]);}}
}
