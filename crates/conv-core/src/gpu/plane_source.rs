//! Generates the source text of shaders for one size of planes.
//!
//! A *plane* is the array that a shader transforms: `nx` columns and `ny` rows of real values. The
//! upper half of the rows becomes the imaginary part of the lower half. So a plane is stored as
//! complex values in `nx` columns and `ny / 2` rows.

use super::adapter::Adapter;
use super::fft_source::FftSource;
use super::shader::{DRAWING_THREADS, STRIP, Shader};
use crate::error::GpuError;

/// The size of planes, and the division of the work on them among workgroups.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PlaneSource {
    nx: usize,
    ny: usize,
    pub(super) rows: FftSource,
    pub(super) columns: FftSource,
}

impl PlaneSource {
    /// Planes of `nx` columns, a multiple of 16, and `ny` rows, a multiple of 32, on an adapter.
    pub(super) fn new(nx: usize, ny: usize, adapter: &Adapter) -> Result<Self, GpuError> {
        let (memory, threads) = (
            adapter.workgroup_memory as usize,
            adapter.workgroup_threads as usize,
        );
        let fft = |n: usize, columns: bool| {
            FftSource::new(n, columns, memory, threads).ok_or_else(|| GpuError::TransformSize {
                adapter: adapter.name.clone(),
                size: n,
                most: FftSource::longest(memory),
            })
        };
        Ok(Self {
            nx,
            ny,
            rows: fft(nx, false)?,
            columns: fft(ny / 2, true)?,
        })
    }

    /// The number of complex values in a plane.
    pub(super) fn values(&self) -> usize {
        self.nx * self.ny / 2
    }

    /// The size of a plane in bytes.
    pub(super) fn bytes(&self) -> u64 {
        8 * self.values() as u64
    }

    pub(super) fn half(&self) -> usize {
        self.ny / 2
    }

    /// The number of workgroups for the rows of a plane.
    pub(super) fn row_groups(&self) -> u32 {
        (self.half() / self.rows.lines) as u32
    }

    pub(super) fn column_groups(&self) -> u32 {
        (self.nx / self.columns.lines) as u32
    }

    /// Roots of unity for the rows: `exp(-2 pi i m / nx)`.
    pub(super) fn row_roots(&self) -> Vec<[f32; 2]> {
        roots(self.nx, self.nx, 1.0)
    }

    /// Roots of unity for the columns, then the factors before and after transforms along y. These
    /// factors make convolutions negacyclic in y: values that wrap around change their sign. The
    /// factors are `exp(i pi y / ny)` before and `exp(-i pi y / ny) / values` after, with the
    /// number of complex [`values`](Self::values) of a plane.
    pub(super) fn column_roots(&self) -> Vec<[f32; 2]> {
        let half = self.half();
        let mut all = roots(half, half, 1.0);
        all.extend(roots(2 * self.ny, half, 1.0).iter().map(|w| [w[0], -w[1]]));
        all.extend(roots(2 * self.ny, half, self.values() as f64));
        all
    }

    /// The whole text of a shader.
    pub(super) fn text(&self, shader: Shader) -> String {
        let fft = if shader.is_of_columns() {
            &self.columns
        } else {
            &self.rows
        };
        let mut text = include_str!("shaders/common.wgsl").to_owned();
        let mut numbers = vec![("NX", self.nx), ("HALF", self.half()), ("STRIP", STRIP)];
        if shader == Shader::DrawStamps {
            numbers.push(("THREADS", DRAWING_THREADS));
        } else {
            text += include_str!("shaders/transforms.wgsl");
            numbers.extend(fft.numbers());
        }
        if shader.has_coefficients() {
            text += include_str!("shaders/coefficients.wgsl");
        }
        text += &expanded(shader.text(), fft);
        if shader.is_of_columns() {
            text += include_str!("shaders/columns.wgsl");
        }
        if shader.adds_to_panel() {
            text += include_str!("shaders/panel.wgsl");
        }
        for (name, number) in numbers {
            text = text.replace(&format!("{{{{{name}}}}}"), &number.to_string());
        }
        text
    }
}

/// Replaces the lines in double braces, which `common.wgsl` explains, by code for the size of the
/// transforms.
fn expanded(text: &str, fft: &FftSource) -> String {
    let expand = |line: &str| {
        let braced = line
            .trim()
            .strip_prefix("{{")
            .and_then(|text| text.strip_suffix("}}"));
        let (name, rest) = braced.map_or(("", line), |text| text.split_once(' ').unwrap_or((text, "")));
        match name {
            "REGISTERS" => fft.registers(rest),
            "FORWARD" => fft.forward(),
            "BACK" => fft.back_of_swapped(),
            "EACH_RESULT" => fft.each_result(rest),
            "EACH_RESULT_BACK" => fft.each_result_back(rest),
            _ => line.to_owned() + "\n",
        }
    };
    text.lines().map(expand).collect()
}

/// `exp(-2 pi i m / n)` divided by `gain`, for `m` from 0 to `count - 1`.
fn roots(n: usize, count: usize, gain: f64) -> Vec<[f32; 2]> {
    (0..count)
        .map(|m| {
            let (sin, cos) = (-std::f64::consts::TAU * m as f64 / n as f64).sin_cos();
            [(cos / gain) as f32, (sin / gain) as f32]
        })
        .collect()
}
