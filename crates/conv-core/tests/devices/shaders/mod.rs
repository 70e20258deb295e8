//! Comparison of each shader with its twin.

mod case;
mod twins;

use case::Case;
use conv_core::gpu::{Adapter, GpuDevice, GpuError, ShaderTrial};

/// The relative L2 difference between a shader's result and its twin's, on artificial input with
/// planes of `nx x ny` values. Workgroups are sized for `adapter`, which may have lower limits than
/// the device's own. With `spoilt`, one of the shader's roots of unity is wrong.
pub(crate) fn error_against_twin(
    device: &GpuDevice,
    adapter: &Adapter,
    name: &str,
    planes: (usize, usize),
    spoilt: bool,
) -> Result<f64, GpuError> {
    // With coefficients, and with stamps that are turned.
    let variants: &[bool] = match name {
        "weigh_rows" | "draw_stamps" => &[true, false],
        _ => &[true],
    };
    let row_lines = ShaderTrial::row_lines(planes, adapter)?;
    let mut largest: f64 = 0.0;
    for &weighted in variants {
        let case = Case::new(planes, row_lines, name == "spectrum_columns", weighted);
        let result = run(device, adapter, name, &case, spoilt)?;
        let (expected, before) = match name {
            "weigh_rows" => (twins::weigh_rows(&case), &case.planes),
            "spectrum_columns" => (twins::spectrum_columns(&case), &case.spectra),
            "sum_columns" => (twins::sum_columns(&case), &case.planes),
            "spread_columns" => (twins::spread_columns(&case), &case.planes),
            "add_rows" => (twins::add_rows(&case), &case.panel),
            "gather_rows" => (twins::gather_rows(&case), &case.panel),
            "draw_stamps" => (twins::draw_stamps(&case), &case.panel),
            _ => panic!("{name} is not the name of a shader"),
        };
        largest = largest.max(relative_error(&result, &expected, before));
    }
    Ok(largest)
}

/// The L2 error of all values, relative to the L2 norm of the values that had to change.
fn relative_error(result: &[f32], expected: &[f64], before: &[f32]) -> f64 {
    assert_eq!(result.len(), expected.len());
    let (mut difference, mut norm) = (0.0, 0.0);
    for ((got, exact), before) in result.iter().zip(expected).zip(before) {
        difference += (f64::from(*got) - exact).powi(2);
        if *exact != f64::from(*before) {
            norm += exact * exact;
        }
    }
    assert!(norm > 0.0, "some values must change");
    (difference / norm).sqrt()
}

/// A shader's result.
fn run(
    device: &GpuDevice,
    adapter: &Adapter,
    name: &str,
    case: &Case,
    spoilt: bool,
) -> Result<Vec<f32>, GpuError> {
    let bits = |values: &[f32]| Some(values.iter().map(|v| v.to_bits()).collect::<Vec<u32>>());
    let (tiles, draws) = (Some(case.tile_words()), Some(case.draw_words()));
    let (work, tables) = (case.work(), Some(case.tables.clone()));
    let planes = bits(&case.planes);
    let (light, panel, spectra) = (bits(&case.light), bits(&case.panel), bits(&case.spectra));
    let (pixels, amounts) = (Some(case.pixel_words()), bits(&case.amounts));
    let count = match name {
        "weigh_rows" => work.len() / 2,
        "draw_stamps" => case.draws.len(),
        _ => case.tiles.len(),
    };
    let roots = None;
    let buffers = match name {
        "weigh_rows" => vec![tiles, Some(work), tables, light, roots, planes],
        "spectrum_columns" => vec![tiles, roots, planes, spectra],
        "sum_columns" | "spread_columns" => vec![tiles, roots, spectra, planes],
        "add_rows" => vec![tiles, roots, planes, panel],
        "gather_rows" => vec![tiles, tables, roots, planes, panel],
        _ => vec![draws, pixels, amounts, light, tables, panel],
    };
    let trial = ShaderTrial {
        name,
        planes: (case.nx, case.ny),
        params: case.params(),
        buffers,
        count: count as u32,
        highest: case.highest(),
        spoilt,
    };
    trial.run(device, adapter)
}
