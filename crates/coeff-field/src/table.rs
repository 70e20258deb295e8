//! Fields in tables: any smooth field, stored as values at nodes.

use std::sync::Arc;

use ndarray::{ArrayView1, ArrayView2, ArrayViewMut2, Axis};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, EvaluateField, FieldError, FieldTable, Interpolation,
    OutsidePolicy, PixelRegion, Position, SampleCoefficients, SamplePositions, TableLimits,
};
use rayon::prelude::*;

use crate::error::CoeffFieldError;
use crate::interpolation::{FieldInterpolation, Interpolated, admit};

/// The interpolation between the nodes of a table: a polynomial of degree 4 in x times one in y on each
/// patch ([`FieldTable`]).
///
/// It is for nodes that [`tabulate`] returned. They replace the samples.
///
/// # Outside the table
/// The table covers the frame and the samples.
/// * Nearest: the value at the nearest point of this rectangle.
/// * Extend: linear, with the slope at this point.
/// * Error: returns an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Table {
    columns: usize,
    rows: usize,
}

impl Table {
    /// A table with these numbers of undivided patches in a row and in a column.
    ///
    /// # Errors
    /// [`CoeffFieldError::Parameter`] for a number outside 1 to 1024.
    pub fn new(columns: usize, rows: usize) -> Result<Self, CoeffFieldError> {
        match [columns, rows]
            .iter()
            .find(|n| !(1..=FieldTable::MOST_PATCHES).contains(*n))
        {
            Some(&wrong) => Err(CoeffFieldError::Parameter {
                name: "the number of patches of a table along an axis",
                allowed: "1 to 1024",
                got: wrong as f64,
            }),
            None => Ok(Self { columns, rows }),
        }
    }
}

impl FieldInterpolation for Table {
    fn interpolate(&self, nodes: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        let positions = nodes.positions();
        CoeffFieldError::unless_one_state(positions)?;
        let counts = [self.columns, self.rows];
        let table = FieldTable::from_nodes(positions.as_slice(), nodes.values(), counts);
        let table = table.ok_or(CoeffFieldError::NotATable {
            nodes: positions.len(),
            columns: self.columns,
            rows: self.rows,
        })?;
        Ok(Arc::new(TableField { table, outside }))
    }
}

#[derive(Debug)]
struct TableField {
    table: FieldTable,
    outside: OutsidePolicy,
}

/// Positions up to this distance outside the table count as inside (pixels).
const EDGE: f64 = 1e-9;

impl CoefficientField for TableField {
    fn component_count(&self) -> usize {
        self.table.component_count()
    }

    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        let [x, y] = self.table.bounds();
        let inside = [position.x().clamp(x.0, x.1), position.y().clamp(y.0, y.1)];
        let off = [position.x() - inside[0], position.y() - inside[1]];
        let distance = off[0].hypot(off[1]);
        admit(distance <= EDGE, self.outside, position)?;
        let write = |[x, y]: [f64; 2], values: &mut [f64]| {
            let at = Position::new(x, y).expect("a point of the table");
            assert!(self.table.write(at, values), "a table has values everywhere");
        };
        write(inside, coefficients);
        if distance > EDGE && self.outside == OutsidePolicy::Extend {
            // One pixel inwards, or across the table if that is less.
            let step = 1.0_f64.min(x.1 - x.0).min(y.1 - y.0);
            let inner = [0, 1].map(|axis| inside[axis] - off[axis] / distance * step);
            let inner = [inner[0].clamp(x.0, x.1), inner[1].clamp(y.0, y.1)];
            let mut of_inner = vec![0.0; coefficients.len()];
            write(inner, &mut of_inner);
            for (value, inner) in coefficients.iter_mut().zip(of_inner) {
                *value += (*value - inner) * (distance / step);
            }
        }
        Ok(())
    }

    /// In a patch, a polynomial bends once or twice.
    fn bilinear_cells(&self, region: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
        let last = region.position(region.shape().nx() - 1, region.shape().ny() - 1);
        let sides = [(region.x0() as f64, last.x()), (region.y0() as f64, last.y())];
        BilinearCells::Unknown {
            scale: 0.5 * self.table.smallest_patch(sides),
            slow: false,
        }
    }
}

/// The settings of [`tabulate`].
#[derive(Clone, Copy)]
pub struct TableOptions<'a> {
    /// The size of an error of coefficients, such as the relative L2 error of the PSF.
    pub size: &'a (dyn Fn(&[f64]) -> f64 + Sync),
    /// The largest size of errors.
    pub limit: f64,
    /// The positions of the samples. The table covers them and their frame, if it is known.
    pub samples: &'a SamplePositions,
}

impl std::fmt::Debug for TableOptions<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { limit, samples, .. } = self;
        f.debug_struct("TableOptions")
            .field("limit", limit)
            .field("samples", samples)
            .finish_non_exhaustive()
    }
}

