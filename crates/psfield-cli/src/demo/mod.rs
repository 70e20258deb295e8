//! `psfield demo`.

mod output;
mod sky;

use std::time::Instant;

use anyhow::Context as _;
use metrics::Comparison;
use psf_optics::Telescope;
use psf_sample::{SamplingOptions, hold_out};
use psf_types::{FrameShape, NoProgress, Progress, PsfModelRecord, PsfSamples, PsfSource};
use psfield::convert::PsfFormat;
use psfield::{Device, FitOptions, Method, Psf, Scene, SpotCheck};
use psfield_lab::bench::model_errors;

use crate::context::{Context, object, signature, write_samples};
use crate::demo::output::{FILES, Output};
use crate::demo::sky::{GALAXIES, STARS, Sky};
use crate::files::OutputFolder;
use crate::simulate::verdict;

/// Run every stage on a built-in telescope and scene
///
/// Samples the PSF of a small survey telescope over its field, fits a model, simulates the image of
/// a scene with stars and galaxies, and measures the result. Writes FITS files, tables, pictures
/// and a report. Of the scene, scene.fits holds the galaxies and stars.csv the stars. Takes 10 to
/// 20 seconds on two cores.
#[derive(Debug, clap::Args)]
pub(crate) struct DemoArgs {
    /// Folder to write to (made if it does not exist)
    #[arg(long, value_name = "DIR", default_value = "psfield-demo")]
    out: OutputFolder,
    /// Replace files that exist in the folder
    #[arg(long)]
    overwrite: bool,
    /// Seed for the stars, the galaxies and the random positions of the checks
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const TELESCOPE: &str = include_str!("../../assets/demo_telescope.toml");
/// Error of predicted PSFs (relative L2) at which the sampling stops.
const SAMPLING_THRESHOLD: f64 = 0.01;
/// Number of PSFs with which the model is compared.
const TEST_PSFS: usize = 100;
/// Number of pixels checked against the direct sum.
const SPOT_CHECK: usize = 300;
const PATCH: usize = 128;

impl DemoArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let start = Instant::now();
        let mut out = Output::new(self.out.to_path_buf(), self.overwrite)?;
        // Nothing is written if one of the files exists and must be kept.
        for name in FILES {
            psf_io::check_output(out.folder.join(name), self.overwrite)?;
        }
        let telescope = Telescope::from_toml_str(TELESCOPE).context("the demonstration's telescope")?;
        let frame = telescope.field();
        psf_io::write_text(out.path("telescope.toml"), TELESCOPE, self.overwrite)?;

        let (samples, psfs_drawn, sample_seconds) = sample(&telescope, &context.bar("sampling"))?;
        write_samples(&out.path("samples.fits"), &samples, self.overwrite)?;
        out.sampling(samples.positions().as_slice(), frame)?;

        let spinner = context.spinner("fitting");
        let (checks, sample_count) = ((TEST_PSFS, self.seed), samples.len());
        let held_out = hold_out(&telescope, samples.positions(), checks, &NoProgress)?;
        let clock = Instant::now();
        let psf = Psf::new(samples, FitOptions::default());
        let fitted = psf.fit()?.expect("samples have a fit");
        let fit_seconds = clock.elapsed().as_secs_f64();
        let fit_report = fitted.report()?;
        psf.write(
            out.path("model.fits"),
            &PsfFormat::Model,
            &signature(),
            self.overwrite,
        )?;
        let model = psf.model()?;
        let model_errors = model_errors(&held_out.into_unit_flux(), model)?;
        let [fwhm, ellipticity, eccentricity] = out.psf_map(model, frame)?;
        drop(spinner);

        let spinner = context.spinner("imaging");
        let (spot_check, patch_error, simulate_seconds) = image(&mut out, fitted.record(), frame, self.seed)?;
        drop(spinner);

