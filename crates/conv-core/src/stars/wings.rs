//! Draws the wings of sources ([`Wings`]): their faint light far from the source.
//!
//! Wings are large and vary slowly, so the whole field is one block whose kernels are the few stamps of the
//! wings. Each source is drawn on the pixels where its light exceeds the floor. Without a floor, or where
//! bright sources are many, transforms draw all sources together ([`WingTransform`]).

use std::cmp::Ordering;
use std::sync::{Arc, OnceLock};

use ndarray::{Array2, ArrayView1, ArrayViewMut2, Axis};
use psf_types::{
    DataError, FrameShape, PixelRegion, PointSource, Position, Progress, PsfModel, StampGrid, Wings,
};
use rayon::prelude::*;

use super::draw::{DrawGroup, Group};
use super::painter::{target_of, window_of};
use super::phases::{PhasedAxis, PhasedStar, Star};
use super::reach::{AtCorners, LEAST_LIGHT, Reach};
use super::row_layout::{CHUNK, RowLayout};
use super::wing_transform::{WingTransform, divided};
use crate::dropped_light::DroppedLight;
use crate::galaxies::{ExtendedSources, representative_points};
use crate::kept::get_or_make;
use crate::overlap::{Piece, shared};
use crate::simd::{Aligned, Lanes, WithIsa};
use crate::sources::check_stamps;
use crate::stamp_interpolator::{Kernel, StampInterpolator};
use crate::view::region;
use crate::{ConvError, ConvReal};

/// Sources that are prepared together.
const AT_ONCE: usize = 1 << 12;
/// Bands of an image that are drawn at the same time have at least so many rows.
const LEAST_BAND: usize = 64;
/// An image is divided into so many bands.
const BANDS: usize = 8;

/// Draws wings. A clone shares the stamps.
#[derive(Debug, Clone)]
pub(crate) struct WingDrawer<T> {
    wings: Wings,
    field_shape: Option<FrameShape>,
    /// The grid of the stamps that are drawn. Its oversampling is a whole number.
    grid: StampGrid,
    axes: [PhasedAxis; 2],
    layout: RowLayout,
    /// The pixels that a source may light, relative to its own pixel.
    window: PixelRegion,
    floor: f64,
    /// Wings are drawn at least within the radius of this part of their light.
    least_light: f64,
    may_transform: bool,
    /// `[row, mode, value of a row]`, made when first needed.
    values: Arc<OnceLock<Aligned<T>>>,
    /// `None` if all sources are drawn on all pixels.
    reach: Arc<OnceLock<Option<Reach>>>,
}

/// A point whose wings are drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WingPoint {
    pub(crate) source: PointSource,
    /// The source of which the point is a part. It decides the PSF, and how far the wings are drawn.
    pub(crate) of: PointSource,
}

impl From<&PointSource> for WingPoint {
    fn from(source: &PointSource) -> Self {
        Self {
            source: *source,
            of: *source,
        }
    }
}

impl<T: ConvReal> WingDrawer<T> {
    /// A drawer of a model's wings. None if the model has none. `may_transform` says whether sources may be
    /// drawn together by transforms.
    pub(crate) fn new(
        model: &PsfModel,
        size: Option<usize>,
        floor: f64,
        may_transform: bool,
    ) -> Result<Option<Self>, ConvError> {
        let Some(wings) = model.wings() else {
            return Ok(None);
        };
        check_stamps(wings.grid(), size)?;
        let grid = whole_oversampling(wings.grid()).map_err(ConvError::Result)?;
        let kernel = Kernel::of(grid.interpolation(), 0);
        let target = target_of(grid, kernel, size).map_err(ConvError::Result)?;
        let window = window_of(target);
        let axes =
            PhasedAxis::both(grid, kernel, window).ok_or(ConvError::Result(DataError::WingsDoNotFit))?;
        Ok(Some(Self {
            wings: wings.clone(),
            field_shape: model.field_shape(),
            grid,
            layout: RowLayout::new(&axes[0]),
            axes,
            window,
            floor,
            least_light: least_light(model),
            may_transform: may_transform && size.is_none(),
            values: Arc::default(),
            reach: Arc::default(),
        }))
    }

    /// A drawer of other wings with the same stamps.
    pub(crate) fn for_other_field(&self, wings: &Wings) -> Self {
        Self {
            wings: wings.clone(),
            reach: Arc::default(),
            ..self.clone()
        }
    }

