//! Measures the results of the paper (Bai, Jia et al. 2025) anew.

use std::sync::Arc;
use std::time::Instant;

use conv_core::PlanOptions;
use psf_optics::Telescope;
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, SampleError, SamplingMethod, UniformSampling,
};
use psf_types::{FrameShape, NoProgress, Position, Progress, PsfSource};
use psfield::FitOptions;
use psfield::fit::{FitReport, fit, model_of};
use serde::Serialize;

use crate::LabError;
use crate::bench::BenchOutcome;
use crate::report::document::load;
use crate::report::patch_comparison::patch_comparison;
use crate::report::scenes::{GALAXY, Scenes};
use crate::report::{
    ColourComparison, ErrorSummary, Evaluation, FrameComparison, GalaxyComparison, ModelRow, Target,
};

/// All results of the paper from which psfield's method comes (Bai, Jia et al. 2025), measured on
/// psfield's own survey telescope.
///
/// The optics ([`Telescope::survey_2m`]) are sampled on a regular grid, and a model is fitted with
/// the default settings. The fast engine draws objects on the whole frame, with Fourier transforms
/// for all tiles: stars as single pixels with light, and small galaxies. Each object is compared
/// with its true image, which is computed from the optics at the object's own position. The truth
/// does not depend on the model.
///
/// ```no_run
/// use psfield::psf_types::NoProgress;
/// use psfield_lab::report::{Reproduction, ReproductionOptions};
/// let reproduction = Reproduction::run(&ReproductionOptions::quick(), &NoProgress)?;
/// for target in &reproduction.targets {
///     println!("{}: {:?}, should be below {}", target.what, target.measured, target.limit);
/// }
/// # Ok::<(), psfield_lab::LabError>(())
/// ```
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Reproduction {
    /// The telescope's name.
    pub telescope: String,
    /// Columns and rows of the frame.
    pub frame: FrameShape,
    /// Columns and rows of a stamp.
    pub stamp: [usize; 2],
    /// Number of uniform samples.
    pub samples: usize,
    /// Number of objects of each kind.
    pub objects: usize,
    /// Shape of every galaxy: half-light radius in pixels, Sersic index, axis ratio, angle in
    /// degrees.
    pub galaxy: [f64; 4],
    /// The engine's tolerance for the figures and the targets. It is the engine's default.
    pub tolerance: f64,
    /// Errors and choices of the fit to the samples.
    pub basis: FitReport,
    /// Number of samples of the non-uniform sampling, which is shown next to the uniform sampling.
    pub adaptive_samples: usize,
    /// Threshold of the non-uniform sampling: relative L2 error of the interpolation.
    pub adaptive_threshold: f64,
    /// The targets. Those for stars and galaxies hold at the default tolerance.
    pub targets: Vec<Target>,
    /// Errors at several tolerances, by kind of object.
    pub tolerances: Vec<ToleranceRow>,
    /// Errors of the model for each interpolator, without the error of the fast engine. The first
    /// interpolator is that of the report.
    pub interpolations: Vec<ModelRow>,
    /// Errors of models with fewer samples.
    pub fewer_samples: Vec<ModelRow>,
    /// Errors of the model with all its components, then with fewer and fewer.
    pub fewer_components: Vec<ModelRow>,
    /// Stars at the default tolerance.
    pub stars: Evaluation,
    /// Galaxies at the default tolerance.
    pub galaxies: Evaluation,
    /// Run time and error of patches and of psfield at each size of the image, as in Table 1 of the
    /// paper.
    pub table_1: Vec<BenchOutcome>,
    /// A large galaxy, convolved by psfield and by patches, which leave seams.
    pub large_galaxy: GalaxyComparison,
    /// Stars of several temperatures, compared with the optics.
    pub colours: ColourComparison,
    /// Frames with one basis.
    pub frames: FrameComparison,
    /// Date and time of the start (UTC).
    pub started: String,
    /// The machine's load at the start: the average number of processes that ran or waited during
    /// the minute before. Other processes make run times longer. None if the system does not report
    /// the load.
    pub load: Option<f64>,
    /// Run time in seconds.
    pub seconds: f64,
    /// Positions of the uniform samples.
    #[serde(skip)]
    pub sample_positions: Vec<Position>,
    /// Positions of the non-uniform samples.
    #[serde(skip)]
    pub adaptive_positions: Vec<Position>,
}

