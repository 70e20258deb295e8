//! The twin of `weigh_rows.wgsl`.

use super::case::{Case, doubles};
use super::coefficients::weighted;
use super::plain_transform::forward;

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
            // Groups of rows without light are left alone.
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