/// The smallest number of patches along the longer and along the shorter side of the area.
const FEWEST: [f64; 2] = [8.0, 2.0];
/// Patches with a side of at most this many pixels are not divided. The nodes are then half a pixel
/// apart.
const SMALLEST: f64 = 2.0;
/// Values fill at most about this memory.
const MOST_BYTES: usize = 1 << 28;

/// Tabulates a field that a function evaluates. Returns the nodes of the table and the interpolation
/// between them.
///
/// The function writes the `width` coefficients at positions, `[position, component]`. It is called a few
/// times on this thread, each time with many positions.
///
/// The error is checked at six points of every patch: details that lie between all points go unnoticed.
///
/// ```
/// use coeff_field::{TableOptions, interpolation, tabulate};
/// use psf_types::{FrameShape, OutsidePolicy, Position, SamplePositions};
/// let frame = FrameShape::new(100, 80)?;
/// let samples = SamplePositions::new(vec![Position::of_pixel(50, 40)], Some(frame))?;
/// let size = |error: &[f64]| error[0].abs();
/// let options = TableOptions { size: &size, limit: 1e-6, samples: &samples };
/// let (nodes, method) = tabulate(
///     1,
///     &mut |at, mut values| {
///         for (position, value) in at.iter().zip(&mut values) {
///             *value = (0.05 * position.x()).sin();
///         }
///         Ok(())
///     },
///     options,
/// )?;
/// let field = interpolation(method)?.interpolate(&nodes, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::new(33.3, 21.0)?, &mut value)?;
/// assert!((value[0] - (0.05_f64 * 33.3).sin()).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Errors of the function, and [`CoeffFieldError::TooRough`] for a field that needs more memory than 256
/// MiB, or smaller patches than 2 pixels.
pub fn tabulate(
    width: usize,
    evaluate: EvaluateField<'_, CoeffFieldError>,
    options: TableOptions<'_>,
) -> Result<(SampleCoefficients, Interpolation), CoeffFieldError> {
    let positions = options.samples;
    let mut area = positions.as_slice().to_vec();
    if let Some(frame) = positions.field() {
        let region = frame.region();
        area.extend([
            region.position(0, 0),
            region.position(frame.nx() - 1, frame.ny() - 1),
        ]);
    }
    let [x, y] = Position::bounds(&area);
    let corners = [Position::new(x.0, y.0)?, Position::new(x.1, y.1)?];
    let sides = [(x.1 - x.0).max(1.0), (y.1 - y.0).max(1.0)];
    let (longer, shorter) = (sides[0].max(sides[1]), sides[0].min(sides[1]));
    let step = (longer / FEWEST[0])
        .min(shorter / FEWEST[1])
        .max(longer / FieldTable::MOST_PATCHES as f64);
    let counts = sides.map(|side| (side / step).ceil() as usize);
    let limits = TableLimits {
        counts,
        most_divisions: 16,
        smallest: SMALLEST,
        most_values: MOST_BYTES / size_of::<f64>(),
    };
    let fits_at = |difference: ArrayView1<'_, f64>| {
        (options.size)(difference.as_slice().expect("row-major")) <= options.limit
    };
    let mut fits = |differences: ArrayView2<'_, f64>| {
        let patches = differences
            .axis_chunks_iter(Axis(0), FieldTable::CHECKS)
            .into_par_iter();
        patches.map(|checks| checks.outer_iter().all(fits_at)).collect()
    };
    let table = FieldTable::new(corners, width, limits, evaluate, &mut fits)?;
    let (at, values) = table.nodes();
    if let Some(position) = table.missing() {
        let (limit, nodes) = (options.limit, at.len());
        return Err(CoeffFieldError::TooRough {
            limit,
            nodes,
            position,
        });
    }
    let positions = SamplePositions::new(at, positions.field())?;
    let nodes = SampleCoefficients::new(values.to_owned(), positions)?;
    let [columns, rows] = counts;
    Ok((nodes, Interpolation::Table { columns, rows }))
}

/// The number of positions that a thread evaluates together.
const TOGETHER: usize = 64;