/// A kind of object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ObjectKind {
    /// A single pixel with light.
    Point,
    /// A small galaxy.
    Extended,
}

/// Errors of the objects of a kind at a tolerance.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ToleranceRow {
    /// The engine's tolerance.
    pub tolerance: f64,
    /// The kind of object.
    pub kind: ObjectKind,
    /// The errors of the objects.
    pub summary: ErrorSummary,
    /// Seconds to simulate the image of the whole frame, without the time of the plan.
    pub seconds: f64,
}

/// Number of patches along each side of the large galaxy.
const PATCHES_ACROSS: usize = 8;

impl Reproduction {
    /// Measures all results.
    ///
    /// # Errors
    /// [`LabError`] if any stage fails. [`LabError::ObjectsTooClose`] if the frame has no room for
    /// the objects.
    pub fn run(options: &ReproductionOptions, progress: &dyn Progress) -> Result<Self, LabError> {
        let (started, load, start) = (psfield::image_cards::utc_now(), load(), Instant::now());
        let mut tolerances = options.tolerances.clone();
        let default = PlanOptions::DEFAULT_TOLERANCE;
        if !tolerances.contains(&default) {
            tolerances.push(default);
        }
        progress.start(10 + tolerances.len() as u64);
        let telescope = telescope_on(options.frame)?;
        let (frame, grid, across) = (telescope.field(), telescope.grid(), options.samples_across);
        let sampling = UniformSampling::new(across, across)?.sample(&telescope, &NoProgress)?;
        let samples = stage(progress, sampling.samples);
        let sample_positions = samples.positions().as_slice().to_vec();
        let adaptive_positions = adaptive_positions(&telescope, options.adaptive_threshold)?;
        let fitted = stage(progress, fit(samples, &FitOptions::default())?);
        let record = fitted.record();
        let model = stage(progress, model_of(record.clone())?);
        let scenes = stage(progress, Scenes::new(&telescope, options.objects_across)?);

        let (mut tolerance_rows, mut shown) = (Vec::new(), None);
        for &tolerance in &tolerances {
            let drawn = stage(progress, scenes.drawn(&model, tolerance, &mut tolerance_rows)?);
            if tolerance == default {
                shown = Some(drawn);
            }
        }
        let (stars, galaxies) = shown.expect("the tolerances include the default");
        let interpolations = stage(progress, ModelRow::of_interpolations(&fitted, across, &scenes)?);
        let fewer_samples = ModelRow::of_fewer_samples(&telescope, across, &scenes)?;
        let fewer_components = stage(progress, ModelRow::of_fewer_components(&fitted, across, &scenes)?);
        let table_1 = stage(progress, patch_comparison(record, options)?);
        let patch = (options.galaxy_side / PATCHES_ACROSS).max(1);
        let galaxy = GalaxyComparison::measure(record, options.galaxy_side, patch)?;
        let large_galaxy = stage(progress, galaxy);
        let colours = ColourComparison::measure(&telescope, options.colour_samples_across)?;
        let colours = stage(progress, colours);
        let frames = stage(progress, FrameComparison::measure(options.seed)?);

        let mut targets = Target::of("stars", &stars.summary);
        targets.extend(Target::of("galaxies", &galaxies.summary));
        targets.extend(colours.targets());
        targets.push(frames.target());
        Ok(Self {
            telescope: telescope.params().name.clone(),
            frame,
            stamp: [grid.nx(), grid.ny()],
            samples: sample_positions.len(),
            objects: scenes.positions.len(),
            galaxy: GALAXY,
            tolerance: default,
            basis: fitted.report()?,
            adaptive_samples: adaptive_positions.len(),
            adaptive_threshold: options.adaptive_threshold,
            targets,
            tolerances: tolerance_rows,
            interpolations,
            fewer_samples,
            fewer_components,
            stars,
            galaxies,
            table_1,
            large_galaxy,
            colours,
            frames,
            started,
            load,
            seconds: start.elapsed().as_secs_f64(),
            sample_positions,
            adaptive_positions,
        })
    }
}

