// Draws single pixels of the light of tiles, each as a combination of stamps. The coefficients
// belong to the lit pixel or, if `weighted` is 1, to the pixels that its light reaches. The results
// of the tiles of one dispatch do not overlap.

// A tile whose single pixels are drawn.
struct Draw {
    // The index of its first pixel.
    first_pixel: u32,
    // The number of its pixels.
    pixels: u32,
    // The place of its first value in `amounts`.
    first_amount: u32,
    // The place of its first stamp.
    stamps: u32,
    // The number of its stamps.
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
}

// The first pixel of a stamp, counted from the result's first pixel.
struct Pixel {
    row: i32,
    column: i32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> draws: array<Draw>;
@group(0) @binding(2) var<storage, read> pixels: array<Pixel>;
// Light times coefficient, for each pixel and kernel. If `weighted` is 1, only the light of each
// pixel.
@group(0) @binding(3) var<storage, read> amounts: array<f32>;
@group(0) @binding(4) var<storage, read> stamps: array<f32>;
@group(0) @binding(5) var<storage, read> tables: array<u32>;
@group(0) @binding(6) var<storage, read_write> panel: array<f32>;

const THREADS: u32 = {{THREADS}}u;
const STRIP: u32 = {{STRIP}}u;

fn value_at(draw: Draw, n: u32, place: u32, row: u32, column: u32) -> f32 {
    let size = params.stamp_width * params.stamp_height;
    var sum = 0.0;
    if (params.weighted == 1u) {
        for (var kernel = 0u; kernel < draw.kernels; kernel++) {
            let stamp = stamps[draw.stamps + kernel * size + place];
            sum += weighted(stamp, draw.table, kernel, draw.row + row, draw.column + column);
        }
        return amounts[draw.first_amount + n] * sum;
    }
    let amount = draw.first_amount + n * draw.kernels;
    for (var kernel = 0u; kernel < draw.kernels; kernel++) {
        sum += amounts[amount + kernel] * stamps[draw.stamps + kernel * size + place];
    }
    return sum;
}

@compute @workgroup_size({{THREADS}})
fn draw_stamps(@builtin(local_invocation_index) thread: u32, @builtin(workgroup_id) group: vec3u) {
    let draw = draws[params.first + group.y];
    let first_row = i32(group.x * STRIP);
    let end_row = min(first_row + i32(STRIP), i32(draw.out_height));
    for (var n = 0u; n < draw.pixels; n++) {
        let pixel = pixels[draw.first_pixel + n];
        let top = max(first_row, pixel.row);
        let bottom = min(end_row, pixel.row + i32(params.stamp_height));
        let end = min(i32(draw.out_width), pixel.column + i32(params.stamp_width));
        // A column belongs to one thread for all stamps, so that additions to a pixel keep their
        // order.
        let start = u32(max(pixel.column, 0));
        let column_of_thread = start + (thread + THREADS - start % THREADS) % THREADS;
        for (var column = i32(column_of_thread); column < end; column += i32(THREADS)) {
            for (var row = top; row < bottom; row++) {
                var place = u32(row - pixel.row) * params.stamp_width + u32(column - pixel.column);
                if (params.flip == 1u) {
                    place = params.stamp_width * params.stamp_height - 1u - place;
                }
                let value = value_at(draw, n, place, u32(row), u32(column));
                add_to_panel(draw.out_row, draw.out_column, u32(row), u32(column), value);
            }
        }
    }
}
