//! Draws the wings of many bright sources together, by transforms.
//!
//! As in [`spread`](super::spread), each source is spread over a few pixels of planes, and the planes are
//! convolved with the stamps of the wings. Here the frame is cut into few large tiles, because stamps are large.
//! The light that reaches a tile is convolved at once, so a tile does not depend on others.

use ndarray::{Array2, ArrayViewMut2};
use psf_types::{FrameShape, PixelRegion, Progress};

use super::draw::Group;
use super::phases::{PhasedAxis, PhasedStar};
use super::row_layout::RowLayout;
use crate::fft2::RealFft2;
use crate::overlap::{add_values, shared};
use crate::stamp_interpolator::MOST_TAPS;
use crate::view::region;
use crate::working_range::Rescaling;
use crate::{ConvError, ConvReal};

/// Transforms have at most so many rows and columns, or twice those of the stamps.
const LARGEST: usize = 9000;
/// Sources brighter than the median by this factor are drawn one by one. The rounding noise of a transform in
/// single precision, in the pixels around a source, is about 1e-12 of the light of the brightest source.
const CONTRAST: f64 = 1e8;
/// Seconds of one core for each value of a plane and its transform, and for each pixel, stamp and tap of a source
/// that is drawn, in single precision. Measured with 4 stamps of 4095 pixels on a frame of 4096 x 4096.
const TRANSFORM: f64 = 1.2e-8;
const DRAW: f64 = 1.5e-10;

/// The division of a frame into tiles, and the sizes of the planes of a tile.
pub(super) struct WingTransform<'a> {
    axes: &'a [PhasedAxis; 2],
    layout: RowLayout,
    modes: usize,
    /// Columns and rows of a tile.
    tile: [usize; 2],
    /// Columns and rows of a stamp, in pixels of the frame.
    kernel: [usize; 2],
    frame: FrameShape,
}

impl<'a> WingTransform<'a> {
    pub(super) fn new(axes: &'a [PhasedAxis; 2], layout: RowLayout, modes: usize, frame: FrameShape) -> Self {
        let kernel = axes.each_ref().map(|axis| axis.kept.div_ceil(axis.oversampling));
        let side = |length: usize, kernel: usize| {
            let fits = |&side: &usize| side + kernel <= LARGEST.max(2 * kernel);
            let sides = (1..=length).map(|count| length.div_ceil(count));
            sides.clone().find(fits).unwrap_or(1)
        };
        Self {
            axes,
            layout,
            modes,
            tile: [side(frame.nx(), kernel[0]), side(frame.ny(), kernel[1])],
            kernel,
            frame,
        }
    }

    fn residues(&self) -> usize {
        self.axes[0].oversampling * self.axes[1].oversampling
    }

    /// Returns whether transforms are faster than drawing sources on so many pixels one by one.
    pub(super) fn pays<T: ConvReal>(&self, pixels: f64) -> bool {
        let tiles = self.frame.nx().div_ceil(self.tile[0]) * self.frame.ny().div_ceil(self.tile[1]);
        let values = (self.tile[0] + self.kernel[0]) * (self.tile[1] + self.kernel[1]);
        let transforms = 2 * self.modes * self.residues() + 1;
        let taps = self.axes[0].kernel.tap_count();
        let products = taps * (self.modes * self.axes[0].oversampling.min(taps) + 1);
        let precision = size_of::<T>() as f64 / size_of::<f32>() as f64;
        let transform = TRANSFORM * (tiles * transforms * values) as f64;
        transform * precision < DRAW * precision * pixels * products as f64
    }

    /// Adds the light of sources to the part of the image that holds the pixels of `region`. `values` are the
    /// stamps' coefficients `[row, mode, value of a row]`.
    pub(super) fn add_to<T: ConvReal>(
        &self,
        (values, groups): (&[T], &[Group<T>]),
        region_of_image: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let [nx, ny] = self.tile;
        let origin = (region_of_image.x0(), region_of_image.y0());
        for y in (0..self.frame.ny()).step_by(ny) {
            for x in (0..self.frame.nx()).step_by(nx) {
                let tile = region(x as i64, y as i64, (nx, ny));
                if shared(tile, region_of_image).is_some() {
                    let light = self.tile_light((values, groups), (x as i64, y as i64), progress)?;
                    add_values(
                        light.view(),
                        (x as i64 - origin.0, y as i64 - origin.1),
                        &mut image,
                    );
                }
            }
        }
        Ok(())
    }

