//! The twin of `sum_columns.wgsl`.

use super::case::{Case, doubles};
use super::plain_transform::{back, times};

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
