//! Each shader's twin on the processor, in f64 and as plain as can be, and the comparison of both.

mod add_rows;
mod case;
mod coefficients;
mod draw_stamps;
mod gather_rows;
mod plain_transform;
mod spectrum_columns;
mod spread_columns;
mod sum_columns;
mod weigh_rows;

use std::sync::mpsc::channel;

use case::Case;
use pulp::bytemuck::cast_slice;

use super::buffers::STORAGE;
use super::passes::{Calls, params_buffer};
use super::plane_source::PlaneSource;
use super::shader::{STRIP, Shader};
use super::{Adapter, GpuDevice, GpuError};

/// The names of the shaders.
pub fn names() -> impl Iterator<Item = &'static str> {
    Shader::ALL.iter().map(|shader| shader.name())
}

/// How far a shader's result on made-up input, with planes of `nx x ny` values, is from its twin's: relative L2. Workgroups are sized for
/// `adapter`, which may be less than the device's own. With `spoilt`, one of the roots of unity that the shader is given is wrong.
///
/// # Errors
/// [`GpuError`] where the GPU cannot do it.
///
/// # Panics
/// For a name that is not a shader's.
pub fn error_against_twin(
    device: &GpuDevice,
    adapter: &Adapter,
    name: &str,
    (nx, ny): (usize, usize),
    spoilt: bool,
) -> Result<f64, GpuError> {
    let shader = Shader::ALL.iter().find(|shader| shader.name() == name);
    let shader = *shader.expect("the name of a shader");
    let source = PlaneSource::new(nx, ny, adapter)?;
    // With coefficients, and with stamps that are turned.
    let variants: &[bool] = match shader {
        Shader::WeighRows | Shader::DrawStamps => &[true, false],
        _ => &[true],
    };
    let mut largest: f64 = 0.0;
    for &weighted in variants {
        let case = Case::new(
            (nx, ny),
            source.rows.lines,
            shader == Shader::SpectrumColumns,
            weighted,
        );
        let result = run(device, source.clone(), shader, &case, spoilt)?;
        let (expected, before) = match shader {
            Shader::WeighRows => (weigh_rows::weigh_rows(&case), &case.planes),
            Shader::SpectrumColumns => (spectrum_columns::spectrum_columns(&case), &case.spectra),
            Shader::SumColumns => (sum_columns::sum_columns(&case), &case.planes),
            Shader::SpreadColumns => (spread_columns::spread_columns(&case), &case.planes),
            Shader::AddRows => (add_rows::add_rows(&case), &case.panel),
            Shader::GatherRows => (gather_rows::gather_rows(&case), &case.panel),
            Shader::DrawStamps => (draw_stamps::draw_stamps(&case), &case.panel),
        };
        largest = largest.max(relative_error(&result, &expected, before));
    }
    Ok(largest)
}

/// The relative L2 error of what there was to change; where nothing was, any change is an error.
fn relative_error(result: &[f32], expected: &[f64], before: &[f32]) -> f64 {
    assert_eq!(result.len(), expected.len());
    let (mut difference, mut norm) = (0.0, 0.0);
    for ((got, exact), before) in result.iter().zip(expected).zip(before) {
        difference += (f64::from(*got) - exact).powi(2);
        if *exact != f64::from(*before) {
            norm += exact * exact;
        }
    }
    assert!(norm > 0.0, "there is something to do");
    (difference / norm).sqrt()
}

/// A shader's result.
fn run(
    device: &GpuDevice,
    source: PlaneSource,
    shader: Shader,
    case: &Case,
    spoilt: bool,
) -> Result<Vec<f32>, GpuError> {
    let device = &device.attempt()?;
    let mut roots = if shader.is_of_columns() {
        source.column_roots()
    } else {
        source.row_roots()
    };
    if spoilt {
        roots[1] = [roots[1][0], -roots[1][1]];
    }
    let (row_groups, column_groups) = (source.row_groups(), source.column_groups());
    let pipelines = device.pipelines(source)?;
    let reals = |label, values: &[f32]| device.filled(label, cast_slice(values));
    let roots = reals("roots", roots.as_flattened());
    let tiles = device.filled("tiles", &case.tile_words());
    let work = device.filled("work", &case.work());
    let tables = device.filled("tables", &case.tables);
    let light = reals("light", &case.light);
    let planes = reals("planes", &case.planes);
    let spectra = reals("spectra", &case.spectra);
    let panel = reals("panel", &case.panel);
    let draws = device.filled("draws", &case.draw_words());
    let pixels = device.filled("pixels", &case.pixel_words());
    let amounts = reals("amounts", &case.amounts);
    let count = case.tiles.len() as u32;
    let (buffers, groups, length) = match shader {
        Shader::WeighRows => (
            vec![&tiles, &work, &tables, &light, &roots, &planes],
            (row_groups, (case.work().len() / 2) as u32),
            case.planes.len(),
        ),
        Shader::SpectrumColumns => (
            vec![&tiles, &roots, &planes, &spectra],
            (column_groups, count),
            case.spectra.len(),
        ),
        Shader::SumColumns | Shader::SpreadColumns => (
            vec![&tiles, &roots, &spectra, &planes],
            (column_groups, count),
            case.planes.len(),
        ),
        Shader::AddRows => (
            vec![&tiles, &roots, &planes, &panel],
            (row_groups, count),
            case.panel.len(),
        ),
        Shader::GatherRows => (
            vec![&tiles, &tables, &roots, &planes, &panel],
            (row_groups, count),
            case.panel.len(),
        ),
        Shader::DrawStamps => (
            vec![&draws, &pixels, &amounts, &light, &tables, &panel],
            (case.highest().div_ceil(STRIP as u32), case.draws.len() as u32),
            case.panel.len(),
        ),
    };
    let mut params = params_buffer();
    let mut calls = Calls::new(device, &pipelines, &mut params, 1);
    calls.add(shader, case.params(), &buffers, groups);
    let mut encoder = device.encoder();
    calls.encode(&mut encoder, None);
    let bytes = 4 * length as u64;
    let read = device.buffer(
        "result",
        bytes,
        STORAGE.difference(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC)
            | wgpu::BufferUsages::MAP_READ,
    );
    let result = buffers[buffers.len() - 1];
    encoder.copy_buffer_to_buffer(result, 0, &read, 0, Some(bytes));
    let submission = device.queue().submit([encoder.finish()]);
    let (sender, mapped) = channel();
    read.slice(..bytes).map_async(wgpu::MapMode::Read, move |result| {
        // Nobody listens any more after an error.
        let _ = sender.send(result);
    });
    device.wait(submission)?;
    let mapped = mapped.recv();
    let mapped = mapped.map_err(|error| device.failed(&error))?;
    mapped.map_err(|error| device.failed(&error))?;
    let view = read.slice(..bytes).get_mapped_range();
    let view = view.map_err(|error| device.failed(&error))?;
    Ok(cast_slice(&view).to_vec())
}
