//! Compares the fast engine with patches of constant PSF.

use conv_core::{ConvolutionMethod, Direct, PlanOptions};
use metrics::Comparison;
use ndarray::Array2;
use psf_types::{Anchor, FrameShape, NoProgress, Position, PsfModelRecord, SersicProfile, SersicSource};
use psfield::fit::model_of;
use psfield::{Device, Method, Psf, Scene};
use serde::Serialize;

use crate::LabError;
use crate::bench::{BenchCase, BenchOptions, BenchOutcome, Contender, lit_scene, run, stretched};
use crate::report::ReproductionOptions;

/// Measures run time and error of patches and of the fast engine, at each size of the image. Every
/// pixel of the images has light. The field of the PSF is stretched to each image, so that each image
/// shows the full variation of the PSF.
///
/// # Errors
/// The errors of [`stretched`], [`lit_scene`] and [`run`].
pub(super) fn patch_comparison(
    record: &PsfModelRecord,
    options: &ReproductionOptions,
) -> Result<Vec<BenchOutcome>, LabError> {
    let tolerances = [1e-3, PlanOptions::DEFAULT_TOLERANCE];
    let lowrank = tolerances
        .map(|tolerance| Contender::LowRank { tolerance })
        .into_iter();
    let patches = options.patches.iter().map(|&size| Contender::Patch { size });
    let contenders: Vec<Contender> = lowrank.chain(patches).collect();
    let seed = options.seed;
    let settings = BenchOptions {
        repeat: options.repeat,
        seed,
        ..BenchOptions::default()
    };
    let of_side = |&side: &usize| {
        let frame = FrameShape::new(side, side)?;
        let case = BenchCase::new(stretched(record, frame)?, lit_scene::<f32>(frame, seed)?);
        Ok(run(&case, &contenders, &settings, &NoProgress)?)
    };
    options.image_sides.iter().map(of_side).collect()
}

/// A large galaxy, convolved by the fast engine, by patches and by the direct sum.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GalaxyComparison {
    /// Pixels along each side of the image. The PSF varies over the image as over the whole field.
    pub side: usize,
    /// Pixels along each side of a patch.
    pub patch: usize,
    /// Relative L2 error of the patches against the direct sum.
    pub patch_relative_l2: f64,
    /// Largest absolute error of the patches, divided by the peak of the direct sum.
    pub patch_max_over_peak: f64,
    /// Relative L2 error of the fast engine against the direct sum. The engine uses Fourier
    /// transforms for all tiles, and its default tolerance.
    pub lowrank_relative_l2: f64,
    /// Largest absolute error of the fast engine, divided by the peak of the direct sum.
    pub lowrank_max_over_peak: f64,
    /// The galaxy before the convolution.
    #[serde(skip)]
    pub original: Array2<f64>,
    /// The result of the fast engine.
    #[serde(skip)]
    pub lowrank: Array2<f64>,
    /// The result of the patches.
    #[serde(skip)]
    pub patches: Array2<f64>,
    /// The result of the direct sum.
    #[serde(skip)]
    pub exact: Array2<f64>,
}

/// Half-light radius of the galaxy as a fraction of the image's side.
const GALAXY_SIZE: f64 = 0.12;

impl GalaxyComparison {
    /// Convolves a galaxy in the middle of the frame by three methods: the fast engine, patches and
    /// the direct sum.
    ///
    /// # Errors
    /// The errors of [`stretched`], of the convolutions and of the comparison.
    pub(super) fn measure(record: &PsfModelRecord, side: usize, patch: usize) -> Result<Self, LabError> {
        let frame = FrameShape::new(side, side)?;
        let model = model_of(stretched(record, frame)?)?;
        let middle = (side - 1) as f64 / 2.0;
        let profile = SersicProfile::new(GALAXY_SIZE * side as f64, 1.0, 0.6, 30.0)?;
        let galaxy = SersicSource::new(Position::new(middle, middle)?, 1e6, profile)?;
        let light = psfield::light_on_pixels::<f64>(&[galaxy], frame)?;
        let original = light.pixels().to_owned();
        let exact = Direct::new(Anchor::Source)
            .convolve(&model, &light.view(), frame.region(), &NoProgress)?
            .into_pixels();
        let psf = Psf::from(model);
        let by = |method| -> Result<Array2<f64>, LabError> {
            let simulator = psf.simulator((side, side)).method(method).device(Device::Cpu);
            Ok(simulator.build()?.simulate(&Scene::from(&light))?.into_pixels())
        };
        let (lowrank, patches) = (by(Method::LowRank)?, by(Method::Patch(patch))?);
        let of_patches = Comparison::of(patches.view(), exact.view())?;
        let of_lowrank = Comparison::of(lowrank.view(), exact.view())?;
        Ok(Self {
            side,
            patch,
            patch_relative_l2: of_patches.relative_l2()?,
            patch_max_over_peak: of_patches.max_over_peak()?,
            lowrank_relative_l2: of_lowrank.relative_l2()?,
            lowrank_max_over_peak: of_lowrank.max_over_peak()?,
            original,
            lowrank,
            patches,
            exact,
        })
    }
}
