// Computes the spectra of kernels: transforms planes along y, after their transform along x.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(0) @binding(2) var<storage, read> roots: array<vec2f>;
@group(0) @binding(3) var<storage, read> planes: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> spectra: array<vec2f>;

@compute @workgroup_size({{THREADS}})
fn spectrum_columns(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    // Each tile has one kernel here.
    tile = tiles[params.first + group.y];
    plane = tile.plane;
    first_column = group.x * LINES;
    {{REGISTERS v}}
    {{FORWARD}}
    let spectrum = tile.spectrum * HALF;
    {{EACH_RESULT spectra[(spectrum + index) * NX + first_column + line] = v#;}}
}
