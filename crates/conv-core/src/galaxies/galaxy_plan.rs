//! Plans for galaxies.

use std::sync::{Arc, OnceLock};

use ndarray::{Array1, ArrayViewMut2, Axis, s};
use psf_types::{Anchor, LightProfile, PixelRegion, Position, Progress, PsfModel, SersicSource};
use rayon::prelude::*;

use super::extent::{Extent, truncate};
use super::far_field::{BlockWeights, FarLight, SMALLEST, add_far_light};
use super::kernels::{Kernels, Stamps};
use super::power_spectrum::Outline;
use super::window::{Drawn, Spectra, WindowDrawer};
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::kept::Kept;
use crate::overlap::{self, Piece, add_pieces, shared};
use crate::plan::local_modes::LocalModes;
use crate::plan::psf_space::PsfSpace;
use crate::plan::{PlanOptions, check_layers, share_stamps};
use crate::stars::{BlockKey, StarVectors, block_of, check_stamps, region_of};
use crate::{ConvError, ConvReal};

/// A galaxy's light, made when it is drawn.
pub(super) type Light = Box<dyn LightProfile + Send + Sync>;

/// A plan for drawing galaxies through one model. A galaxy is a function on the sky, convolved with
/// the PSF of its own position. With [`Anchor::Output`] it is convolved with the PSF of each pixel,
/// but for its outskirts.
///
/// If the plan is source-anchored, the PSFs come from local bases of blocks of the field, and the
/// relative L2 error of a galaxy's PSF is at most the tolerance. Every galaxy is tested, and a
/// galaxy that would exceed the tolerance is drawn with the PSF of all components. Beside that
/// error, a pixel of a galaxy has an error of at most about the tolerance times the galaxy's peak, and
/// usually of a third of that. Below a tolerance of 1e-6 it does not shrink further, because light is
/// computed in single precision.
///
/// The image is the same, bit by bit, for any number of threads.
#[derive(Debug)]
pub struct GalaxyPlan<T> {
    pub(super) model: PsfModel,
    pub(super) shared: Arc<Shared<T>>,
}

/// The parts of a plan that do not depend on the coefficient field.
#[derive(Debug)]
pub(super) struct Shared<T> {
    /// The models whose PSFs the local bases represent.
    models: Vec<PsfModel>,
    pub(super) options: PlanOptions,
    pub(super) size: Option<usize>,
    /// Made when the first galaxy is drawn.
    space: OnceLock<PsfSpace>,
    stamps: Arc<OnceLock<Stamps>>,
    pub(super) tolerance: f64,
    pub(super) extent: Extent,
    blocks: Kept<BlockKey, Block>,
    spectra: Kept<GroupKey, Spectra<T>>,
}

/// A block of the field with its local basis.
#[derive(Debug)]
struct Block {
    modes: LocalModes,
    kernels: Kernels,
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
type GroupKey = (usize, usize, BlockKey);

/// A galaxy that reaches the region, and how it is drawn.
struct Placed {
    key: GroupKey,
    /// Its index in the catalogue.
    index: usize,
    /// Light at wavenumbers outside it is left out. Not used with [`Anchor::Output`].
    outline: Outline,
    /// Up to this distance from the centre, light outside the window is drawn.
    reach: Option<f64>,
}

/// A galaxy's window: first column and row, and its side.
pub(super) type Window = (i64, i64, usize);

/// Galaxies with positions in pixels of a scene, and the frame, which is a region of the scene.
#[derive(Clone, Copy)]
pub(super) struct Catalogue<'a> {
    pub(super) galaxies: &'a [SersicSource],
    pub(super) light: &'a (dyn Fn(&SersicSource) -> Light + Sync),
    pub(super) frame: PixelRegion,
    pub(super) progress: &'a dyn Progress,
}

impl Catalogue<'_> {
    /// A galaxy's position in pixels of the frame.
    pub(super) fn position(&self, index: usize) -> (f64, f64) {
        let at = self.galaxies[index].position();
        (at.x() - self.frame.x0() as f64, at.y() - self.frame.y0() as f64)
    }
}

impl<T: ConvReal> GalaxyPlan<T> {
    /// Plans the drawing of galaxies with the PSFs of a model. If `size` is given, stamps are
    /// truncated to `size` frame pixels along each side.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] if the stamps do not include the pixel response,
    /// [`ConvError::StampSize`] if `size` is 0.
    pub fn new(model: &PsfModel, options: PlanOptions, size: Option<usize>) -> Result<Self, ConvError> {
        Self::of_layers(std::slice::from_ref(model), options, size)
    }