    /// The coefficients of the stamps.
    fn values(&self) -> &[T] {
        get_or_make(&self.values, || self.new_values()).get()
    }

    fn new_values(&self) -> Aligned<T> {
        let (modes, length) = (self.wings.mode_count(), self.layout.kernel);
        let [columns, rows] = &self.axes;
        let mut values = Aligned::zeros(rows.kept * modes * length);
        let column = self.layout.columns(columns);
        // One stamp after the other, because they are large.
        for (mode, stamp) in self.wings.stamps().axis_iter(Axis(0)).enumerate() {
            let coefficients = if self.grid == self.wings.grid() {
                columns.kernel.coefficients(stamp)
            } else {
                let stamp = StampInterpolator::new(stamp.mapv(f64::from).view(), self.wings.grid());
                columns
                    .kernel
                    .coefficients(stamp.resample((0.0, 0.0), self.grid).view())
            };
            let of_rows = values.get_mut().par_chunks_mut(modes * length);
            of_rows.enumerate().for_each(|(row, to)| {
                let Some(j) = rows.index(row) else { return };
                let from = coefficients.row(j);
                for (to, column) in to[mode * length..(mode + 1) * length].iter_mut().zip(&column) {
                    *to = column.map_or(T::zero(), |i| T::nearest(from[i]));
                }
            });
        }
        values
    }

    fn reach(&self) -> Option<&Reach> {
        if self.floor <= 0.0 {
            return None;
        }
        let make = || {
            let coefficients = self.wings.field().some_coefficients(self.field_shape);
            let corners = AtCorners {
                coefficients: coefficients.view(),
                scales: &vec![1.0; coefficients.nrows()],
            };
            let floor = (self.floor, self.least_light);
            Reach::new(floor, self.values(), &corners, (&self.axes, self.layout))
        };
        get_or_make(&self.reach, make).as_ref()
    }

    /// Adds the light of wings that is dropped at most.
    pub(crate) fn add_dropped(
        &self,
        points: &[WingPoint],
        frame: PixelRegion,
        dropped: &mut DroppedLight,
    ) -> Result<(), ConvError> {
        let Some(reach) = self.reach() else {
            return Ok(());
        };
        let mut unlit = Vec::new();
        let mut others = Vec::new();
        let mut coefficients = vec![0.0; self.wings.mode_count()];
        let whole = frame.shape().region();
        for point in points {
            let star = Star::new(&point.source, frame);
            if !star.reaches(self.window, whole) {
                continue;
            }
            let of = Star::new(&point.of, frame);
            let excess = self.excess(reach, &of, &mut coefficients)?;
            let (flux, level) = (star.flux.abs() * excess, reach.level_of(of.flux.abs() * excess));
            match level {
                Some(0) => unlit.push((star.pixel, flux)),
                Some(level) => others.push((star.pixel, flux, level)),
                None => {}
            }
        }
        reach.add_dropped_of_all(&unlit, 0, dropped);
        dropped.add_all(others.len(), |dropped, some| {
            for &(pixel, flux, level) in &others[some] {
                reach.add_dropped_beside_core(pixel, flux, level, dropped);
            }
        });
        Ok(())
    }

    fn excess(&self, reach: &Reach, star: &Star, coefficients: &mut [f64]) -> Result<f64, ConvError> {
        let position = Position::new(star.position.0, star.position.1).map_err(ConvError::Result)?;
        self.wings.field().evaluate_into(position, coefficients)?;
        Ok(reach.excess(coefficients, 1.0))
    }

    /// Adds the wings of points to a part of an image, whose rows are contiguous in memory.
    pub(crate) fn draw_into(
        &self,
        points: &[WingPoint],
        (frame, region): (PixelRegion, PixelRegion),
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        T::dispatch(DrawWings {
            drawer: self,
            points,
            frame,
            region,
            image,
            progress,
        })
    }

