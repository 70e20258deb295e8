// Code that all shaders share. Names in double braces are replaced by numbers for the sizes of a
// plan. A line in double braces is replaced by code: a name, and what it applies to.
//
// REGISTERS v: declares the registers v0, v1 ... of a thread, set to zero.
// FORWARD: transforms values in the registers v. `load(line, index)` gives the values.
// BACK: transforms the results of a forward transform back, from the registers where they are. Real
//   and imaginary parts must be swapped before, and are swapped in the result.
// EACH_RESULT: a statement for each result of the forward transform on a line (a row or column of
//   the plane) at an index along it. `#` stands for the number of its register.
// EACH_RESULT_BACK: a statement for each result of a transform back.

// The columns of a plane, and half its rows: the upper half of the rows is the imaginary part of
// the lower.
const NX: u32 = {{NX}}u;
const HALF: u32 = {{HALF}}u;
// The roots of unity for columns are followed by the factors before transforms along y, from index
// TWIST, and by the factors after them, from index UNTWIST.
const TWIST: u32 = HALF;
const UNTWIST: u32 = 2u * HALF;

// A tile and the kernels that a batch applies to it. Places are indices of values in their buffers.
struct Tile {
    // The place of its light's first pixel.
    light: u32,
    // The size of its light.
    width: u32,
    height: u32,
    // The index of its first plane.
    plane: u32,
    // The index of its kernels' first spectrum.
    spectrum: u32,
    // The number of its kernels.
    kernels: u32,
    // The place of its coefficients' table.
    table: u32,
    // Its first pixel within the block of the table.
    column: u32,
    row: u32,
    // The result's first pixel, counted from the panel's first pixel, and the result's size. The
    // result may reach beyond the panel.
    out_column: i32,
    out_row: i32,
    out_width: u32,
    out_height: u32,
    // The first pixel of the result in the plane.
    skip_column: u32,
    skip_row: u32,
    // The factor by which the result is multiplied.
    back: f32,
}

struct Params {
    // The index of the first tile, plane or draw that a dispatch processes.
    first: u32,
    // 1: stamps are read backwards. In weigh_rows, the light is then a stamp.
    flip: u32,
    // 1: the kernels' coefficients multiply the light (in weigh_rows) or stamps (in draw_stamps).
    weighted: u32,
    // Columns and rows of the panel, and of the stamps.
    panel_width: u32,
    panel_height: u32,
    stamp_width: u32,
    stamp_height: u32,
    unused: u32,
}
