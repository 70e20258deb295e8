// Transforms the first plane of each tile along y, after its transform along x. Then, for each
// kernel, multiplies the result by the kernel's spectrum and transforms it back along y into the
// kernel's plane. The kernels' planes follow the first plane.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> roots: array<vec2f>;
@group(0) @binding(3) var<storage, read> spectra: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> planes: array<vec2f>;

@compute @workgroup_size({{THREADS}})
fn spread_columns(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let this_tile = tiles[params.first + group.y];
    tile = this_tile;
    plane = tile.plane;
    first_column = group.x * LINES;
    {{REGISTERS v}}
    {{REGISTERS light}}
    {{FORWARD}}
    {{EACH_RESULT light# = v#;}}
    for (var kernel = 0u; kernel < this_tile.kernels; kernel++) {
        let spectrum = (tile.spectrum + kernel) * HALF;
        let into = (tile.plane + 1u + kernel) * HALF;
        {{EACH_RESULT v# = times(light#, spectra[(spectrum + index) * NX + first_column + line]).yx;}}
        {{BACK}}
        {{EACH_RESULT_BACK planes[(into + index) * NX + first_column + line] = times(v#.yx, roots[UNTWIST + index]);}}
    }
}