    /// The points whose wings may light the frame, with their phases and weights, in an order that does not
    /// depend on that of the catalogue. Only those that reach the region must have a PSF.
    fn prepared(
        &self,
        points: &[WingPoint],
        (frame, region): (PixelRegion, PixelRegion),
        progress: &dyn Progress,
    ) -> Result<Vec<Group<T>>, ConvError> {
        let whole = frame.shape().region();
        // Made once, before threads need it.
        self.reach();
        let mut stars: Vec<(Star, Star)> = points
            .par_iter()
            .map(|point| (Star::new(&point.source, frame), Star::new(&point.of, frame)))
            .filter(|(star, _)| star.reaches(self.window, whole))
            .collect();
        stars.par_sort_unstable_by(|(a, of_a), (b, of_b)| {
            let phases = |star: &Star| star.phase_numbers(&self.axes);
            let values = |star: &Star| [star.position.1, star.position.0, star.flux];
            let of_both = |star, of| values(star).into_iter().chain(values(of));
            let pairs = of_both(a, of_a).zip(of_both(b, of_b));
            let by_value = pairs.map(|(a, b)| a.total_cmp(&b));
            phases(a)
                .cmp(&phases(b))
                .then(by_value.fold(Ordering::Equal, Ordering::then))
        });
        stars
            .par_chunks(AT_ONCE)
            .map(|some| {
                progress.check_cancelled()?;
                self.group(some, region)
            })
            .collect()
    }

    fn group(&self, stars: &[(Star, Star)], region: PixelRegion) -> Result<Group<T>, ConvError> {
        let modes = self.wings.mode_count();
        let taps = self.axes[1].kernel.tap_count();
        let reach = self.reach();
        let mut coefficients = vec![0.0; modes];
        let mut group = Group {
            stars: Vec::new(),
            weights: Vec::new(),
        };
        for (star, of) in stars {
            let Some([columns, rows]) = star.phases(&self.axes) else {
                continue;
            };
            let position = Position::new(of.position.0, of.position.1).map_err(ConvError::Result)?;
            match self.wings.field().evaluate_into(position, &mut coefficients) {
                // Only sources that reach the region need a PSF.
                Err(_) if !star.reaches(self.window, region) => continue,
                found => found?,
            }
            let level =
                reach.and_then(|reach| reach.level_of(of.flux.abs() * reach.excess(&coefficients, 1.0)));
            // All light of the faintest level is below the floor.
            if level == Some(0) && self.least_light <= 0.0 {
                continue;
            }
            let first = group.weights.len();
            for tap in &rows.weights[..taps] {
                let weights = coefficients.iter().map(|c| T::nearest(tap * c * star.flux));
                group.weights.extend(weights);
            }
            let weights = first..group.weights.len();
            let phases = ([columns, rows], self.axes[0].oversampling);
            group.stars.push(star.phased(phases, level, weights));
        }
        Ok(group)
    }

    /// The number of pixels of the frame on which stars are drawn one by one.
    fn drawn_pixels(&self, groups: &[Group<T>], frame: PixelRegion) -> f64 {
        let whole = frame.shape().region();
        let of_star = |star: &PhasedStar<T>| {
            let part = star
                .level
                .map_or(1.0, |level| self.reach().map_or(1.0, |reach| reach.part(level)));
            let lit = region(
                star.columns.start,
                star.rows.start,
                (
                    (star.columns.end - star.columns.start) as usize,
                    (star.rows.end - star.rows.start) as usize,
                ),
            );
            let area = shared(lit, whole).map_or(0, |[(x, _), (y, _)]| x.len() * y.len());
            part * area as f64
        };
        groups.iter().flat_map(|group| &group.stars).map(of_star).sum()
    }
}

/// The work of [`WingDrawer::draw_into`].
struct DrawWings<'a, T> {
    drawer: &'a WingDrawer<T>,
    points: &'a [WingPoint],
    frame: PixelRegion,
    region: PixelRegion,
    image: ArrayViewMut2<'a, T>,
    progress: &'a dyn Progress,
}

impl<T: ConvReal> WithIsa<T> for DrawWings<'_, T> {
    type Output = Result<(), ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let (drawer, frame, region, progress) = (self.drawer, self.frame, self.region, self.progress);
        let mut groups = drawer.prepared(self.points, (frame, region), progress)?;
        let modes = drawer.wings.mode_count();
        if drawer.may_transform {
            // The choice does not depend on the region.
            let transform = WingTransform::new(&drawer.axes, drawer.layout, modes, frame.shape());
            let pixels = drawer.drawn_pixels(&groups, frame);
            if transform.pays::<T>(pixels) {
                let (together, bright) = divided(groups);
                transform.add_to(
                    (drawer.values(), &together),
                    region,
                    self.image.view_mut(),
                    progress,
                )?;
                groups = bright;
            }
        }
        if groups.iter().all(|group| group.stars.is_empty()) {
            return Ok(());
        }
        let values = drawer.values();
        let band = region.shape().ny().div_ceil(BANDS).max(LEAST_BAND);
        let bands: Vec<_> = self
            .image
            .axis_chunks_iter_mut(Axis(0), band)
            .enumerate()
            .collect();
        bands.into_par_iter().try_for_each(|(number, mut rows)| {
            let first = (region.x0(), region.y0() + (number * band) as i64);
            let draw = DrawGroup {
                axes: &drawer.axes,
                layout: drawer.layout,
                values,
                kernels: modes,
                reach: drawer.reach(),
                region: crate::view::region(first.0, first.1, (rows.ncols(), rows.nrows())),
                progress,
            };
            let margin = CHUNK as i64;
            let mut tile = Piece {
                first: (first.0 - margin, first.1),
                values: Array2::zeros((rows.nrows(), rows.ncols() + CHUNK)),
            };
            for group in &groups {
                progress.check_cancelled()?;
                draw.draw_on(simd, group, &mut tile)?;
            }
            tile.add_to(&mut rows, first);
            Ok(())
        })
    }
}

