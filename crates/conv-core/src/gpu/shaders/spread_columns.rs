//! The twin of `spread_columns.wgsl`.

use super::case::{Case, doubles};
use super::plain_transform::{back, times};

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
