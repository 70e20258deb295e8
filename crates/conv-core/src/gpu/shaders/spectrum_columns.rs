//! The twin of `spectrum_columns.wgsl`.

use super::case::{Case, doubles};

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
