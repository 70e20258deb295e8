//! Resamples a PSF to other pixels, and removes the response of a scene's pixel.

use std::ops::Range;

use conv_core::{ScenePixelFilter, StampInterpolator, edge_reach, grid_with_pixel_response, native_grid};
use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use psf_types::{
    Anchor, FrameShape, Position, PsfBasis, PsfModelRecord, PsfSamples, SampleCoefficients, SamplePositions,
    StampGrid,
};
use rayon::prelude::*;

use super::{Origin, Psf, SourceFile};
use crate::error::PsfieldError;
use crate::stack_size::check_stack;

/// A linear change of stamps to another grid. It changes the rows in one way and the columns in another.
pub(crate) struct StampChange {
    own: StampGrid,
    target: StampGrid,
    kind: ChangeKind,
}

enum ChangeKind {
    /// Resamples stamps to the pixels of a grid, and multiplies them by a factor. A factor of 1 changes no
    /// bit.
    Resampling(StampGrid, f64),
    WithoutScenePixel(ScenePixelFilter),
}

impl StampChange {
    fn resampling(own: StampGrid, target: StampGrid) -> Self {
        Self {
            own,
            target,
            kind: ChangeKind::Resampling(target, 1.0),
        }
    }

    /// The changed stamp.
    fn apply(&self, stamp: ArrayView2<'_, f64>) -> Array2<f64> {
        match &self.kind {
            ChangeKind::Resampling(sampled, factor) => {
                StampInterpolator::new(stamp, self.own).resample((0.0, 0.0), *sampled) * *factor
            }
            ChangeKind::WithoutScenePixel(filter) => filter.apply(stamp),
        }
    }

    /// The change as two matrices: `along_y` `[new row, row]` and `along_x` `[new column, column]` change a
    /// stamp to `along_y stamp along_x^T`. They follow from the changes of stamps with a single lit row or
    /// column.
    pub(crate) fn matrices(&self) -> [Array2<f64>; 2] {
        let (ny, nx) = self.own.dim();
        let of_ones = |rows: Range<usize>, columns: Range<usize>| {
            let mut stamp = Array2::zeros((ny, nx));
            stamp.slice_mut(s![rows, columns]).fill(1.0);
            self.apply(stamp.view())
        };
        // In the middle, a constant stays nearly constant.
        let (y, x) = (self.target.ny() / 2, self.target.nx() / 2);
        let constant = of_ones(0..ny, 0..nx)[[y, x]];
        let mut along_y = Array2::zeros((self.target.ny(), ny));
        let mut along_x = Array2::zeros((self.target.nx(), nx));
        for (j, mut column) in along_y.columns_mut().into_iter().enumerate() {
            column.assign(&of_ones(j..j + 1, 0..nx).column(x));
        }
        for (i, mut column) in along_x.columns_mut().into_iter().enumerate() {
            column.assign(&(&of_ones(0..ny, i..i + 1).row(y) / constant));
        }
        [along_y, along_x]
    }
}

impl Psf {
    /// Returns this PSF with native stamps, which the convolution of images needs: at the frame's
    /// own pixels, centred on a pixel, with the pixel response. The stamps are `size` pixels wide
    /// and high, centred at `size / 2`. If `size` is None, they cover the area of the old stamps. A
    /// PSF that already has such stamps is returned unchanged.
    ///
    /// # Errors
    /// [`PsfieldError`] when `size` is 0, resampled samples hold no flux, or the stamps would fill more
    /// memory than [`check_stack`] allows. The errors of [`record`](Self::record).
    pub fn native(&self, size: Option<usize>) -> Result<Self, PsfieldError> {
        if let Some(changed) = self.changed_by_parts(|part| part.native(size))? {
            return Ok(changed);
        }
        match self.native_change(size)? {
            None => Ok(self.clone()),
            Some(change) => self.changed_by(&change),
        }
    }

    /// The change from this PSF's stamps to those of [`native`](Self::native). None if there is nothing to
    /// change.
    pub(crate) fn native_change(&self, size: Option<usize>) -> Result<Option<StampChange>, PsfieldError> {
        let target = self.native_target(size)?;
        Ok((target != self.grid()).then(|| StampChange::resampling(self.grid(), target)))
    }

