//! `psfield demo`.

mod output;
mod report;
mod scene_maker;
mod sky;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use metrics::{Comparison, Summary};
use psf_optics::Telescope;
use psf_sample::{AdaptiveSampling, DifferenceMeasure, InterpolationError, SamplingMethod};
use psf_types::{Anchor, Progress, PsfModel, PsfSamples, PsfSource, Scene};
use psfield::conv_core::PlanOptions;
use psfield::{FitOptions, Method, PsfInput, Simulation, SimulationOptions, SpotCheck, fit};

use super::context::{Context, signature};
use output::{FILES, Output};
use report::{Report, Seconds};
use sky::{GALAXIES, Sky};

/// Run every stage on a built-in telescope and scene
///
/// Samples the PSF of a small survey telescope over its field, fits a model, makes a sky of stars and galaxies, images it, and measures
/// what came out. Writes FITS files, tables, pictures and a report; a minute at most.
#[derive(Debug, clap::Args)]
pub(crate) struct DemoArgs {
    /// The folder to write to; made if it does not exist
    #[arg(long, value_name = "DIR", default_value = "psfield-demo")]
    out: PathBuf,
    /// Replace files that exist there
    #[arg(long)]
    overwrite: bool,
    /// Chooses the stars and galaxies
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const TELESCOPE: &str = include_str!("../../../assets/demo_telescope.toml");
/// Interpolation error at which the sampling stops, relative L2.
const SAMPLING_THRESHOLD: f64 = 0.01;
/// PSFs drawn by the telescope to judge the model.
const JUDGED: usize = 100;
/// Pixels checked against the direct sum.
const SPOT_CHECK: usize = 300;
const PATCH: usize = 128;

impl DemoArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let start = Instant::now();
        let mut out = Output::new(self.out, self.overwrite)?;
        // Nothing is written when anything is in the way.
        for name in FILES {
            psf_io::check_output(out.folder.join(name), self.overwrite)?;
        }
        let telescope = Telescope::from_toml_str(TELESCOPE).context("the demonstration's telescope")?;
        let frame = telescope.field();
        out.text("telescope.toml", TELESCOPE)?;

        let clock = Instant::now();
        let (samples, psfs_drawn) = sample(&telescope, &context.bar("sampling"))?;
        let sample_seconds = clock.elapsed().as_secs_f64();
        out.samples("samples.fits", &samples)?;
        let positions = samples.positions().as_slice().to_vec();
        out.sampling(&positions, frame)?;

        let spinner = context.spinner("fitting");
        let clock = Instant::now();
        let sample_count = samples.len();
        let fitted = fit(samples, &FitOptions::default())?;
        let fit_seconds = clock.elapsed().as_secs_f64();
        let fit_report = fitted.report()?;
        psf_io::write_model(
            out.path("model.fits"),
            fitted.record(),
            fitted.singular_values(),
            &signature(),
            self.overwrite,
        )?;
        let psf = PsfInput::Model(fitted.record().clone());
        let model = fitted.into_model()?;
        let model_errors = judge(&telescope, &model, self.seed)?;
        let (fwhm, ellipticity) = out.psf_map(&model, frame)?;
        drop(spinner);

        let spinner = context.spinner("imaging");
        let sky = Sky::new(frame, self.seed)?;
        out.image("scene.fits", &sky.galaxies, &[])?;
        out.catalogue("stars.csv", &sky.stars)?;
        let scene = Scene::from_image(sky.galaxies.clone()).with_sources(sky.stars.clone());
        let clock = Instant::now();
        let simulation = Simulation::new(psf, &scene, SimulationOptions::default())?;
        let image = simulation.run(&scene, Method::Auto, PlanOptions::default())?;
        let simulate_seconds = clock.elapsed().as_secs_f64();
        let spot_check = SpotCheck::run(&image, SPOT_CHECK, self.seed, |pixels| {
            simulation.exact_at(&scene, Anchor::Source, pixels)
        })?;
        out.image("image.fits", &image, &spot_check.cards()?)?;
        let by_patches = simulation.run(&scene, Method::Patch(PATCH), PlanOptions::default())?;
        let patch_error = Comparison::of(by_patches.pixels(), image.pixels())?.relative_l2()?;
        out.pictures(&sky, &image, &by_patches)?;
        drop(spinner);

        out.files.push("report.json".to_owned());
        let report = Report {
            folder: out.folder.clone(),
            files: out.files.clone(),
            samples: sample_count,
            psfs_drawn,
            rank: fit_report.rank,
            elbow: fit_report.elbow,
            fit_max_error: fit_report.max_error,
            model_error_median: model_errors.median(),
            model_error_max: model_errors.max(),
            galaxies: GALAXIES + 1,
            stars: sky.stars.len(),
            fwhm_px_min: fwhm.min(),
            fwhm_px_max: fwhm.max(),
            ellipticity_max: ellipticity.max(),
            spot_check,
            patch: PATCH,
            patch_relative_l2: patch_error,
            seconds: Seconds {
                sample: sample_seconds,
                fit: fit_seconds,
                simulate: simulate_seconds,
                total: start.elapsed().as_secs_f64(),
            },
        };
        out.write("report.json", &serde_json::to_string_pretty(&report)?)?;
        context.report(&report, || report.text(frame))
    }
}

fn sample(telescope: &Telescope, progress: &dyn Progress) -> anyhow::Result<(PsfSamples, usize)> {
    let criterion = InterpolationError::new(SAMPLING_THRESHOLD, DifferenceMeasure::L2)?;
    let sampling = AdaptiveSampling::new(Arc::new(criterion)).sample(telescope, progress)?;
    Ok((sampling.samples, sampling.report.draws))
}

/// Relative L2 errors of the model's PSFs at random positions, against PSFs that the telescope draws there.
fn judge(telescope: &Telescope, model: &PsfModel, seed: u64) -> anyhow::Result<Summary> {
    let positions = scene_maker::random_positions(telescope.field(), JUDGED, seed)?;
    let errors = positions.into_iter().map(|position| {
        let drawn = telescope.draw(position)?;
        let unit_flux = drawn.values().mapv(|v| v / drawn.flux());
        Ok(Comparison::of(model.psf_at(position)?.values(), unit_flux.view())?.relative_l2()?)
    });
    Ok(Summary::of(errors.collect::<anyhow::Result<Vec<f64>>>()?)?)
}
