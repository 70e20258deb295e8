
// Transforms of several lines (rows or columns of a plane) by one workgroup.

const THREADS: u32 = {{THREADS}}u;
const LINES: u32 = {{LINES}}u;
var<workgroup> shared_values: array<vec2f, {{SHARED}}>;

// The place in the shared memory of a line's value.
fn slot(line: u32, index: u32) -> u32 {
    let place = line * {{LINE_STEP}}u + index * {{INDEX_STEP}}u;
    // One place in nine is empty if PADDED is 1.
    return place + {{PADDED}}u * (place >> 3u);
}

fn times(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

// The value times -i.
fn turned(a: vec2f) -> vec2f {
    return vec2f(a.y, -a.x);
}

