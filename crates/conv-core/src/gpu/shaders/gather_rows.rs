//! The twin of `gather_rows.wgsl`.

use super::case::{Case, doubles};
use super::coefficients::weighted;
use super::plain_transform::back;

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