    /// Returns whether [`native`](Self::native) only picks pixels of the stamps, without
    /// interpolation.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) when `size` is 0. If the stamps' pixels can be picked,
    /// `size` is not checked.
    pub fn native_is_exact(&self, size: Option<usize>) -> Result<bool, PsfieldError> {
        let grid = self.grid();
        Ok(native_picks(grid) || self.native_target(size)? == grid)
    }

    /// The distance beyond the stamps, in stamp pixels, up to which interpolated PSFs hold light
    /// ([`edge_reach`]).
    fn edge_reach(&self) -> usize {
        match &self.0.origin {
            Origin::Samples(samples, _) => edge_reach(None, samples.stamps(), None, samples.grid()),
            _ => self.record().map_or(0, |record| {
                let (basis, weights) = (record.basis(), record.coefficients().values());
                edge_reach(basis.mean(), basis.components(), Some(weights), basis.grid())
            }),
        }
    }

    fn native_target(&self, size: Option<usize>) -> Result<StampGrid, PsfieldError> {
        let base = match size {
            None => native_grid_of(self.grid(), 1.0, 0.0, || self.edge_reach())?,
            Some(n) => StampGrid::new(n, n)?,
        };
        Ok(base
            .with_pixel_response_included(true)
            .with_interpolation(self.grid().interpolation()))
    }

    /// Returns this PSF with stamps that include the response of a frame pixel, at their own
    /// sampling. Stamps that already include it are unchanged.
    ///
    /// # Errors
    /// The errors of [`native`](Self::native).
    pub fn with_pixel_response(&self) -> Result<Self, PsfieldError> {
        if self.grid().pixel_response_included() {
            return Ok(self.clone());
        }
        if let Some(changed) = self.changed_by_parts(Self::with_pixel_response)? {
            return Ok(changed);
        }
        self.resampled(grid_with_pixel_response(self.grid(), self.edge_reach())?)
    }

    /// Returns this PSF for scenes whose pixels are `finer` times smaller than the frame's. Its
    /// stamps have the scene's pixels. If `size` is given, they are `size` frame pixels wide and
    /// high.
    ///
    /// Frame pixel `i` has its centre at the coordinate `finer i + (finer - 1) / 2` of the scene.
    /// The scene is convolved with these stamps. The frame's image is every `finer`-th pixel of the
    /// result, from pixel `(finer - 1) / 2` (rounded down) on, times `finer^2`. The result is
    /// sampled, not summed, because the stamps include the response of a frame pixel.
    pub(crate) fn for_finer_scene(
        &self,
        finer: usize,
        size: Option<usize>,
        anchor: Anchor,
    ) -> Result<Self, PsfieldError> {
        let offset_of_field = if anchor == Anchor::Output {
            ((finer - 1) / 2) as f64
        } else {
            (finer as f64 - 1.0) / 2.0
        };
        let change = self.finer_change(finer, size)?;
        self.changed_at(
            change.target,
            |stamp| change.apply(stamp),
            |positions| finer_positions(positions, finer, offset_of_field),
        )
    }

    /// The change from this PSF's stamps to those of [`for_finer_scene`](Self::for_finer_scene).
    pub(crate) fn finer_change(
        &self,
        finer: usize,
        size: Option<usize>,
    ) -> Result<StampChange, PsfieldError> {
        let s = finer as f64;
        // If `finer` is even, the centre of a frame pixel lies between two scene pixels.
        let between = (s - 1.0) / 2.0 - ((finer - 1) / 2) as f64;
        let own = self.grid();
        let target = match size {
            None => native_grid_of(own, s, between, || self.edge_reach())?,
            Some(n) => StampGrid::new(n.saturating_mul(finer), n.saturating_mul(finer))?,
        };
        let target = target
            .with_pixel_response_included(true)
            .with_interpolation(own.interpolation());
        let sampled = target
            .with_oversampling(s)?
            .with_centre(target.centre_x() - between, target.centre_y() - between)?;
        Ok(StampChange {
            own,
            target,
            // Converts values per pixel of the frame to values per pixel of the scene.
            kind: ChangeKind::Resampling(sampled, 1.0 / (s * s)),
        })
    }