/// Reports that a stage is done, and returns its result.
fn stage<T>(progress: &dyn Progress, result: T) -> T {
    progress.advance(1);
    result
}

/// Returns the survey telescope with a frame of this size. The optics vary over this frame as over
/// the telescope's own frame. None: the telescope keeps its own frame.
fn telescope_on(frame: Option<FrameShape>) -> Result<Telescope, LabError> {
    let telescope = Telescope::survey_2m();
    let Some(frame) = frame else { return Ok(telescope) };
    let mut params = telescope.params().clone();
    (params.frame.nx, params.frame.ny) = (frame.nx(), frame.ny());
    Ok(Telescope::new(params)?)
}

/// Samples the PSF non-uniformly, and returns the positions of the samples. The number of draws
/// may reach its limit before the error is below `threshold`. All samples drawn are then used.
fn adaptive_positions(source: &dyn PsfSource, threshold: f64) -> Result<Vec<Position>, LabError> {
    let criterion = InterpolationError::new(threshold, DifferenceMeasure::L2)?;
    let sampling = match AdaptiveSampling::new(Arc::new(criterion)).sample(source, &NoProgress) {
        Err(SampleError::NotMet(found)) => found.into_sampling(),
        other => other?,
    };
    Ok(sampling.samples.positions().as_slice().to_vec())
}

/// Sizes and settings of a [`Reproduction`](crate::report::Reproduction). Smaller sizes run the
/// same code on less data.
#[derive(Debug, Clone, PartialEq)]
pub struct ReproductionOptions {
    /// The frame. The optics vary over a frame of any size as over the telescope's own frame. None:
    /// the telescope's own frame.
    pub frame: Option<FrameShape>,
    /// Number of PSF samples along each axis.
    pub samples_across: usize,
    /// Number of objects along each axis.
    pub objects_across: usize,
    /// Tolerances of the fast engine. The default tolerance is added if it is missing.
    pub tolerances: Vec<f64>,
    /// Sides of the images of Table 1, in pixels.
    pub image_sides: Vec<usize>,
    /// Sides of the square patches of Table 1, in pixels. Every patch has one PSF, and each side is
    /// a separate row of the table.
    pub patches: Vec<usize>,
    /// Number of timed turns of each method in Table 1.
    pub repeat: usize,
    /// Side of the image of the large galaxy, in pixels.
    pub galaxy_side: usize,
    /// Threshold of the interpolation error (relative L2) for the non-uniform sampling, which is
    /// shown next to the uniform sampling.
    pub adaptive_threshold: f64,
    /// Number of PSF samples along each axis, at each wavelength, for the stars of several colours.
    pub colour_samples_across: usize,
    /// Seed for the light of the images of Table 1, for the pixels at which they are compared, and
    /// for the stars of the frames with one basis.
    pub seed: u64,
}

impl ReproductionOptions {
    /// The sizes of the paper: 71 x 71 = 5041 samples, 54 x 54 = 2916 objects, the telescope's own
    /// frame.
    pub fn full() -> Self {
        Self {
            frame: None,
            samples_across: 71,
            objects_across: 54,
            tolerances: vec![1e-2, 1e-3, 1e-4, 1e-5],
            image_sides: vec![512, 1024],
            patches: vec![32, 64, 128, 256],
            repeat: 5,
            galaxy_side: 512,
            adaptive_threshold: 1e-3,
            colour_samples_across: 24,
            seed: 1,
        }
    }

    /// Smaller sizes: a frame with a quarter of the side, a quarter of the samples, a ninth of the
    /// objects, a smaller image of the large galaxy, fewer timed turns, fewer samples for the stars
    /// of several colours, and a larger `adaptive_threshold`.
    pub fn quick() -> Self {
        Self {
            frame: FrameShape::new(2308, 2304).ok(),
            samples_across: 36,
            objects_across: 18,
            repeat: 2,
            galaxy_side: 256,
            adaptive_threshold: 4e-3,
            colour_samples_across: 14,
            ..Self::full()
        }
    }
}
