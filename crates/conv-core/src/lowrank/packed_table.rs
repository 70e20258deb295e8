//! Coefficient tables as words, for shaders.

use std::ops::Range;

use super::coefficient_table::{CoefficientTable, Values};
use crate::ConvReal;

/// Words before the table's contents: see `coefficients.wgsl`.
const HEADER: usize = 9;

impl<T: ConvReal> CoefficientTable<T> {
    /// What `coefficients.wgsl` reads of some of the kernels, in f32: a header (whether values are given pixel by pixel, number of functions,
    /// whether they are divided by the first, kernels without a function, columns, rows, and where the row starts, the first columns
    /// of runs and the values begin), then those three. Places count from the table's first word.
    pub(crate) fn packed(&self, kernels: Range<usize>) -> Vec<u32> {
        let functions = self.functions_of(kernels.clone());
        let plain = kernels
            .filter(|&kernel| self.role.function_of(kernel).is_none())
            .count();
        let (nx, ny) = (self.region.shape().nx(), self.region.shape().ny());
        let bits = |value: T| (value.as_f64() as f32).to_bits();
        let mut words = vec![0; HEADER];
        let (dense, row_starts, runs, values) = match &self.values {
            Values::Dense(values) => {
                for &function in &functions {
                    let plane = &values[function * nx * ny..(function + 1) * nx * ny];
                    words.extend(plane.iter().map(|&v| bits(v)));
                }
                (true, HEADER, HEADER, HEADER)
            }
            Values::Linear {
                row_starts,
                runs,
                ramps,
            } => {
                words.extend(row_starts);
                let first_run = words.len();
                words.extend(runs.iter().map(|run| run.0));
                let first_value = words.len();
                for of_run in ramps.chunks_exact(self.functions.max(1)) {
                    words.extend(functions.iter().flat_map(|&function| of_run[function].map(bits)));
                }
                (false, HEADER, first_run, first_value)
            }
        };
        let header = [
            usize::from(dense),
            functions.len(),
            usize::from(self.role.divides()),
            plain,
            nx,
            ny,
            row_starts,
            runs,
            values,
        ];
        for (word, value) in words.iter_mut().zip(header) {
            *word = value as u32;
        }
        words
    }

    /// The functions that some kernels need, the divisor first.
    fn functions_of(&self, kernels: Range<usize>) -> Vec<usize> {
        let divisor = self.role.divides().then_some(0);
        divisor
            .into_iter()
            .chain(kernels.filter_map(|kernel| self.role.function_of(kernel)))
            .collect()
    }
}
