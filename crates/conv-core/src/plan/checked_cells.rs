//! Cells of a field that does not know them, found by checks at points.

use ndarray::{Array2, ArrayViewMut2, Axis};
use psf_types::{CoefficientField, PixelRegion, Position};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::allowed_errors::CellError;

/// Rectangles of a region in which a field's coefficients are bilinear up to an error, and the
/// coefficients at their corners.
///
/// A rectangle is halved while the coefficients at its check points differ from the bilinear function
/// through its corners by more than the limit allows. The check points are the middles of its sides,
/// its centre and one more point. These are checks at points, not a proof: details that lie between
/// all points go unnoticed. So rectangles have at most a quarter of the region's width and height, and
/// are no larger than the scale of the field.
#[derive(Debug)]
pub(crate) struct CheckedCells {
    pub(crate) rectangles: Vec<Rectangle>,
    /// The largest error, as a fraction of the limit.
    pub(crate) error: f64,
    known: KnownValues,
}

/// The limit of errors, and measures of an error of coefficients: 1 if the limit just allows it.
#[derive(Clone, Copy)]
pub(crate) struct Measure<'a> {
    pub(crate) limit: CellError,
    /// Of its size alone.
    pub(crate) of_size: &'a (dyn Fn(&[f64]) -> f64 + Sync),
    /// Of its size, and of its flux in circles if that is limited. This takes much longer.
    pub(crate) of_all: &'a (dyn Fn(&[f64]) -> f64 + Sync),
}

/// A column and a row, counted from the region's first pixel.
type Pixel = [usize; 2];

/// The first and the last pixel along x and along y. Neighbours share these pixels.
pub(crate) type Rectangle = [(usize, usize); 2];

/// The largest part of the limit that an error at a check point may have. The error elsewhere may be
/// larger.
const OF_LIMIT: f64 = 0.8;
/// The part of the limit that is left to a table of the field ([`SmoothTable`](super::smooth_table)).
pub(crate) const OF_TABLE: f64 = 0.1;
/// The number of rectangles along each axis that are checked at least.
const FEWEST: usize = 4;
/// The place of the additional check point in a rectangle. It keeps fields that repeat themselves from
/// deceiving the other points, which are evenly spaced.
const UNEVEN: [f64; 2] = [0.283, 0.381];
/// An axis is halved if the error in the middles of the sides along it is more than this fraction of the
/// largest error.
const BENDS: f64 = 0.25;
/// The number of positions that a thread evaluates together.
const TOGETHER: usize = 64;

/// Writes a field's coefficients at several positions, in parallel. Where there is no value, they are NaN.
pub(crate) fn evaluate_each(
    field: &dyn CoefficientField,
    at: &[Position],
    mut values: ArrayViewMut2<'_, f64>,
) {
    let chunks = values.axis_chunks_iter_mut(Axis(0), TOGETHER).into_par_iter();
    chunks
        .zip(at.par_chunks(TOGETHER))
        .for_each(|(values, at)| field.evaluate_each_into(at, values));
}