    /// Plans the drawing of galaxies with the PSFs of several models that share their stamps, as
    /// [`StarPlan::of_layers`](crate::StarPlan::of_layers) does for stars.
    ///
    /// # Errors
    /// As for [`new`](Self::new), and [`ConvError::Layers`] without models, or if their stamps or their
    /// scaling to unit flux differ.
    #[inline(never)]
    pub fn of_layers(
        models: &[PsfModel],
        options: PlanOptions,
        size: Option<usize>,
    ) -> Result<Self, ConvError> {
        check_layers(models)?;
        check_stamps(models[0].grid(), size)?;
        let extent = Extent::new(&models[0], size, options.tolerance_in::<T>());
        Ok(Self::on_stamps(models, (options, size), (extent, Arc::default())))
    }

    /// A plan on stamps, with local bases of its own.
    fn on_stamps(
        models: &[PsfModel],
        (options, size): (PlanOptions, Option<usize>),
        (extent, stamps): (Extent, Arc<OnceLock<Stamps>>),
    ) -> Self {
        let shared = Shared {
            size,
            space: OnceLock::new(),
            stamps,
            tolerance: options.tolerance_in::<T>(),
            extent,
            blocks: Kept::new(usize::MAX),
            spectra: Kept::new(options.memory_bytes()),
            models: models.to_vec(),
            options,
        };
        Self {
            model: models[0].clone(),
            shared: Arc::new(shared),
        }
    }

    /// Returns a plan that draws galaxies with the PSFs of another model, as
    /// [`StarPlan::for_other_field`](crate::StarPlan::for_other_field) does for stars.
    pub fn for_other_field(&self, model: &PsfModel) -> Option<Self> {
        share_stamps(&self.model, model).then(|| Self {
            model: model.clone(),
            shared: Arc::clone(&self.shared),
        })
    }

    /// Returns a plan for other models with local bases of its own, as
    /// [`StarPlan::for_other_layers`](crate::StarPlan::for_other_layers) does for stars.
    pub fn for_other_layers(&self, models: &[PsfModel]) -> Option<Self> {
        let is_possible = check_layers(models).is_ok() && share_stamps(&self.model, &models[0]);
        is_possible.then(|| {
            let Shared {
                options,
                size,
                extent,
                ref stamps,
                ..
            } = *self.shared;
            Self::on_stamps(models, (options, size), (extent, Arc::clone(stamps)))
        })
    }

    pub(super) fn space(&self) -> &PsfSpace {
        let shared = &self.shared;
        let make = || PsfSpace::new(&shared.models, shared.options.tolerance_on());
        shared.space.get_or_init(make)
    }

    pub(super) fn stamps(&self) -> &Stamps {
        self.shared.stamps.get_or_init(|| {
            let (grid, mut stamps) = (self.model.grid(), self.space().stamps());
            if let Some(size) = self.shared.size {
                stamps
                    .outer_iter_mut()
                    .for_each(|stamp| truncate(stamp, grid, size));
            }
            Stamps::new(stamps, grid, self.shared.options.memory_bytes() / PARTS_OF_MEMORY)
        })
    }

    /// Adds galaxies to a part of an image. `image` holds the pixels `[y, x]` of `region`, which is
    /// in pixels of the frame. `light` returns the light of a galaxy, for a flux of 1.
    ///
    /// Galaxies are given in pixels of the scene, and `frame` is a region of the scene. Galaxies
    /// outside the frame contribute light as far as they reach. The light of a pixel does not
    /// depend on the region. `progress` is polled and may cancel the work. No steps are reported to
    /// it.
    ///
    /// # Errors
    /// [`ConvError::FrameShape`] for an image of another shape than the region,
    /// [`ConvError::Cancelled`], and [`ConvError`] if the PSF has no value at a galaxy that reaches
    /// the region. After an error the image may hold some of the galaxies.
    #[inline(never)]
    pub fn draw_into(
        &self,
        galaxies: &[SersicSource],
        light: &(dyn Fn(&SersicSource) -> Light + Sync),
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        check_shape(region.shape(), image.dim())?;
        let catalogue = Catalogue {
            galaxies,
            light,
            frame,
            progress,
        };
        with_rows_in_memory(image, |image| self.draw_catalogue(catalogue, region, image))
    }