    /// Returns this PSF with its stamps resampled to other pixels of the same frame.
    fn resampled(&self, target: StampGrid) -> Result<Self, PsfieldError> {
        self.changed_by(&StampChange::resampling(self.grid(), target))
    }

    fn changed_by(&self, change: &StampChange) -> Result<Self, PsfieldError> {
        self.changed(change.target, |stamp| change.apply(stamp))
    }

    /// Returns this PSF without the response of a pixel of the scene, for scenes whose values are
    /// already integrated over their pixels ([`ScenePixelFilter`]). The stamps have the scene's
    /// pixels. The new stamps are wider, by [`ScenePixelFilter::margin_for`] at some of the nodes.
    pub(crate) fn without_scene_pixel(&self) -> Result<Self, PsfieldError> {
        self.changed_by(&self.scene_pixel_change()?)
    }

    /// The change from this PSF's stamps to those of [`without_scene_pixel`](Self::without_scene_pixel).
    pub(crate) fn scene_pixel_change(&self) -> Result<StampChange, PsfieldError> {
        let own = self.grid();
        let margin = ScenePixelFilter::margin_for(self.some_psfs());
        let filter = ScenePixelFilter::new(own.dim(), margin);
        Ok(StampChange {
            own,
            target: own.with_margins([margin; 2])?,
            kind: ChangeKind::WithoutScenePixel(filter),
        })
    }

    /// PSFs at samples or nodes that are evenly spread over the list of them.
    fn some_psfs(&self) -> Vec<Array2<f64>> {
        /// PSFs vary smoothly over the field, so that these show how wide they are.
        const MOST: usize = 16;
        match &self.0.origin {
            Origin::Samples(samples, _) => {
                let step = samples.len().div_ceil(MOST);
                let stamps = samples.stamps();
                let some = (0..samples.len()).step_by(step);
                some.map(|j| stamps.index_axis(Axis(0), j).to_owned()).collect()
            }
            _ => self.record().map_or(Vec::new(), |record| {
                let (basis, weights) = (record.basis(), record.coefficients().values());
                let step = weights.nrows().div_ceil(MOST);
                let some = (0..weights.nrows()).step_by(step);
                some.map(|j| {
                    let mut psf = match basis.mean() {
                        Some(mean) => mean.to_owned(),
                        None => Array2::zeros(basis.grid().dim()),
                    };
                    for (&weight, stamp) in weights.row(j).iter().zip(basis.components().outer_iter()) {
                        psf.scaled_add(weight, &stamp);
                    }
                    psf
                })
                .collect()
            }),
        }
    }

    /// The name of this PSF's file, for messages on another PSF.
    fn named_source(&self) -> SourceFile {
        SourceFile {
            path: self.0.source.path.clone(),
            ..SourceFile::default()
        }
    }

    /// This PSF with another record.
    pub(super) fn with_record(&self, record: PsfModelRecord) -> Self {
        self.derived(record, self.named_source())
    }

