// Code that all shaders share. Values in double braces are replaced for the sizes of a plan.

// The columns of a plane, and half its rows: the upper half of the rows is the imaginary part of
// the lower.
const NX: u32 = {{NX}}u;
const HALF: u32 = {{HALF}}u;
// The positions, among the roots of unity for columns, of the factors before and after transforms
// along y.
const TWIST: u32 = HALF;
const UNTWIST: u32 = 2u * HALF;

// A tile and the kernels that a batch applies to it. Places count values of their buffer.
struct Tile {
    // First pixel of its light, and the light's size.
    light: u32,
    width: u32,
    height: u32,
    // The numbers of its first plane and of its kernels' first spectrum, and the number of kernels.
    plane: u32,
    spectrum: u32,
    kernels: u32,
    // Its coefficients, and its first pixel within the block that they belong to.
    table: u32,
    column: u32,
    row: u32,
    // The result: first pixel within the panel, which may lie outside, size, and first pixel in the
    // plane.
    out_column: i32,
    out_row: i32,
    out_width: u32,
    out_height: u32,
    skip_column: u32,
    skip_row: u32,
    // The factor of the result.
    back: f32,
}

struct Params {
    // The first entry of the list that a dispatch processes.
    first: u32,
    // 1: the light is a stamp and is read backwards.
    flip: u32,
    // 1: the light is multiplied by the kernels' coefficients.
    weighted: u32,
    // Columns and rows of the panel, and of the stamps.
    panel_width: u32,
    panel_height: u32,
    stamp_width: u32,
    stamp_height: u32,
    unused: u32,
}
