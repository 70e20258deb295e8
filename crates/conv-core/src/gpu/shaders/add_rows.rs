//! The twin of `add_rows.wgsl`.

use super::case::{Case, doubles};
use super::plain_transform::back;

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
