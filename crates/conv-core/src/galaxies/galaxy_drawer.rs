//! Draws the extended sources of a catalogue, such as galaxies.

use std::sync::{Arc, OnceLock};

use ndarray::{Array1, Array2, ArrayViewMut2, Axis, s};
use psf_types::{Anchor, LightProfile, PixelRegion, PointSource, Position, Progress};
use rayon::prelude::*;

use super::extent::{Extent, truncate};
use super::far_field::{BlockWeights, FarLight, SMALLEST, add_far_light};
use super::floor::{PsfOutskirts, WithinFloor};
use super::kernels::{Kernels, ModelStamps};
use super::power_spectrum::Outline;
use super::window::{Drawn, Spectra, WindowDrawer};
use crate::dropped_light::DroppedLight;
use crate::kept::Kept;
use crate::overlap::{Piece, add_pieces, shared};
use crate::plan::local_modes::LocalModes;
use crate::sources::{BlockKey, SourcePsfs, block_of, region_of};
use crate::{ConvError, ConvReal, view};

/// The light of an extended source, made when it is drawn.
pub type Light = Arc<dyn LightProfile + Send + Sync>;

/// Draws galaxies from local bases, and those beyond the tolerance from all components.
#[derive(Debug)]
pub(crate) struct GalaxyDrawer<T> {
    pub(super) psfs: SourcePsfs,
    pub(super) shared: Arc<Shared<T>>,
}

/// The parts of a drawer that do not depend on the coefficient field.
#[derive(Debug)]
pub(super) struct Shared<T> {
    /// Made when the first galaxy is drawn.
    stamps: Arc<OnceLock<ModelStamps>>,
    pub(super) tolerance: f64,
    pub(super) extent: Extent,
    blocks: Kept<BlockKey, DrawingBlock>,
    spectra: Kept<GroupKey, Spectra<T>>,
}

/// A block of the field with its local basis.
#[derive(Debug)]
pub(super) struct DrawingBlock {
    pub(super) modes: LocalModes,
    pub(super) kernels: Kernels,
    /// `None` without a floor, and if the PSFs have no flux.
    outskirts: Option<PsfOutskirts>,
}

/// Columns and rows of a block of the field. In a larger block, more galaxies share its transformed
/// stamps, but it needs more of them.
const BLOCK: i64 = 512;
/// Modes of a block are chosen from a few of its rows for this fraction of the tolerance.
const MARGIN: f64 = 0.5;
/// The most galaxies of a group, which one task draws.
const PER_GROUP: usize = 32;
/// The most pixels of the windows of a group of more than one galaxy.
const PIXELS_PER_GROUP: usize = 512 * 512;
/// The transforms of a model's stamps use at most this part of the memory limit.
const PARTS_OF_MEMORY: usize = 4;
/// The most points of a transform along each axis. It would take 8 GiB.
const MOST_POINTS: usize = 1 << 15;
/// Groups that are drawn before they are added to the image.
const GROUPS_AT_ONCE: usize = 32;
/// Rows of the image to which one task adds.
const BAND: usize = 32;

/// Galaxies that use the transformed stamps of one block, on windows of one side and up to one band:
/// the side, the number of the band, and the block. In this order, the blocks that need the same
/// transforms of all stamps follow each other.
pub(super) type GroupKey = (usize, usize, BlockKey);

/// A galaxy that reaches the region, and how it is drawn.
pub(super) struct Placed {
    pub(super) key: GroupKey,
    /// Its index in the catalogue.
    pub(super) index: usize,
    /// Light at wavenumbers outside it is left out. Not used with [`Anchor::Output`].
    pub(super) outline: Outline,
    /// Up to this distance from the centre, light outside the window is drawn.
    pub(super) reach: Option<f64>,
}

/// A galaxy's window: first column and row, and its side.
pub(super) type Window = (i64, i64, usize);

/// Extended sources: the positions and fluxes of all, and the light of each by its index, for a flux of 1.
#[derive(Clone, Copy)]
pub struct ExtendedSources<'a> {
    /// Positions and fluxes. Positions are in pixels of the scene.
    pub points: &'a [PointSource],
    /// Returns the light of the source with an index.
    pub light: &'a (dyn Fn(usize) -> Light + Sync),
}