impl CheckedCells {
    /// Finds the cells of a field in a region. `scale` is that of
    /// [`psf_types::BilinearCells::Unknown`].
    pub(crate) fn new(
        field: &dyn CoefficientField,
        region: PixelRegion,
        (scale, measure): (f64, Measure<'_>),
    ) -> Self {
        let axis = |last: usize| {
            let step = last.div_ceil(FEWEST).min(scale as usize).max(1);
            let starts = (0..last.max(1)).step_by(step);
            starts.map(move |first| (first, (first + step).min(last)))
        };
        let [columns, rows] = last_pixel(region).map(|last| axis(last).collect::<Vec<_>>());
        let mut found = Self {
            rectangles: Vec::new(),
            error: 0.0,
            known: KnownValues::new(field.component_count()),
        };
        let all = rows.iter().flat_map(|&y| columns.iter().map(move |&x| [x, y]));
        // All rectangles of one size are checked together.
        let mut left: Vec<Rectangle> = all.collect();
        while !left.is_empty() {
            found.known.evaluate_at(field, region, &left);
            let mut parts = Vec::new();
            for sides in left {
                match found.known.check(sides, measure) {
                    Check::Bilinear(error) => {
                        found.error = found.error.max(error);
                        found.rectangles.push(sides);
                    }
                    Check::Halve(axes) => parts.extend(parts_of(sides, axes)),
                }
            }
            left = parts;
        }
        found.error = (found.error + OF_TABLE) / OF_LIMIT;
        found
    }

    /// The coefficients at a corner of a rectangle. None if the field has no value there.
    pub(crate) fn at(&self, pixel: Pixel) -> Option<&[f64]> {
        self.known.get(pixel)
    }

    /// About how many rectangles a region has. Looks at a few points.
    pub(crate) fn expected(
        field: &dyn CoefficientField,
        region: PixelRegion,
        (scale, measure): (f64, Measure<'_>),
    ) -> usize {
        let [x, y] = last_pixel(region);
        let whole = [(0, x), (0, y)];
        let mut known = KnownValues::new(field.component_count());
        known.evaluate_at(field, region, &[whole]);
        // Half the width has a quarter of the error.
        let parts = known.sizes(whole, measure).map_or(f64::INFINITY, |sizes| {
            sizes.into_iter().fold(0.0, f64::max) / OF_LIMIT
        });
        let pixels = (region.shape().nx() * region.shape().ny()) as f64;
        let fewest = ((FEWEST * FEWEST) as f64).max(pixels / scale.max(1.0).powi(2));
        // A number that is not finite becomes the number of pixels.
        (parts.max(fewest).min(pixels) as usize).max(1)
    }
}

enum Check {
    /// The largest error at the check points, as a fraction of the limit.
    Bilinear(f64),
    /// The axes to halve.
    Halve([bool; 2]),
}

/// The coefficients at pixels that were looked at.
#[derive(Debug)]
struct KnownValues {
    /// The index of a pixel's coefficients. None if the field has no value there.
    places: FxHashMap<Pixel, Option<usize>>,
    /// `[pixel, component]`.
    values: Vec<f64>,
    width: usize,
}

impl KnownValues {
    fn new(width: usize) -> Self {
        Self {
            places: FxHashMap::default(),
            values: Vec::new(),
            width,
        }
    }

    fn get(&self, at: Pixel) -> Option<&[f64]> {
        (*self.places.get(&at)?).map(|place| self.of(place))
    }

    fn of(&self, place: usize) -> &[f64] {
        &self.values[place * self.width..(place + 1) * self.width]
    }

    /// Evaluates the field at the corners and the check points of some rectangles.
    fn evaluate_at(&mut self, field: &dyn CoefficientField, region: PixelRegion, rectangles: &[Rectangle]) {
        let mut missing: Vec<Pixel> = Vec::new();
        for &sides in rectangles {
            for at in corners(sides).into_iter().chain(check_points(sides)) {
                self.places.entry(at).or_insert_with(|| {
                    missing.push(at);
                    None
                });
            }
        }
        let mut values = Array2::zeros((missing.len(), self.width));
        let at: Vec<Position> = missing.iter().map(|&[x, y]| region.position(x, y)).collect();
        evaluate_each(field, &at, values.view_mut());
        for (values, at) in values.outer_iter().zip(missing) {
            let place = self.values.len() / self.width.max(1);
            let is_known = values.iter().all(|v| v.is_finite());
            if is_known {
                self.values.extend(values);
            }
            self.places.insert(at, is_known.then_some(place));
        }
    }

    fn check(&self, sides: Rectangle, measure: Measure<'_>) -> Check {
        let can_halve = sides.map(|(first, last)| last > first + 1);
        if can_halve == [false; 2] {
            return Check::Bilinear(0.0);
        }
        let Some([along_x, along_y, inside]) = self.sizes(sides, measure) else {
            // Without a value anywhere in sight, there is nothing to divide.
            let mut points = corners(sides).into_iter().chain(check_points(sides));
            return if points.all(|at| self.get(at).is_none()) {
                Check::Bilinear(0.0)
            } else {
                Check::Halve(can_halve)
            };
        };
        let largest = along_x.max(along_y).max(inside);
        if largest + OF_TABLE <= OF_LIMIT {
            return Check::Bilinear(largest);
        }
        // Only an axis along which coefficients bend is halved.
        let halved =
            [(along_x, 0), (along_y, 1)].map(|(size, axis)| can_halve[axis] && size > BENDS * largest);
        Check::Halve(if halved == [false; 2] { can_halve } else { halved })
    }

    /// The errors at the check points, as fractions of the limit: at the middles of the sides along x,
    /// along y, and at points inside. None if the field has no value at one of these points.
    fn sizes(&self, sides: Rectangle, measure: Measure<'_>) -> Option<[f64; 3]> {
        let mut of_corners = [&[][..]; 4];
        for (values, at) in of_corners.iter_mut().zip(corners(sides)) {
            *values = self.get(at)?;
        }
        let mut sizes = [0.0_f64; 3];
        let (mut difference, mut worst) = (vec![0.0; self.width], vec![0.0; self.width]);
        let (mut largest, mut group) = (0.0, 0);
        for (i, at) in check_points(sides).into_iter().enumerate() {
            difference.copy_from_slice(self.get(at)?);
            for (weight, values) in bilinear_weights(sides, at).into_iter().zip(of_corners) {
                for (d, v) in difference.iter_mut().zip(values) {
                    *d -= weight * v;
                }
            }
            let size = (measure.of_size)(&difference);
            // A size that is not a number counts as too large.
            let size = if size.is_nan() { f64::INFINITY } else { size };
            sizes[i / 2] = sizes[i / 2].max(size);
            if size > largest {
                (largest, group) = (size, i / 2);
                worst.copy_from_slice(&difference);
            }
        }
        // The errors at the check points resemble each other.
        if largest <= 1.0 {
            sizes[group] = sizes[group].max((measure.of_all)(&worst));
        }
        Some(sizes)
    }
}

/// The weights of a rectangle's corners at a point.
fn bilinear_weights(sides: Rectangle, at: Pixel) -> [f64; 4] {
    let [s, t] = [0, 1].map(|axis| {
        let (first, last) = sides[axis];
        (at[axis] - first) as f64 / (last - first).max(1) as f64
    });
    [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t]
}

/// Left and right at the first row, then at the last.
fn corners([x, y]: Rectangle) -> [Pixel; 4] {
    [[x.0, y.0], [x.1, y.0], [x.0, y.1], [x.1, y.1]]
}

/// The middles of the sides along x, then along y, and two points inside.
fn check_points([x, y]: Rectangle) -> [Pixel; 6] {
    let middle = |(first, last): (usize, usize)| usize::midpoint(first, last);
    let part = |(first, last): (usize, usize), of: f64| first + (of * (last - first) as f64).round() as usize;
    let [mx, my] = [x, y].map(middle);
    let uneven = [part(x, UNEVEN[0]), part(y, UNEVEN[1])];
    [[mx, y.0], [mx, y.1], [x.0, my], [x.1, my], [mx, my], uneven]
}

/// The parts of a rectangle that is halved along some axes, row by row.
fn parts_of([x, y]: Rectangle, axes: [bool; 2]) -> impl Iterator<Item = Rectangle> {
    let parts = |(first, last): (usize, usize), halved: bool| {
        let middle = usize::midpoint(first, last);
        if halved {
            vec![(first, middle), (middle, last)]
        } else {
            vec![(first, last)]
        }
    };
    let (xs, ys) = (parts(x, axes[0]), parts(y, axes[1]));
    ys.into_iter()
        .flat_map(move |y| xs.clone().into_iter().map(move |x| [x, y]))
}

fn last_pixel(region: PixelRegion) -> Pixel {
    [region.shape().nx() - 1, region.shape().ny() - 1]
}
