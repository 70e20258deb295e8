//! The twin of each shader: a simple version in f64 that runs on the processor.

use super::case::{Case, STAMP, back, doubles, forward, times};

/// The twin of `add_rows.wgsl`.
pub(super) fn add_rows(case: &Case) -> Vec<f64> {
    let mut panel = doubles(&case.panel);
    for tile in &case.tiles {
        for row in 0..case.half() {
            let values: Vec<_> = (0..case.nx)
                .map(|column| case.complex(&case.planes, tile.plane as usize, row, column))
                .collect();
            for (column, value) in back(&values).into_iter().enumerate() {
                for (row, value) in [(row, value[0]), (row + case.half(), value[1])] {
                    if row < tile.out_height as usize && column < tile.out_width as usize {
                        let x = i64::from(tile.out_column) + column as i64;
                        let y = i64::from(tile.out_row) + row as i64;
                        case.add(&mut panel, (x, y), value * f64::from(tile.back));
                    }
                }
            }
        }
    }
    panel
}

/// The twin of `draw_stamps.wgsl`.
pub(super) fn draw_stamps(case: &Case) -> Vec<f64> {
    let mut panel = doubles(&case.panel);
    for draw in &case.draws {
        for n in 0..draw.pixels {
            let [top, left] = case.pixels[(draw.first_pixel + n) as usize];
            for j in 0..STAMP.1 {
                for i in 0..STAMP.0 {
                    let (row, column) = (top + j as i32, left + i as i32);
                    if !(0..draw.out_height as i32).contains(&row)
                        || !(0..draw.out_width as i32).contains(&column)
                    {
                        continue;
                    }
                    let stamp = |kernel: usize| {
                        let (i, j) = if case.weighted {
                            (i, j)
                        } else {
                            (STAMP.0 - 1 - i, STAMP.1 - 1 - j)
                        };
                        f64::from(case.light[draw.stamps as usize + (kernel * STAMP.1 + j) * STAMP.0 + i])
                    };
                    let amount = |n: u32| f64::from(case.amounts[(draw.first_amount + n) as usize]);
                    let (row_of_block, column_of_block) = (
                        draw.row as usize + row as usize,
                        draw.column as usize + column as usize,
                    );
                    let value: f64 = (0..draw.kernels)
                        .map(|kernel| {
                            let of_stamp = stamp(kernel as usize);
                            if !case.weighted {
                                return amount(n * draw.kernels + kernel) * of_stamp;
                            }
                            let table = draw.table as usize;
                            let kernel = kernel as usize;
                            amount(n)
                                * weighted(
                                    &case.tables,
                                    of_stamp,
                                    table,
                                    kernel,
                                    row_of_block,
                                    column_of_block,
                                )
                        })
                        .sum();
                    let place = (i64::from(draw.out_column + column), i64::from(draw.out_row + row));
                    case.add(&mut panel, place, value);
                }
            }
        }
    }
    panel
}

/// The twin of `gather_rows.wgsl`.
pub(super) fn gather_rows(case: &Case) -> Vec<f64> {
    let mut panel = doubles(&case.panel);
    for tile in &case.tiles {
        for kernel in 0..tile.kernels as usize {
            for row in 0..case.half() {
                let plane = tile.plane as usize + 1 + kernel;
                let values: Vec<_> = (0..case.nx)
                    .map(|column| case.complex(&case.planes, plane, row, column))
                    .collect();
                for (column, value) in back(&values).into_iter().enumerate() {
                    for (row, value) in [(row, value[0]), (row + case.half(), value[1])] {
                        let (Some(x), Some(y)) = (
                            column.checked_sub(tile.skip_column as usize),
                            row.checked_sub(tile.skip_row as usize),
                        ) else {
                            continue;
                        };
                        if x >= tile.out_width as usize || y >= tile.out_height as usize {
                            continue;
                        }
                        let (block_row, block_column) = (tile.row as usize + y, tile.column as usize + x);
                        let table = tile.table as usize;
                        let value = weighted(&case.tables, value, table, kernel, block_row, block_column);
                        let place = (
                            i64::from(tile.out_column) + x as i64,
                            i64::from(tile.out_row) + y as i64,
                        );
                        case.add(&mut panel, place, value * f64::from(tile.back));
                    }
                }
            }
        }
    }
    panel
}

/// The twin of `spectrum_columns.wgsl`.
pub(super) fn spectrum_columns(case: &Case) -> Vec<f64> {
    let mut spectra = doubles(&case.spectra);
    for tile in &case.tiles {
        for column in 0..case.nx {
            let spectrum = case.column(tile, tile.plane as usize, column);
            for (row, value) in spectrum.into_iter().enumerate() {
                case.set(&mut spectra, tile.spectrum as usize, row, column, value);
            }
        }
    }
    spectra
}

