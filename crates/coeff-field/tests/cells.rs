//! Cells of regions in which coefficients are bilinear up to an error, for every interpolator and
//! for difficult layouts of samples.

mod common;

use std::sync::Arc;

use coeff_field::{Bicubic, Bilinear, Polynomial};
use common::{Extent, at, each, field, grid, rng, samples_of};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FrameShape, OutsidePolicy, PixelRegion, Position,
};
use rand::RngExt;

/// Rounding of an interpolated value of order 1.
const ROUNDING: f64 = 1e-9;
const COMPONENTS: usize = 3;

/// The difference between the coefficients at a position and those that the corners of its cell
/// give. `None` if a corner has no value.
fn difference(
    field: &dyn CoefficientField,
    [x, y]: [(f64, f64); 2],
    p: Position,
) -> Option<[f64; COMPONENTS]> {
    let at_corner = |x: f64, y: f64| {
        let mut values = [0.0; COMPONENTS];
        field.evaluate_into(at(x, y), &mut values).ok().map(|()| values)
    };
    let part = |(low, high): (f64, f64), v: f64| if low < high { (v - low) / (high - low) } else { 0.0 };
    let (s, t) = (part(x, p.x()), part(y, p.y()));
    let mut sum = at_corner(p.x(), p.y())?.map(|v| -v);
    for (x, y, weight) in [
        (x.0, y.0, (1.0 - s) * (1.0 - t)),
        (x.1, y.0, s * (1.0 - t)),
        (x.0, y.1, (1.0 - s) * t),
        (x.1, y.1, s * t),
    ] {
        for (sum, value) in sum.iter_mut().zip(at_corner(x, y)?) {
            *sum += weight * value;
        }
    }
    Some(sum)
}

/// The cell of a coordinate: the last line at or before it and the first one after it, or the ends of
/// the region.
fn cell(lines: &[f64], (first, last): (f64, f64), v: f64) -> (f64, f64) {
    let before = lines.iter().copied().filter(|&line| line <= v && line > first);
    let after = lines.iter().copied().filter(|&line| line > v && line <= last);
    (before.fold(first, f64::max), after.fold(last, f64::min))
}

/// Returns the sides of the cells that hold a position.
type CellsAt<'a> = Box<dyn Fn(Position) -> Vec<[(f64, f64); 2]> + 'a>;

/// The size of the largest difference at the pixels of a region, less the error that the cells
/// promise, and the number of cells. `None` if the region has neither lines nor rectangles, or no
/// value at some corner.
fn largest_difference(
    field: &Arc<dyn CoefficientField>,
    region: PixelRegion,
    limit: ErrorLimit<'_>,
) -> Option<(f64, usize)> {
    let last = region.position(region.shape().nx() - 1, region.shape().ny() - 1);
    let ends = [(region.x0() as f64, last.x()), (region.y0() as f64, last.y())];
    let (cells_at, count, achieved): (CellsAt<'_>, usize, f64) = match field.bilinear_cells(region, limit) {
        BilinearCells::Lines { x, y, error } => {
            let count = (x.len() + 1) * (y.len() + 1);
            let at = move |p: Position| vec![[cell(&x, ends[0], p.x()), cell(&y, ends[1], p.y())]];
            (Box::new(at), count, error)
        }
        BilinearCells::Rectangles(all) => {
            let count = all.len();
            let area: f64 = all.iter().map(|[x, y]| (x.1 - x.0) * (y.1 - y.0)).sum();
            let whole = (ends[0].1 - ends[0].0) * (ends[1].1 - ends[1].0);
            assert!(
                (area - whole).abs() < ROUNDING * (1.0 + whole),
                "{area} of {whole}"
            );
            let at = move |p: Position| {
                let contains =
                    |[x, y]: &[(f64, f64); 2]| x.0 <= p.x() && p.x() <= x.1 && y.0 <= p.y() && p.y() <= y.1;
                all.iter().copied().filter(contains).collect()
            };
            (Box::new(at), count, 0.0)
        }
        _ => return None,
    };
    assert!(achieved <= limit.size, "{achieved} of {limit:?}");
    let mut largest: f64 = 0.0;
    for row in 0..region.shape().ny() {
        for column in 0..region.shape().nx() {
            let p = region.position(column, row);
            let cells = cells_at(p);
            assert!(!cells.is_empty(), "no cell holds {p}");
            for sides in cells {
                let difference = difference(field.as_ref(), sides, p)?;
                largest = largest.max(limit.product(&difference, &difference).sqrt() - achieved);
            }
        }
    }
    Some((largest, count))
}