    /// The light of sources in the tile that begins at `first`.
    fn tile_light<T: ConvReal>(
        &self,
        (values, groups): (&[T], &[Group<T>]),
        first: (i64, i64),
        progress: &dyn Progress,
    ) -> Result<Array2<T>, ConvError> {
        let ([nx, ny], [kx, ky]) = (self.tile, self.kernel);
        let fft = RealFft2::<T>::at_least(ny + ky - 1, nx + kx - 1, progress);
        let (mut sum, mut of_light, mut of_stamp) = (fft.zeros(), fft.zeros(), fft.zeros());
        // The planes begin where the light of the tile's first pixel may come from.
        let corner = (first.0 - (kx as i64 - 1), first.1 - (ky as i64 - 1));
        let mut plane = Array2::zeros((ny + ky - 1, nx + kx - 1));
        for number in 0..self.modes * self.residues() {
            progress.check_cancelled()?;
            plane.fill(T::zero());
            self.spread(groups, number, corner, &mut plane);
            fft.forward(plane.view(), (0, 0), &mut of_light);
            fft.forward(self.coefficients(values, number).view(), (0, 0), &mut of_stamp);
            ndarray::Zip::from(&mut sum)
                .and(&of_light)
                .and(&of_stamp)
                .par_for_each(|sum, a, b| *sum += a * b);
        }
        drop((of_light, of_stamp, plane));
        let mut light = fft.inverse(&mut sum, (kx - 1, ky - 1), (ny, nx))?;
        let gain = T::nearest(1.0 / fft.gain());
        light.par_mapv_inplace(|v| v * gain);
        Ok(light)
    }

    /// The mode, and the residues along x and y, of a plane.
    fn place(&self, number: usize) -> (usize, [usize; 2]) {
        let [x, y] = self.axes;
        let (residue_x, rest) = (number % x.oversampling, number / x.oversampling);
        (rest / y.oversampling, [residue_x, rest % y.oversampling])
    }

    /// The coefficients of a stamp with the residues of a plane, `[y, x]`.
    fn coefficients<T: ConvReal>(&self, values: &[T], number: usize) -> Array2<T> {
        let ([x, y], (mode, residues)) = (self.axes, self.place(number));
        let [kx, ky] = self.kernel;
        Array2::from_shape_fn((ky, kx), |(row, column)| {
            let row = row * y.oversampling + residues[1];
            let column = column * x.oversampling + residues[0];
            if row >= y.kept || column >= x.kept {
                return T::zero();
            }
            let line = (row * self.modes + mode) * self.layout.kernel;
            values[line + self.layout.index_of(column, x.oversampling)]
        })
    }

    /// Adds the taps of sources to a plane that begins at `corner`.
    fn spread<T: ConvReal>(
        &self,
        groups: &[Group<T>],
        number: usize,
        corner: (i64, i64),
        plane: &mut Array2<T>,
    ) {
        let ([x, y], (mode, residues)) = (self.axes, self.place(number));
        let taps = x.kernel.tap_count().min(MOST_TAPS);
        for group in groups {
            for star in &group.stars {
                let weights = &group.weights[star.weights.clone()];
                for (tap, weights) in weights.chunks_exact(self.modes).enumerate() {
                    let at = star.first_row + tap;
                    let row = star.rows.start - (at / y.oversampling) as i64 - corner.1;
                    if at % y.oversampling != residues[1] || !(0..plane.nrows() as i64).contains(&row) {
                        continue;
                    }
                    for (i, &of_tap) in star.taps[..taps].iter().enumerate() {
                        let at = star.first_column + i;
                        let column = star.columns.start - (at / x.oversampling) as i64 - corner.0;
                        if at % x.oversampling == residues[0] && (0..plane.ncols() as i64).contains(&column) {
                            plane[[row as usize, column as usize]] += weights[mode] * of_tap;
                        }
                    }
                }
            }
        }
    }
}

/// Divides sources into those that are drawn together, and those that are too bright for it.
pub(super) fn divided<T: ConvReal>(groups: Vec<Group<T>>) -> (Vec<Group<T>>, Vec<Group<T>>) {
    let brightness = |group: &Group<T>, star: &PhasedStar<T>| {
        let weights = &group.weights[star.weights.clone()];
        weights
            .iter()
            .fold(0.0, |most: f64, w| most.max(w.as_f64().abs()))
    };
    let of_group = |group: &Group<T>| {
        group
            .stars
            .iter()
            .map(|star| brightness(group, star))
            .collect::<Vec<_>>()
    };
    let mut all: Vec<f64> = groups.iter().flat_map(of_group).collect();
    let Some(middle) = all.len().checked_sub(1).map(|last| last / 2) else {
        return (groups, Vec::new());
    };
    let (_, &mut median, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
    let limit = CONTRAST * median;
    let is_safe =
        |limit: f64| limit.is_finite() && limit > 0.0 && Rescaling::<T>::for_largest(limit).is_none();
    if !is_safe(limit) {
        return (Vec::new(), groups);
    }
    let part = |group: Group<T>| {
        let is_faint = |star: &PhasedStar<T>| brightness(&group, star) <= limit;
        let stars = group.stars.iter().cloned();
        let (faint, bright): (Vec<_>, Vec<_>) = stars.partition(is_faint);
        let with = |stars| Group {
            stars,
            weights: group.weights.clone(),
        };
        (with(faint), with(bright))
    };
    groups.into_iter().map(part).unzip()
}