        let path = out.path("report.json");
        let [(fwhm_min, fwhm_max), (_, e_max), (_, eccentricity_max)] =
            [fwhm, ellipticity, eccentricity].map(|of| (of.min(), of.max()));
        let (error_median, error_max) = (model_errors.median(), model_errors.max());
        let (rank, elbow, fit_error) = (fit_report.rank, fit_report.elbow, fit_report.max_error);
        let (galaxies, seconds) = (GALAXIES + 1, start.elapsed().as_secs_f64());
        let report = object! {
            folder: out.folder.clone(),
            files: out.files.clone(),
            samples: sample_count,
            psfs_drawn,
            rank,
            elbow,
            fit_max_error: fit_error,
            // Errors of the model's PSFs against the telescope's own, at random positions.
            model_error_median: error_median,
            model_error_max: error_max,
            galaxies,
            stars: STARS,
            fwhm_px_min: fwhm_min,
            fwhm_px_max: fwhm_max,
            // |e| = (a^2 - b^2) / (a^2 + b^2), from adaptive moments.
            ellipticity_max: e_max,
            // sqrt(1 - b^2 / a^2), from the Gaussian fit.
            eccentricity_max,
            spot_check,
            // Pixels along each side of a patch.
            patch: PATCH,
            // Relative L2 difference of the image made by patches from the default image.
            patch_relative_l2: patch_error,
            seconds: object! {
                sample: sample_seconds,
                fit: fit_seconds,
                simulate: simulate_seconds,
                total: seconds,
            },
        };
        psf_io::write_text(path, &serde_json::to_string_pretty(&report)?, self.overwrite)?;
        context.report(&report, || {
            let elbow = elbow.map_or_else(|| "-".to_owned(), |elbow| elbow.to_string());
            let (pixels, largest) = (report.spot_check.pixels, report.spot_check.max_abs);
            let of_peak = report.spot_check.max_over_peak;
            let of_peak = of_peak.map_or_else(String::new, |m| format!(" ({m:.1e} of the peak)"));
            let (count, folder) = (report.files.len(), report.folder.display());
            format!(
                "sampled   {sample_count} PSFs over {frame} pixels ({psfs_drawn} computed in all) in {sample_seconds:.2} s\n\
                 fitted    {rank} components (elbow at {elbow}), largest fit error {fit_error:.1e} (relative L2), in {fit_seconds:.2} s\n\
                 model     PSFs differ from the telescope's own by {error_median:.1e} (median), {error_max:.1e} (largest, relative L2)\n\
                 PSF       FWHM {fwhm_min:.2} to {fwhm_max:.2} pixels, ellipticity |e| up to {e_max:.2}\n\
                 simulated {galaxies} galaxies and {STARS} stars in {simulate_seconds:.2} s\n\
                 checked   {pixels} pixels against the direct sum: largest difference {largest:.1e}{of_peak}\n\
                 patches   with sides of {PATCH} pixels: their image differs from image.fits by {patch_error:.1e} (relative L2): see patch_error.svg\n\
                 wrote     {count} files to {folder} in {seconds:.1} s: start with image.png, psf_field.svg and report.json\n"
            )
        })?;
        verdict(&report.spot_check, &report.folder.join("image.fits"))
    }
}

/// Samples the telescope's PSF. Returns the samples, the number of PSFs computed, and the seconds.
fn sample(telescope: &Telescope, progress: &dyn Progress) -> anyhow::Result<(PsfSamples, usize, f64)> {
    let clock = Instant::now();
    let options = SamplingOptions {
        threshold: SAMPLING_THRESHOLD,
        ..SamplingOptions::default()
    };
    let sampling = options.method()?.sample(telescope, progress)?;
    let seconds = clock.elapsed().as_secs_f64();
    Ok((sampling.samples, sampling.report.draws, seconds))
}

/// Simulates a scene with the default method and by patches. Returns the spot check of the default
/// image, the relative L2 error of the image made by patches, and the seconds for the default
/// image.
fn image(
    out: &mut Output,
    record: &PsfModelRecord,
    frame: FrameShape,
    seed: u64,
) -> anyhow::Result<(SpotCheck, f64, f64)> {
    let sky = Sky::new(frame, seed)?;
    out.image("scene.fits", &sky.galaxies, &[])?;
    out.catalogue("stars.csv", &sky.stars)?;
    let scene = Scene::from(&sky.galaxies).with_stars(sky.stars.as_slice());
    let by = |method| {
        let simulator = Psf::from(record.clone()).simulator((frame.ny(), frame.nx()));
        simulator.method(method).device(Device::Cpu).build()
    };
    let clock = Instant::now();
    let simulator = by(Method::Auto)?;
    let image = simulator.simulate(&scene)?;
    let simulate_seconds = clock.elapsed().as_secs_f64();
    let spot_check = simulator.spot_check(&scene, &image, (SPOT_CHECK, seed), &NoProgress)?;
    out.image("image.fits", &image, &spot_check.cards()?)?;
    let by_patches = by(Method::Patch(PATCH))?.simulate(&scene)?;
    let patch_error = Comparison::of(by_patches.pixels(), image.pixels())?.relative_l2()?;
    out.pictures(&sky, &image, &by_patches)?;
    Ok((spot_check, patch_error, simulate_seconds))
}