impl std::fmt::Debug for ExtendedSources<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let points = &self.points;
        f.debug_struct("ExtendedSources")
            .field("points", points)
            .finish_non_exhaustive()
    }
}

/// Extended sources, and the frame, which is a region of the scene.
#[derive(Clone, Copy)]
pub(crate) struct ExtendedToDraw<'a> {
    pub(crate) sources: ExtendedSources<'a>,
    pub(crate) frame: PixelRegion,
    pub(crate) progress: &'a dyn Progress,
}

impl ExtendedToDraw<'_> {
    /// A galaxy's position in pixels of the frame.
    pub(super) fn position(&self, index: usize) -> (f64, f64) {
        let at = self.sources.points[index].position();
        (at.x() - self.frame.x0() as f64, at.y() - self.frame.y0() as f64)
    }

    pub(super) fn flux(&self, index: usize) -> f64 {
        self.sources.points[index].flux()
    }

    pub(super) fn light(&self, index: usize) -> Light {
        (self.sources.light)(index)
    }
}

impl<T: ConvReal> GalaxyDrawer<T> {
    pub(crate) fn new(psfs: &SourcePsfs) -> Self {
        let extent = Extent::new(&psfs.model, psfs.size(), psfs.options().tolerance_in::<T>());
        Self::on_stamps(psfs, extent, Arc::default())
    }

    /// A drawer on stamps, with local bases of its own.
    fn on_stamps(psfs: &SourcePsfs, extent: Extent, stamps: Arc<OnceLock<ModelStamps>>) -> Self {
        let options = psfs.options();
        let shared = Shared {
            stamps,
            tolerance: options.tolerance_in::<T>(),
            extent,
            blocks: Kept::new(usize::MAX),
            spectra: Kept::new(options.memory_bytes()),
        };
        Self {
            psfs: psfs.clone(),
            shared: Arc::new(shared),
        }
    }

    /// A drawer with the same local bases, for PSFs that share them.
    pub(crate) fn with_same_bases(&self, psfs: &SourcePsfs) -> Self {
        Self {
            psfs: psfs.clone(),
            shared: Arc::clone(&self.shared),
        }
    }

    /// A drawer with local bases of its own, for other models with these stamps.
    pub(crate) fn with_own_bases(&self, psfs: &SourcePsfs) -> Self {
        Self::on_stamps(psfs, self.shared.extent, Arc::clone(&self.shared.stamps))
    }

    pub(super) fn stamps(&self) -> &ModelStamps {
        self.shared.stamps.get_or_init(|| {
            let psfs = &self.psfs;
            let (grid, mut stamps) = (psfs.model.grid(), psfs.space().stamps());
            if let Some(size) = psfs.size() {
                stamps
                    .outer_iter_mut()
                    .for_each(|stamp| truncate(stamp, grid, size));
            }
            ModelStamps::new(stamps, grid, psfs.options().memory_bytes() / PARTS_OF_MEMORY)
        })
    }

    /// Adds galaxies to a part of an image, whose rows are contiguous in memory.
    pub(crate) fn draw_into(
        &self,
        catalogue: ExtendedToDraw<'_>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let placed = self.placed(catalogue, region, true)?;
        let groups = Self::groups(&placed);
        let first = (region.x0(), region.y0());
        let mut far = Vec::new();
        for some in groups.chunks(GROUPS_AT_ONCE) {
            catalogue.progress.check_cancelled()?;
            let drawn: Vec<(Vec<Piece<T>>, Vec<FarLight>)> = some
                .par_iter()
                .map(|group| self.draw_group(catalogue, group, region))
                .collect::<Result<_, _>>()?;
            let pieces = drawn.iter().flat_map(|(pieces, _)| pieces);
            add_pieces(pieces, image.view_mut(), first, BAND);
            far.extend(drawn.into_iter().flat_map(|(_, far)| far));
        }
        add_far_light(&far, image, first, catalogue.progress)
    }

