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
        let transforms = shader != Shader::DrawStamps;
        let mut text = include_str!("shaders/common.wgsl").to_owned();
        if shader.has_coefficients() {
            text += include_str!("shaders/coefficients.wgsl");
        }
        if transforms {
            text += &fft.declarations();
        }
        text += shader.text();
        if shader.is_of_columns() {
            text += include_str!("shaders/columns.wgsl");
        }
        if shader.adds_to_panel() {
            text += include_str!("shaders/panel.wgsl");
        }
        let half = self.half();
        let threads = if transforms { fft.threads } else { DRAWING_THREADS };
        let mut fill = |name: &str, value: &str| text = text.replace(&format!("{{{{{name}}}}}"), value);
        fill("NX", &self.nx.to_string());
        fill("HALF", &half.to_string());
        fill("THREADS", &threads.to_string());
        fill("STRIP", &STRIP.to_string());
        if transforms {
            for (name, value) in parts(shader, fft) {
                fill(name, &value);
            }
        }
        text
    }
}

/// The parts of a shader that depend on the size of its transforms.
fn parts(shader: Shader, fft: &FftSource) -> Vec<(&'static str, String)> {
    let forward = fft.forward(|line, index| format!("load({line}, {index})"));
    let mut parts = vec![("REGISTERS", fft.registers("v")), ("FORWARD", forward)];
    let result =
        |text: &dyn Fn(usize, &str, &str) -> String| fft.each_result(|r| text(r.number, r.line, r.index));
    let result_back = |text: &dyn Fn(usize, &str, &str) -> String| {
        fft.each_result_back(|r| text(r.number, r.line, r.index))
    };
    let place = "first_column + line";
    let untwisted = |i: usize, _: &str, index: &str| {
        format!("planes[(into + {index}) * NX + {place}] = times(v{i}.yx, roots[UNTWIST + {index}]);")
    };
    match shader {
        Shader::WeighRows => parts.push((
            "STORE",
            result(&|i, line, index| format!("planes[(plane + {line}) * NX + {index}] = v{i};")),
        )),
        Shader::SpectrumColumns => parts.push((
            "STORE",
            result(&|i, _, index| {
                format!("spectra[(tile.spectrum * HALF + {index}) * NX + {place}] = v{i};")
            }),
        )),
        Shader::SumColumns => parts.extend([
            ("SUMS", fft.registers("sum")),
            (
                "ADD",
                result(&|i, _, index| {
                    format!("sum{i} += times(v{i}, spectra[(spectrum + {index}) * NX + {place}]);")
                }),
            ),
            ("SWAP", result(&|i, _, _| format!("v{i} = sum{i}.yx;"))),
            ("BACK", fft.back_of_swapped()),
            ("STORE", result_back(&untwisted)),
        ]),
        Shader::SpreadColumns => parts.extend([
            (
                "SPECTRUM",
                fft.registers("light") + &result(&|i, _, _| format!("light{i} = v{i};")),
            ),
            (
                "MULTIPLY",
                result(&|i, _, index| {
                    format!("v{i} = times(light{i}, spectra[(spectrum + {index}) * NX + {place}]).yx;")
                }),
            ),
            ("BACK", fft.back_of_swapped()),
            ("STORE", result_back(&untwisted)),
        ]),
        Shader::AddRows => parts.push((
            "STORE",
            result(&|i, line, index| {
                format!(
                    "add(first_row + {line}, {index}, v{i}.y);\nadd(first_row + {line} + HALF, {index}, v{i}.x);"
                )
            }),
        )),
        Shader::GatherRows => parts.extend([
            ("SUMS", fft.registers("sum")),
            (
                "ADD",
                result(&|i, line, index| {
                    format!(
                        "sum{i} += v{i}.yx * vec2f(coefficient(kernel, first_row + {line}, {index}), \
                         coefficient(kernel, first_row + {line} + HALF, {index}));"
                    )
                }),
            ),
            (
                "STORE",
                result(&|i, line, index| {
                    format!(
                        "add(first_row + {line}, {index}, sum{i}.x);\nadd(first_row + {line} + HALF, {index}, sum{i}.y);"
                    )
                }),
            ),
        ]),
        Shader::DrawStamps => {}
    }
    parts
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