/// The part of the wings' light that is always drawn, so that 90 % of the whole light is. 0 if the core holds
/// more.
fn least_light(model: &PsfModel) -> f64 {
    let sum = |coefficients: &Array2<f64>, fluxes: &[f64]| -> f64 {
        let of_row = |row: ArrayView1<'_, f64>| row.iter().zip(fluxes).map(|(a, f)| a * f).sum::<f64>();
        coefficients.outer_iter().map(of_row).sum::<f64>() / coefficients.nrows().max(1) as f64
    };
    let Some(wings) = model.wings() else { return 0.0 };
    let fluxes = wings.stamp_fluxes();
    let of_wings = sum(&wings.field().some_coefficients(model.field_shape()), &fluxes);
    let first = usize::from(model.is_mean_centred());
    let mean: f64 = model.stamp_fluxes()[..first].iter().sum();
    let of_core = if model.needs_flux_scaling() {
        1.0
    } else {
        mean + sum(&model.some_coefficients(), &model.stamp_fluxes()[first..])
    };
    let missing = LEAST_LIGHT * (of_core + of_wings) - of_core;
    if of_wings > 0.0 {
        (missing / of_wings).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// A grid with a whole oversampling that covers a stamp.
fn whole_oversampling(grid: StampGrid) -> Result<StampGrid, DataError> {
    let (s, finer) = (grid.oversampling(), grid.oversampling().ceil());
    if s == finer {
        return Ok(grid);
    }
    let half =
        |centre: f64, pixels: usize| (centre.max((pixels - 1) as f64 - centre) * finer / s).ceil() as usize;
    let halves = [half(grid.centre_x(), grid.nx()), half(grid.centre_y(), grid.ny())];
    let made = StampGrid::new(2 * halves[0] + 1, 2 * halves[1] + 1)?.with_oversampling(finer)?;
    Ok(made
        .with_pixel_response_included(grid.pixel_response_included())
        .with_interpolation(grid.interpolation()))
}

/// The points whose wings are drawn for stars and extended sources. An extended source that is small is one
/// point.
pub(crate) fn wing_points(
    stars: &[PointSource],
    extended: ExtendedSources<'_>,
) -> Result<Vec<WingPoint>, ConvError> {
    /// The radius of most of the light of a source that is one point, in pixels.
    const SMALL: f64 = 1.0;
    /// The part of the light that may lie outside.
    const OUTSIDE: f64 = 0.1;
    let mut points: Vec<WingPoint> = stars.iter().map(WingPoint::from).collect();
    let of_source = |(index, source): (usize, &PointSource)| -> Result<Vec<WingPoint>, ConvError> {
        let light = (extended.light)(index);
        if light.flux_beyond(SMALL) <= OUTSIDE {
            return Ok(vec![source.into()]);
        }
        let offsets = representative_points(&*light);
        let (at, count) = (source.position(), offsets.len() as f64);
        let point = |(dx, dy): (f64, f64)| {
            let position = Position::new(at.x() + dx, at.y() + dy)?;
            Ok(WingPoint {
                source: PointSource::new(position, source.flux() / count)?,
                of: *source,
            })
        };
        offsets
            .into_iter()
            .map(point)
            .collect::<Result<_, DataError>>()
            .map_err(ConvError::Result)
    };
    let of_extended: Vec<Vec<WingPoint>> = extended
        .points
        .par_iter()
        .enumerate()
        .map(of_source)
        .collect::<Result<_, _>>()?;
    points.extend(of_extended.into_iter().flatten());
    Ok(points)
}