    /// The galaxies that reach the region, and how they are drawn, in the order of their groups.
    pub(super) fn placed(
        &self,
        catalogue: ExtendedToDraw<'_>,
        region: PixelRegion,
        has_floor: bool,
    ) -> Result<Vec<Placed>, ConvError> {
        let mut placed: Vec<Placed> = (0..catalogue.sources.points.len())
            .into_par_iter()
            .map(|index| -> Result<_, ConvError> {
                catalogue.progress.check_cancelled()?;
                let (flux, light) = (catalogue.flux(index), catalogue.light(index));
                let (x, y) = catalogue.position(index);
                let whole = self.without_floor(light.as_ref());
                if flux == 0.0 || !is_near((x, y), self.farthest(&whole), region) {
                    return Ok(None);
                }
                let (key, mut drawn, mut outline) = (block_at((x, y)), whole, Outline::default());
                if self.psfs.options().anchor() != Anchor::Output {
                    let block = self.block(key);
                    if has_floor {
                        drawn = self.within_floor(&block, whole, (light.as_ref(), flux));
                    }
                    outline = block.kernels.power.outline(light.as_ref(), drawn.accuracy);
                }
                let WithinFloor { side, reach, .. } = drawn;
                let number = self.stamps().band_number(outline.radius());
                let points = self.stamps().transform_points(side, number);
                if points > MOST_POINTS {
                    return Err(ConvError::GalaxyTransform { x, y, points });
                }
                let key = (side, number, key);
                Ok(Some(Placed {
                    key,
                    index,
                    outline,
                    reach,
                }))
            })
            .filter_map(Result::transpose)
            .collect::<Result<_, _>>()?;
        placed.par_sort_unstable_by_key(|galaxy| (galaxy.key, galaxy.index));
        Ok(placed)
    }

    /// The groups of some galaxies.
    pub(super) fn groups(placed: &[Placed]) -> Vec<&[Placed]> {
        placed
            .chunk_by(|a, b| a.key == b.key)
            .flat_map(|group| group.chunks((PIXELS_PER_GROUP / group[0].key.0.pow(2)).clamp(1, PER_GROUP)))
            .collect()
    }

    /// The local PSFs of a group, unless each pixel has its own.
    pub(super) fn local_of(&self, group: &[Placed]) -> Option<Local<T>> {
        (self.psfs.options().anchor() != Anchor::Output).then(|| self.local(group[0].key))
    }

    /// The window and the wavenumbers of a galaxy without a floor.
    fn without_floor(&self, light: &dyn LightProfile) -> WithinFloor {
        let (side, reach) = self.shared.extent.side_and_reach(light);
        let accuracy = self.shared.extent.accuracy();
        WithinFloor {
            side,
            reach,
            accuracy,
        }
    }

    /// The window and the wavenumbers of a galaxy of a flux.
    fn within_floor(
        &self,
        block: &DrawingBlock,
        whole: WithinFloor,
        (light, flux): (&dyn LightProfile, f64),
    ) -> WithinFloor {
        let allowed = self.psfs.options().floor() / flux.abs();
        let outskirts = block.outskirts.as_ref();
        outskirts.map_or(whole, |psf| WithinFloor::new(whole, light, psf, allowed))
    }

    fn farthest(&self, drawn: &WithinFloor) -> f64 {
        self.shared.extent.farthest(drawn.side, drawn.reach)
    }

    /// Adds the light that galaxies drop at most, in a region.
    pub(crate) fn add_dropped(
        &self,
        catalogue: ExtendedToDraw<'_>,
        region: PixelRegion,
        dropped: &mut DroppedLight,
    ) {
        let count = catalogue.sources.points.len();
        dropped.add_all(count, |dropped, some| {
            some.for_each(|index| self.add_dropped_of(index, catalogue, region, dropped));
        });
    }

    /// Adds the light that a galaxy drops at most.
    fn add_dropped_of(
        &self,
        index: usize,
        catalogue: ExtendedToDraw<'_>,
        region: PixelRegion,
        dropped: &mut DroppedLight,
    ) {
        let (flux, light) = (catalogue.flux(index), catalogue.light(index));
        let at = catalogue.position(index);
        let whole = self.without_floor(light.as_ref());
        let farthest = self.farthest(&whole);
        if flux == 0.0 || !is_near(at, farthest, region) {
            return;
        }
        let block = (self.psfs.options().anchor() != Anchor::Output).then(|| self.block(block_at(at)));
        match block
            .as_ref()
            .and_then(|block| Some((block, block.outskirts.as_ref()?)))
        {
            Some((block, psf)) => {
                let drawn = self.within_floor(block, whole, (light.as_ref(), flux));
                let limits = (psf, self.psfs.options().floor(), farthest);
                drawn.add_dropped(&whole, (at, flux, light.as_ref()), limits, dropped);
            }
            None => dropped.count(flux, 0.0),
        }
    }