    /// Returns this PSF with every stamp changed by the linear operation `stamp`, whose results have the
    /// grid `target`, in the same frame.
    pub(super) fn changed(
        &self,
        target: StampGrid,
        stamp: impl Fn(ArrayView2<'_, f64>) -> Array2<f64> + Sync,
    ) -> Result<Self, PsfieldError> {
        self.changed_at(target, stamp, |positions| Ok(positions.clone()))
    }

    /// As [`changed`](Self::changed), with `positions` that converts positions to the frame of the new stamps.
    ///
    /// For a model, only the mean and the components are changed. The change and interpolation are
    /// linear, so each PSF of the new model equals the changed PSF of the old model, before the
    /// scaling to unit flux. The scaling is done last, on the new stamps.
    fn changed_at(
        &self,
        target: StampGrid,
        stamp: impl Fn(ArrayView2<'_, f64>) -> Array2<f64> + Sync,
        positions: impl FnOnce(&SamplePositions) -> Result<SamplePositions, PsfieldError>,
    ) -> Result<Self, PsfieldError> {
        let changed = |stamps: ArrayView3<'_, f64>| {
            let mut changed = Array3::zeros((stamps.dim().0, target.ny(), target.nx()));
            let pairs: Vec<_> = changed.outer_iter_mut().zip(stamps.outer_iter()).collect();
            pairs
                .into_par_iter()
                .for_each(|(mut to, from)| to.assign(&stamp(from)));
            changed
        };
        match &self.0.origin {
            Origin::Samples(samples, options) => {
                check_stack(samples.len(), samples.grid())?;
                check_stack(samples.len(), target)?;
                let positions = positions(samples.positions())?;
                let samples = PsfSamples::new(changed(samples.stamps()), positions, target)?;
                Ok(Self::with_source(
                    Origin::Samples(samples, *options),
                    self.named_source(),
                ))
            }
            Origin::Record(_) | Origin::Model(..) => {
                let record = self.record_without_wings()?;
                let (basis, nodes) = (record.basis(), record.coefficients());
                check_stack(basis.rank() + 1, target)?;
                let made = psf_basis::orthonormal(
                    basis.mean().map(&stamp),
                    changed(basis.components()),
                    nodes.values(),
                    target,
                )?;
                let positions = positions(nodes.positions())?;
                Ok(self.with_record(on_basis(record, made, positions)?))
            }
        }
    }
}

/// A model's record with another basis, the coefficients in it and their positions.
pub(super) fn on_basis(
    record: &PsfModelRecord,
    (basis, values): (PsfBasis, Array2<f64>),
    positions: SamplePositions,
) -> Result<PsfModelRecord, PsfieldError> {
    Ok(record.with_parts(basis, SampleCoefficients::new(values, positions)?)?)
}

/// Returns whether the native pixels of stamps are some of their own pixels.
pub(super) fn native_picks(grid: StampGrid) -> bool {
    grid.whole_centre().is_some() && grid.oversampling().fract() == 0.0 && grid.pixel_response_included()
}

/// The grid of native stamps of a scene whose pixels are `finer` times smaller than the frame's,
/// with the pixel response. It is wide enough for all light of PSFs with this [`edge_reach`],
/// shifted by at most `shift` of the scene's pixels.
pub(crate) fn native_grid_of(
    grid: StampGrid,
    finer: f64,
    shift: f64,
    reach: impl FnOnce() -> usize,
) -> Result<StampGrid, PsfieldError> {
    let scaled = |grid: StampGrid| grid.with_oversampling(grid.oversampling() / finer);
    let own = scaled(grid)?;
    if shift == 0.0 && native_picks(own) {
        return Ok(native_grid(own, 0)?);
    }
    let reach = match reach() {
        0 => 0,
        reach => reach + (shift * own.oversampling()).ceil() as usize,
    };
    Ok(if grid.pixel_response_included() {
        native_grid(own, reach)?
    } else {
        native_grid(scaled(grid_with_pixel_response(grid, reach)?)?, 0)?
    })
}

/// Converts positions to pixels of the scene. This does not change the interpolated coefficients,
/// because no interpolator depends on the scale of positions.
fn finer_positions(
    positions: &SamplePositions,
    finer: usize,
    offset: f64,
) -> Result<SamplePositions, PsfieldError> {
    let s = finer as f64;
    let moved = positions
        .as_slice()
        .iter()
        .map(|p| Position::new(s * p.x() + offset, s * p.y() + offset))
        .collect::<Result<_, _>>()?;
    let field = positions
        .field()
        .map(|field| FrameShape::new(finer * field.nx(), finer * field.ny()))
        .transpose()?;
    Ok(SamplePositions::with_states(
        moved,
        field,
        positions.states().cloned(),
    )?)
}

#[cfg(test)]
mod tests {
    use psf_types::{Interpolation, Normalisation, OutsidePolicy};

    use super::*;

    /// Rounding error of sums of three stamps with values of order 1e-2, computed in two ways.
    const ROUNDING: f64 = 1e-12;

    fn gauss(n: usize, sigma: f64, shift: f64) -> Array2<f64> {
        let at = |i: usize| i as f64 - (n / 2) as f64;
        Array2::from_shape_fn((n, n), |(y, x)| {
            (-((at(x) - shift).powi(2) + at(y).powi(2)) / (2.0 * sigma * sigma)).exp()
        })
    }