/// The twin of `spread_columns.wgsl`.
pub(super) fn spread_columns(case: &Case) -> Vec<f64> {
    let mut planes = doubles(&case.planes);
    for tile in &case.tiles {
        for column in 0..case.nx {
            let light = case.column(tile, tile.plane as usize, column);
            for kernel in 0..tile.kernels as usize {
                let spectrum = tile.spectrum as usize + kernel;
                let product: Vec<_> = (0..case.half())
                    .map(|row| times(light[row], case.complex(&case.spectra, spectrum, row, column)))
                    .collect();
                for (row, value) in back(&product).into_iter().enumerate() {
                    let value = times(value, case.turned_back(row));
                    case.set(&mut planes, tile.plane as usize + 1 + kernel, row, column, value);
                }
            }
        }
    }
    planes
}

/// The twin of `sum_columns.wgsl`.
pub(super) fn sum_columns(case: &Case) -> Vec<f64> {
    let mut planes = doubles(&case.planes);
    for tile in &case.tiles {
        for column in 0..case.nx {
            let mut sum = vec![[0.0; 2]; case.half()];
            for kernel in 0..tile.kernels as usize {
                let light = case.column(tile, tile.plane as usize + kernel, column);
                for (row, (sum, light)) in sum.iter_mut().zip(light).enumerate() {
                    let spectrum = tile.spectrum as usize + kernel;
                    let product = times(light, case.complex(&case.spectra, spectrum, row, column));
                    *sum = [sum[0] + product[0], sum[1] + product[1]];
                }
            }
            for (row, value) in back(&sum).into_iter().enumerate() {
                let value = times(value, case.turned_back(row));
                case.set(&mut planes, tile.plane as usize, row, column, value);
            }
        }
    }
    planes
}

/// The twin of `weigh_rows.wgsl`.
pub(super) fn weigh_rows(case: &Case) -> Vec<f64> {
    let mut planes = doubles(&case.planes);
    for tile in &case.tiles {
        let (width, height) = (tile.width as usize, tile.height as usize);
        for kernel in 0..tile.kernels as usize {
            let lit = |row: usize, column: usize| {
                if row >= height || column >= width {
                    return 0.0;
                }
                let light = |row: usize, column: usize| {
                    f64::from(case.light[tile.light as usize + row * width + column])
                };
                if !case.weighted {
                    return light(height - 1 - row, width - 1 - column);
                }
                let light = light(row, column);
                let (row, column) = (tile.row as usize + row, tile.column as usize + column);
                weighted(&case.tables, light, tile.table as usize, kernel, row, column)
            };
            // Groups of rows without light are not changed.
            for row in 0..height.min(case.half()).next_multiple_of(case.row_group) {
                let values: Vec<_> = (0..case.nx)
                    .map(|column| [lit(row, column), lit(row + case.half(), column)])
                    .collect();
                for (column, value) in forward(&values).into_iter().enumerate() {
                    case.set(&mut planes, tile.plane as usize + kernel, row, column, value);
                }
            }
        }
    }
    planes
}

const HEADER_WORDS: [&str; 6] = ["functions", "divides", "plain", "row starts", "runs", "values"];

/// A value times the coefficient of a kernel at a pixel of its block.
pub(super) fn weighted(
    tables: &[u32],
    value: f64,
    table: usize,
    kernel: usize,
    row: usize,
    column: usize,
) -> f64 {
    let words = &tables[table..];
    let header = |name: &str| {
        let place = HEADER_WORDS.iter().position(|&word| word == name);
        words[place.expect("a word of the header")] as usize
    };
    let function = |function: usize| {
        let real = |place: usize| f64::from(f32::from_bits(words[header("values") + place]));
        let starts = header("row starts") + row;
        let runs = words[starts] as usize..words[starts + 1] as usize;
        let first = |run: usize| words[header("runs") + run] as usize;
        let run = runs.rev().find(|&run| first(run) <= column);
        let run = run.expect("runs begin with the row");
        let of_run = run * (1 + 2 * header("functions"));
        let place = of_run + 1 + 2 * function;
        let after = (column - first(run)) as f64;
        (real(of_run) - after) * real(place) + after * real(place + 1)
    };
    if kernel < header("plain") {
        return value;
    }
    let product = value * function(kernel - header("plain") + header("divides"));
    if header("divides") == 1 {
        product / function(0)
    } else {
        product
    }
}