    /// Draws the windows of a group of galaxies. Returns the windows that reach the region, and the
    /// galaxies with light outside their windows.
    fn draw_group(
        &self,
        catalogue: ExtendedToDraw<'_>,
        group: &[Placed],
        region: PixelRegion,
    ) -> Result<(Vec<Piece<T>>, Vec<FarLight>), ConvError> {
        let (side, ..) = group[0].key;
        let local = self.local_of(group);
        let (mut pieces, mut far) = (Vec::new(), Vec::new());
        let mut drawer = WindowDrawer::new(side);
        let weights = BlockWeights::<T>::new(side);
        for placed in group {
            catalogue.progress.check_cancelled()?;
            let flux = catalogue.flux(placed.index);
            let (x, y) = catalogue.position(placed.index);
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            let window = window_at((x, y), side);
            let centre = (x - window.0 as f64, y - window.1 as f64);
            let psf = self.psf(local.as_ref(), position, flux)?;
            let light = catalogue.light(placed.index);
            let on_region = shared(view::region(window.0, window.1, (side, side)), region);
            let mut drawn = None;
            if let Some([_, (rows, _)]) = &on_region {
                drawn = Some(match &psf {
                    Psf::Local(local, coefficients) => {
                        let drawn = Drawn {
                            spectra: &local.spectra,
                            light: light.as_ref(),
                            centre,
                            coefficients,
                            outline: &placed.outline,
                        };
                        drawer.draw(&drawn, rows.clone())
                    }
                    Psf::Exact(psf) => {
                        let (light, frame) = (light.as_ref(), catalogue.frame.shape());
                        let mut values = Array2::default((0, 0));
                        self.exact_windows(psf, flux, &[(light, centre)], window, frame, |all| {
                            values = all.slice(s![rows.clone(), ..]).mapv(T::nearest);
                        })?;
                        values
                    }
                });
            }
            // The light outside is kept until all galaxies are drawn, without a transform.
            let outside = placed.reach.and_then(|reach| {
                let moments = match &psf {
                    Psf::Local(local, coefficients) => local.block.kernels.moments_of(coefficients),
                    Psf::Exact(psf) => self.stamps().moments_of(psf.view()),
                };
                let light = catalogue.light(placed.index);
                self.far_light(moments, light, (x, y), window, reach)
            });
            if let Some((mut values, [(columns, _), (rows, _)])) = drawn.zip(on_region) {
                if let Some(outside) = &outside {
                    outside.subtract_repeated(&weights, rows.start, &mut values);
                }
                let first = (window.0 + columns.start as i64, window.1 + rows.start as i64);
                // Windows may be larger than the region.
                if columns.len() < side {
                    values = values.slice(s![.., columns]).to_owned();
                }
                pieces.push(Piece { first, values });
            }
            far.extend(outside);
        }
        Ok((pieces, far))
    }

    /// The block of some galaxies, and its transformed stamps, which are kept for later galaxies
    /// within the limit of the memory.
    fn local(&self, key: GroupKey) -> Local<T> {
        let block = self.block(key.2);
        let make = || self.stamps().spectra_of(&block.kernels, key.0, key.1);
        Local {
            spectra: self.shared.spectra.get(key, make, Spectra::bytes),
            block,
        }
    }