    /// A model of `side` by `side` nodes. Its last component lies outside the native stamps of 11
    /// pixels.
    fn model(n: usize, side: i64) -> PsfModelRecord {
        let grid = StampGrid::new(n, n)
            .and_then(|g| g.with_oversampling(4.0))
            .unwrap();
        let sigma = 3.0 + n as f64 / 50.0;
        let first = &gauss(n, sigma, 1.0) - &gauss(n, sigma, -1.0);
        let mut corner = Array2::zeros((n, n));
        corner.slice_mut(s![..2, ..2]).fill(0.5);
        let mut components = Array3::zeros((2, n, n));
        let norm = first.iter().map(|v| v * v).sum::<f64>().sqrt();
        components.slice_mut(s![0, .., ..]).assign(&(first / norm));
        let inside: f64 = (&components.slice(s![0, .., ..]) * &corner).sum();
        assert!(inside.abs() < 1e-6);
        components.slice_mut(s![1, .., ..]).assign(&corner);
        let nodes = (0..side * side).map(|j| Position::of_pixel(10 * (j % side), 10 * (j / side)));
        let positions = SamplePositions::new(nodes.collect(), None).unwrap();
        let values = Array2::from_shape_fn((positions.len(), 2), |(j, k)| (0.3 * (j + 5 * k) as f64).sin());
        let mean = gauss(n, sigma, 0.0);
        let mean = &mean / mean.sum() * 16.0;
        let basis = PsfBasis::new(Some(mean), components, grid).unwrap();
        PsfModelRecord::new(
            basis,
            SampleCoefficients::new(values, positions).unwrap(),
            Interpolation::Nearest,
            OutsidePolicy::Nearest,
            Normalisation::Keep,
        )
        .unwrap()
    }

    fn at_node(record: &PsfModelRecord, node: usize) -> Array2<f64> {
        let basis = record.basis();
        let mut stamp = basis.mean().unwrap().to_owned();
        for (a, component) in record
            .coefficients()
            .values()
            .row(node)
            .iter()
            .zip(basis.components().outer_iter())
        {
            stamp.scaled_add(*a, &component);
        }
        stamp
    }

    #[test]
    fn a_resampled_model_gives_the_resampled_psfs() {
        let record = model(65, 3);
        for size in [None, Some(11)] {
            let native = Psf::from(record.clone()).native(size).unwrap();
            let native = native.stored().expect("a resampled model is a model");
            // The corner lies outside 11 pixels.
            assert_eq!(native.basis().rank(), if size.is_some() { 1 } else { 2 });
            let (own, target) = (record.basis().grid(), native.basis().grid());
            for node in 0..9 {
                let expected =
                    StampInterpolator::new(at_node(&record, node).view(), own).resample((0.0, 0.0), target);
                for (a, b) in at_node(native, node).iter().zip(&expected) {
                    assert!((a - b).abs() < ROUNDING, "{node}: {a} against {b}");
                }
            }
        }
    }

    #[test]
    fn a_filtered_model_gives_the_filtered_psfs() {
        let native = Psf::from(model(65, 3)).native(None).unwrap();
        let filtered = native.without_scene_pixel().unwrap();
        let (native, own, new) = (native.stored().unwrap(), native.grid(), filtered.grid());
        let margin = (new.nx() - own.nx()) / 2;
        assert_eq!(new.centre_x(), own.centre_x() + margin as f64);
        let filter = ScenePixelFilter::new(own.dim(), margin);
        for node in 0..9 {
            let expected = filter.apply(at_node(native, node).view());
            let got = at_node(filtered.stored().unwrap(), node);
            assert!((got.sum() - at_node(native, node).sum()).abs() < ROUNDING);
            for (a, b) in got.iter().zip(&expected) {
                assert!((a - b).abs() < ROUNDING, "{node}: {a} against {b}");
            }
        }
    }

    /// The stamps of all nodes together would fill 32 GiB.
    #[test]
    fn many_nodes_of_large_stamps_are_resampled_without_their_stamps() {
        let record = model(512, 128);
        let finer = Psf::from(record.clone())
            .for_finer_scene(2, None, Anchor::Source)
            .unwrap();
        assert_eq!(finer.positions().len(), 128 * 128);
        let native = Psf::from(record).native(None).unwrap();
        assert_eq!(native.grid().oversampling(), 1.0);
    }
}