/// The largest size of the difference between the coefficients in bands and those that the first
/// and the last row of a band give. Bands whose first and last row have runs of other lengths are
/// left out. `None` if the region has no bands, or no value somewhere.
fn largest_difference_in_bands(field: &Arc<dyn CoefficientField>, region: PixelRegion) -> Option<f64> {
    let BilinearCells::Bands(lines) = field.bilinear_cells(region, ErrorLimit::ZERO) else {
        return None;
    };
    let (nx, ny) = (region.shape().nx(), region.shape().ny());
    let band_of = |row: usize| {
        lines
            .iter()
            .filter(|&&line| line <= (region.y0() + row as i64) as f64)
            .count()
    };
    let ends_of_runs = |row: usize| {
        let mut ends = Vec::new();
        let mut column = 0;
        let weighted = field.weighted_nodes().expect("a method with few weights");
        weighted
            .weights_along_row((region.x0(), region.y0() + row as i64), nx, &mut |run| {
                ends.push((column, column + run.length - 1));
                column += run.length;
            })
            .ok()
            .map(|()| ends)
    };
    let value = |column, row| {
        let mut values = [0.0; COMPONENTS];
        let at = region.position(column, row);
        field.evaluate_into(at, &mut values).ok().map(|()| values)
    };
    let mut largest: f64 = 0.0;
    let mut first = 0;
    while first < ny {
        let last = (first..ny)
            .take_while(|&row| band_of(row) == band_of(first))
            .last()?;
        let runs = ends_of_runs(first)?;
        if runs == ends_of_runs(last)? {
            for row in first..=last {
                let part = (row - first) as f64 / (last - first).max(1) as f64;
                for column in runs.iter().flat_map(|&(start, end)| [start, end]) {
                    let (low, high) = (value(column, first)?, value(column, last)?);
                    for (k, v) in value(column, row)?.iter().enumerate() {
                        largest = largest.max((v - (1.0 - part) * low[k] - part * high[k]).abs());
                    }
                }
            }
        }
        first = last + 1;
    }
    Some(largest)
}

fn region(x: i64, y: i64, nx: usize, ny: usize) -> PixelRegion {
    PixelRegion::new(x, y, FrameShape::new(nx, ny).unwrap())
}

#[test]
fn coefficients_are_bilinear_in_cells_up_to_the_error() {
    let mut checked = 0;
    each(|layout, name, positions, method| {
        let extent = Extent::of(positions);
        if extent.size() > 300.0 {
            return;
        }
        let mut rng = rng(3);
        let noise: Vec<[f64; COMPONENTS]> = positions.iter().map(|_| rng.random()).collect();
        let value = |p: Position, k: usize| noise[positions.iter().position(|q| *q == p).unwrap()][k];
        for outside in [
            OutsidePolicy::Nearest,
            OutsidePolicy::Extend,
            OutsidePolicy::Error,
        ] {
            let field = field(&samples_of(positions, COMPONENTS, value), method, outside);
            for _ in 0..8 {
                let corner =
                    |low: f64, rng: &mut rand_chacha::ChaCha8Rng| low as i64 + rng.random_range(-30..60);
                let (x, y) = (corner(extent.low.0, &mut rng), corner(extent.low.1, &mut rng));
                let region = region(x, y, rng.random_range(1..40), rng.random_range(1..40));
                if let Some(largest) = largest_difference_in_bands(&field, region) {
                    assert!(
                        largest < ROUNDING,
                        "{layout} {name} {outside} {region:?} in bands: {largest:e}"
                    );
                }
                for (size, flux) in [(0.0, &[][..]), (1e-6, &[]), (1e-2, &[5.0, -3.0, 0.1]), (0.3, &[])] {
                    let limit = ErrorLimit { size, flux };
                    if let Some((largest, _)) = largest_difference(&field, region, limit) {
                        checked += 1;
                        assert!(
                            largest < ROUNDING,
                            "{layout} {name} {outside} {region:?} {limit:?}: {largest:e}"
                        );
                    }
                }
            }
        }
    });
    assert!(checked > 1000, "{checked}");
}

#[test]
fn smooth_fields_have_few_cells() {
    let positions = grid(21, 21, 10.0, 0.0, 0.0);
    let parabola = |p: Position, k: usize| (p.x() * p.x() + (k + 1) as f64 * p.y()) * 1e-6;
    let samples = samples_of(&positions, COMPONENTS, parabola);
    let region = region(0, 0, 201, 201);
    let limit = |size| ErrorLimit { size, flux: &[] };
    for (method, error, cells) in [
        (&Bilinear as &dyn coeff_field::FieldInterpolation, 1.0, 441),
        (&Bicubic, 0.0, 101 * 101),
        (&Bicubic, 5e-5, 41 * 21),
        (&Bicubic, 1e-3, 441),
        (&Polynomial::new(2).unwrap(), 1.0, 1),
        (&Polynomial::new(0).unwrap(), 0.0, 1),
    ] {
        let field = field(&samples, method, OutsidePolicy::Extend);
        let found = largest_difference(&field, region, limit(error)).unwrap();
        assert!(
            found.0 < ROUNDING && found.1 <= cells,
            "{method:?} {error}: {found:?}"
        );
    }
    // A parabola needs cells whose squared width falls with the error.
    let field = field(&samples, &Polynomial::new(2).unwrap(), OutsidePolicy::Extend);
    let cells = |error| largest_difference(&field, region, limit(error)).unwrap().1;
    let (coarse, fine) = (cells(1e-3), cells(1e-5));
    assert!(coarse > 1 && fine > 7 * coarse, "{coarse} {fine}");
}