    /// The PSF of a galaxy, from the modes of its block if they are within the tolerance.
    pub(super) fn psf<'a>(
        &self,
        local: Option<&'a Local<T>>,
        position: Position,
        flux: f64,
    ) -> Result<Psf<'a, T>, ConvError> {
        let mut vectors = self.psfs.vectors();
        let scale = vectors.set(position)? * flux;
        if let Some(local) = local {
            let all = vectors.psf.clone();
            let whole = vectors.norm();
            let mut coefficients = Vec::new();
            vectors.project(&local.block.modes, &mut coefficients);
            if vectors.is_within(self.shared.tolerance, whole) {
                for c in &mut coefficients {
                    *c *= scale;
                }
                return Ok(Psf::Local(local, coefficients));
            }
            vectors.psf = all;
        }
        Ok(Psf::Exact(vectors.psf * scale))
    }

    fn block(&self, key: BlockKey) -> Arc<DrawingBlock> {
        let make = || {
            let (region, space) = (region_of(key, BLOCK), self.psfs.space());
            let cells = space.cells_for_sources(region, self.shared.tolerance);
            let modes = LocalModes::of_exact_cells(space, &cells, MARGIN * self.shared.tolerance);
            // No rows if the PSF has no value in the block. Then each galaxy uses all components.
            let directions = modes.kernels();
            // The values at the corners of cells begin with the flux, also without a reference.
            let values = modes.at_corners(&cells);
            // The least flux of a PSF that is scaled to a flux of 1.
            let fluxes = values.column(0);
            let faintest = if self.psfs.model.needs_flux_scaling() {
                fluxes.iter().fold(f64::INFINITY, |least, &flux| least.min(flux))
            } else {
                1.0
            };
            let values = values.slice(s![.., values.ncols() - directions.nrows()..]);
            let largest = values.map_axis(Axis(0), |values| values.fold(0.0_f64, |m, v| m.max(v.abs())));
            let largest = largest.to_vec();
            let typical = LocalModes::mean(space, &cells);
            let outskirts = (self.psfs.options().floor() > 0.0 && faintest > 0.0).then(|| {
                let largest: Vec<f64> = largest.iter().map(|largest| largest / faintest).collect();
                self.stamps().outskirts(&directions, &largest, typical.view())
            });
            let kernels = Kernels::new(
                self.stamps(),
                directions,
                &largest,
                typical.view(),
                self.shared.extent.accuracy(),
            );
            DrawingBlock {
                modes,
                kernels,
                outskirts,
            }
        };
        self.shared.blocks.get(key, make, |_| 0)
    }

    /// The light of a galaxy outside its window, up to the distance `reach`. `None` if the values of
    /// the PSF nearly cancel: then it has no centroid, and hardly any light far out.
    pub(super) fn far_light(
        &self,
        moments: [f64; 6],
        light: Light,
        (x, y): (f64, f64),
        window: Window,
        reach: f64,
    ) -> Option<FarLight> {
        let [flux, mx, my, xx, xy, yy] = moments;
        let (dx, dy) = (mx / flux, my / flux);
        let covariance = [xx / flux - dx * dx, xy / flux - dx * dy, yy / flux - dy * dy];
        self.shared.extent.holds((dx, dy), covariance).then(|| FarLight {
            flux,
            centre: (x + dx, y + dy),
            covariance,
            window,
            faintest: self.shared.extent.left_out() / (2.0 * reach).powi(2),
            outside: self.shared.extent.outside(light.as_ref(), window.2),
            reach,
            light,
        })
    }
}

/// The local PSFs of a block, transformed for windows of one side.
pub(super) struct Local<T> {
    pub(super) block: Arc<DrawingBlock>,
    pub(super) spectra: Arc<Spectra<T>>,
}

/// The PSF of a galaxy, times its flux.
pub(super) enum Psf<'a, T> {
    /// The coefficients of the local PSFs.
    Local(&'a Local<T>, Vec<f64>),
    /// The PSF of all components, as a vector of the model's space of PSFs.
    Exact(Array1<f64>),
}

/// The block of a galaxy at a point of the frame.
fn block_at((x, y): (f64, f64)) -> BlockKey {
    block_of((x.round() as i64, y.round() as i64), BLOCK)
}

pub(super) fn window_at((x, y): (f64, f64), side: usize) -> Window {
    let first = |at: f64| {
        let step = SMALLEST as f64;
        ((at - 0.5 * side as f64) / step).round() as i64 * SMALLEST as i64
    };
    (first(x), first(y), side)
}

/// Whether a square around a point of the frame overlaps a region.
fn is_near((x, y): (f64, f64), reach: f64, region: PixelRegion) -> bool {
    let near = |at: f64, first: i64, count: usize| {
        at + reach >= first as f64 && at - reach <= (first + count as i64) as f64
    };
    near(x, region.x0(), region.shape().nx()) && near(y, region.y0(), region.shape().ny())
}