    fn draw_catalogue(
        &self,
        catalogue: Catalogue<'_>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let mut placed: Vec<Placed> = (0..catalogue.galaxies.len())
            .into_par_iter()
            .map(|index| -> Result<_, ConvError> {
                catalogue.progress.check_cancelled()?;
                let galaxy = &catalogue.galaxies[index];
                let light = (catalogue.light)(galaxy);
                let (x, y) = catalogue.position(index);
                let (side, reach) = self.shared.extent.side_and_reach(light.as_ref());
                if galaxy.flux() == 0.0 || !is_near((x, y), self.shared.extent.farthest(side, reach), region)
                {
                    return Ok(None);
                }
                let block = block_of((x.round() as i64, y.round() as i64), BLOCK);
                let outline = match self.shared.options.anchor() {
                    Anchor::Output => Outline::default(),
                    _ => self.block(block).kernels.power.outline(light.as_ref()),
                };
                let number = self.stamps().band_number(outline.radius());
                let points = self.stamps().transform_points(side, number);
                if points > MOST_POINTS {
                    return Err(ConvError::GalaxyTransform { x, y, points });
                }
                let key = (side, number, block);
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
        let groups: Vec<&[Placed]> = placed
            .chunk_by(|a, b| a.key == b.key)
            .flat_map(|group| group.chunks((PIXELS_PER_GROUP / group[0].key.0.pow(2)).clamp(1, PER_GROUP)))
            .collect();
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

    /// Draws the windows of a group of galaxies. Returns the windows that reach the region, and the
    /// galaxies with light outside their windows.
    fn draw_group(
        &self,
        catalogue: Catalogue<'_>,
        group: &[Placed],
        region: PixelRegion,
    ) -> Result<(Vec<Piece<T>>, Vec<FarLight>), ConvError> {
        let key = group[0].key;
        let (side, ..) = key;
        let local = (self.shared.options.anchor() != Anchor::Output).then(|| self.local(key));
        let (mut pieces, mut far) = (Vec::new(), Vec::new());
        let mut drawer = WindowDrawer::new(side);
        let weights = BlockWeights::<T>::new(side);
        for placed in group {
            catalogue.progress.check_cancelled()?;
            let galaxy = &catalogue.galaxies[placed.index];
            let (x, y) = catalogue.position(placed.index);
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            let window = window_at((x, y), side);
            let centre = (x - window.0 as f64, y - window.1 as f64);
            let psf = self.psf(local.as_ref(), position, galaxy.flux())?;
            let light = (catalogue.light)(galaxy);
            let on_region = shared(overlap::region(window.0, window.1, (side, side)), region);
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
                        let all = self.exact_window(psf, galaxy.flux(), light, window, centre, frame)?;
                        all.slice(s![rows.clone(), ..]).mapv(T::nearest)
                    }
                });
            }
            // The light outside is kept until all galaxies are drawn, without a transform.
            let outside = placed.reach.and_then(|reach| {
                let moments = match &psf {
                    Psf::Local(local, coefficients) => local.block.kernels.moments_of(coefficients),
                    Psf::Exact(psf) => self.stamps().moments_of(psf.view()),
                };
                self.far_light(moments, light, (x, y), window, reach)
            });
            if let Some((mut values, [(columns, _), (rows, _)])) = drawn.zip(on_region) {
                if let Some(outside) = &outside {
                    outside.subtract_repeated(&weights, rows.start, &mut values);
                }
                let (first_column, first_row) =
                    (window.0 + columns.start as i64, window.1 + rows.start as i64);
                // Windows may be larger than the region.
                if columns.len() < side {
                    values = values.slice(s![.., columns]).to_owned();
                }
                pieces.push(Piece {
                    first_column,
                    first_row,
                    values,
                });
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
    fn psf<'a>(
        &self,
        local: Option<&'a Local<T>>,
        position: Position,
        flux: f64,
    ) -> Result<Psf<'a, T>, ConvError> {
        let mut vectors = StarVectors::new(&self.model, self.space());
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

    fn block(&self, key: BlockKey) -> Arc<Block> {
        let make = || {
            let region = region_of(key, BLOCK);
            let cells = self.space().cells_for_sources(region, self.shared.tolerance);
            let modes = LocalModes::of_exact_cells(self.space(), &cells, MARGIN * self.shared.tolerance);
            // No rows if the PSF has no value in the block. Then each galaxy uses all components.
            let directions = modes.kernels();
            // The values at the corners of cells begin with the flux, also without a reference.
            let values = modes.at_corners(&cells);
            let values = values.slice(s![.., values.ncols() - directions.nrows()..]);
            let largest = values.map_axis(Axis(0), |values| values.fold(0.0_f64, |m, v| m.max(v.abs())));
            let largest = largest.to_vec();
            let typical = LocalModes::mean(self.space(), &cells);
            let kernels = Kernels::new(
                self.stamps(),
                directions,
                &largest,
                typical.view(),
                self.shared.extent.accuracy(),
            );
            Block { modes, kernels }
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
struct Local<T> {
    block: Arc<Block>,
    spectra: Arc<Spectra<T>>,
}

/// The PSF of a galaxy, times its flux.
enum Psf<'a, T> {
    /// The coefficients of the local PSFs.
    Local(&'a Local<T>, Vec<f64>),
    /// The PSF of all components, as a vector of [`PsfSpace`].
    Exact(Array1<f64>),
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