/// Tabulates a field ([`tabulate`]), in parallel.
///
/// # Errors
/// The errors of [`tabulate`], and [`CoeffFieldError::NoValue`] if the field has no value somewhere on the
/// frame.
pub fn tabulate_field(
    field: &dyn CoefficientField,
    options: TableOptions<'_>,
) -> Result<(SampleCoefficients, Interpolation), CoeffFieldError> {
    let width = field.component_count();
    let mut evaluate = |at: &[Position], mut values: ArrayViewMut2<'_, f64>| {
        let chunks = values.axis_chunks_iter_mut(Axis(0), TOGETHER).into_par_iter();
        chunks
            .zip(at.par_chunks(TOGETHER))
            .for_each(|(values, at)| field.evaluate_each_into(at, values));
        let rows = at.iter().zip(values.outer_iter());
        match rows
            .into_iter()
            .find(|(_, row)| row.iter().any(|v| !v.is_finite()))
        {
            None => Ok(()),
            Some((&position, _)) => {
                field.evaluate_into(position, &mut vec![0.0; width])?;
                let source = "the interpolation returned a value that is not finite".into();
                Err(CoeffFieldError::from(FieldError::External { position, source }))
            }
        }
    };
    tabulate(width, &mut evaluate, options)
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use psf_types::FrameShape;

    use super::*;
    use crate::choice::interpolation;

    /// A field that is not linear in anything.
    #[derive(Debug)]
    struct Waves;

    impl CoefficientField for Waves {
        fn component_count(&self) -> usize {
            2
        }
        fn evaluate_into(&self, at: Position, a: &mut [f64]) -> Result<(), FieldError> {
            a[0] = (0.02 * at.x()).sin() + (0.01 * at.y()).exp();
            a[1] = (1.0 + 0.01 * at.x()).sqrt();
            Ok(())
        }
    }

    fn samples() -> SamplePositions {
        let frame = FrameShape::new(300, 200).unwrap();
        SamplePositions::new(vec![Position::of_pixel(20, 30)], Some(frame)).unwrap()
    }

    fn length(d: &[f64]) -> f64 {
        d.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    #[test]
    fn a_table_holds_a_field_up_to_its_error() {
        let samples = samples();
        let options = |limit| TableOptions {
            size: &length,
            limit,
            samples: &samples,
        };
        let mut counts = Vec::new();
        for limit in [1e-3, 1e-6, 1e-9] {
            let (nodes, method) = tabulate_field(&Waves, options(limit)).unwrap();
            counts.push(nodes.positions().len());
            let field = interpolation(method)
                .unwrap()
                .interpolate(&nodes, OutsidePolicy::Error)
                .unwrap();
            let (mut a, mut b) = ([0.0; 2], [0.0; 2]);
            for i in 0..2000 {
                let at = Position::new(0.1495 * f64::from(i), f64::from(i * 37 % 1990) * 0.1).unwrap();
                field.evaluate_into(at, &mut a).unwrap();
                Waves.evaluate_into(at, &mut b).unwrap();
                let error = length(&[a[0] - b[0], a[1] - b[1]]);
                assert!(error <= 2.0 * limit, "{at}: {error:e} of {limit:e}");
            }
            assert!(field.evaluate_into(Position::of_pixel(-1, 0), &mut a).is_err());
        }
        assert!(counts[0] < counts[2] && counts[2] < 60_000, "{counts:?}");
    }

    #[test]
    fn a_table_is_continued_outside() {
        let samples = samples();
        let options = TableOptions {
            size: &length,
            limit: 1e-8,
            samples: &samples,
        };
        let (nodes, method) = tabulate_field(&Waves, options).unwrap();
        let value = |outside, x: f64, y: f64| {
            let field = interpolation(method)
                .unwrap()
                .interpolate(&nodes, outside)
                .unwrap();
            let mut a = [0.0; 2];
            field.evaluate_into(Position::new(x, y).unwrap(), &mut a).unwrap();
            a
        };
        let near = |a: [f64; 2], b: [f64; 2], by: f64| (a[0] - b[0]).hypot(a[1] - b[1]) < by;
        let edge = value(OutsidePolicy::Nearest, 299.0, 40.0);
        assert_eq!(value(OutsidePolicy::Nearest, 340.0, 40.0), edge);
        let extended = value(OutsidePolicy::Extend, 300.0, 40.0);
        let inner = value(OutsidePolicy::Extend, 298.0, 40.0);
        assert!(near(
            extended,
            [2.0 * edge[0] - inner[0], 2.0 * edge[1] - inner[1]],
            1e-12
        ));
        // The slope changes slowly from place to place.
        assert!(near(
            value(OutsidePolicy::Extend, 299.5, 199.6),
            value(OutsidePolicy::Extend, 299.5, 199.4),
            0.02
        ));
    }

    #[test]
    fn a_field_that_jumps_is_refused() {
        let samples = samples();
        let options = TableOptions {
            size: &length,
            limit: 1e-4,
            samples: &samples,
        };
        let mut step = |at: &[Position], mut values: ArrayViewMut2<'_, f64>| {
            for (p, v) in at.iter().zip(&mut values) {
                *v = f64::from(u8::from(p.x() > 77.3));
            }
            Ok(())
        };
        let error = tabulate(1, &mut step, options).unwrap_err().to_string();
        assert!(error.contains("too rough near (7"), "{error}");
        let positions = SamplePositions::new(vec![Position::of_pixel(0, 0), Position::of_pixel(5, 7)], None);
        let others = SampleCoefficients::new(Array2::zeros((2, 1)), positions.unwrap()).unwrap();
        let error = Table::new(2, 2)
            .unwrap()
            .interpolate(&others, OutsidePolicy::Nearest)
            .unwrap_err();
        assert!(error.to_string().contains("not the nodes of a table"), "{error}");
    }
}
