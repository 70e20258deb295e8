//! The twin of `draw_stamps.wgsl`.

use super::case::{Case, STAMP, doubles};
use super::coefficients::weighted;

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
