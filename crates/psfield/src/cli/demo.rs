//! `psfield demo`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use metrics::{Comparison, Summary};
use psf_io::{Card, HeaderCards, IoError};
use psf_optics::Telescope;
use psf_sample::{AdaptiveSampling, DifferenceMeasure, InterpolationError, SamplingMethod};
use psf_types::{
    Anchor, FrameShape, Image, PointSource, Position, Progress, PsfModel, PsfSamples, PsfSource, Scene,
};
use psfield::{
    EvaluateOptions, FitOptions, MEASUREMENT_COLUMNS, MeasureOptions, Method, PsfInput, Simulation,
    SpotCheck, evaluate, fit,
};
use serde::Serialize;

use super::context::{Context, signature};
use super::{preview, scene_maker};

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

const TELESCOPE: &str = include_str!("../../assets/demo_telescope.toml");
/// Interpolation error at which the sampling stops, relative L2.
const SAMPLING_THRESHOLD: f64 = 0.01;
const GALAXIES: usize = 400;
const STARS: usize = 2500;
/// PSFs drawn by the telescope to judge the model.
const JUDGED: usize = 100;
/// Pixels checked against the direct sum.
const SPOT_CHECK: usize = 300;
const PATCH: usize = 128;
/// Sky of the previews' stretch, flux a pixel.
const SOFT: f32 = 30.0;

/// Where things are written.
struct Output {
    folder: PathBuf,
    overwrite: bool,
    files: Vec<String>,
}

/// The figures of the demonstration, also written as `report.json`.
#[derive(Debug, Serialize)]
struct Report {
    folder: PathBuf,
    files: Vec<String>,
    samples: usize,
    psfs_drawn: usize,
    rank: usize,
    elbow: Option<usize>,
    fit_max_error: f64,
    /// Relative L2 of the model's PSFs against the telescope's own, at random positions.
    model_error_median: f64,
    model_error_max: f64,
    galaxies: usize,
    stars: usize,
    fwhm_px_min: f64,
    fwhm_px_max: f64,
    ellipticity_max: f64,
    spot_check: SpotCheck,
    /// Relative L2 of the image by patches against the exact one.
    patch: usize,
    patch_relative_l2: f64,
    seconds: Seconds,
}

#[derive(Debug, Serialize)]
struct Seconds {
    sample: f64,
    fit: f64,
    simulate: f64,
    total: f64,
}

/// Stars and galaxies of a frame.
struct Sky {
    galaxies: Image<f32>,
    stars: Vec<PointSource>,
}

impl DemoArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let start = Instant::now();
        let mut out = Output::new(self.out, self.overwrite)?;
        let telescope = Telescope::from_toml_str(TELESCOPE).context("the demonstration's telescope")?;
        let frame = telescope.field();
        out.text("telescope.toml", TELESCOPE)?;

        let clock = Instant::now();
        let (samples, psfs_drawn) = sample(&telescope, &context.bar("sampling"))?;
        let sample_seconds = clock.elapsed().as_secs_f64();
        out.samples("samples.fits", &samples)?;
        let positions = samples.positions().as_slice().to_vec();
        out.picture(
            "sampling.png",
            &preview::positions_picture(&positions, frame, 768),
        )?;

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
        let scene = Scene::from_image(sky.galaxies.clone()).with_sources(sky.stars.clone())?;
        let clock = Instant::now();
        let simulation = Simulation::new(psf, &scene, None)?;
        let image = simulation.run(&scene, Method::Auto, Anchor::Source)?;
        let simulate_seconds = clock.elapsed().as_secs_f64();
        let spot_check = SpotCheck::run(&image, SPOT_CHECK, self.seed, |pixels| {
            simulation.exact_at(&scene, Anchor::Source, pixels)
        })?;
        out.image("image.fits", &image, &check_cards(&spot_check)?)?;
        let by_patches = simulation.run(&scene, Method::Patch(PATCH), Anchor::Source)?;
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

fn check_cards(check: &SpotCheck) -> anyhow::Result<Vec<Card>> {
    Ok(vec![
        Card::new("PSFCHKN", check.pixels, "pixels checked against the direct sum")?,
        Card::new("PSFCHKM", check.max_abs, "largest difference found")?,
        Card::new("PSFCHKR", check.rms, "r.m.s. difference found")?,
    ])
}

impl Sky {
    fn new(frame: FrameShape, seed: u64) -> anyhow::Result<Self> {
        let (galaxies, stars) = scene_maker::make_scene(frame, GALAXIES, STARS, seed)?;
        Ok(Self {
            galaxies: Image::new(galaxies)?,
            stars,
        })
    }

    /// The sky on pixels, each star in the pixel it falls on: what a perfect telescope would show.
    fn sharp(&self) -> ndarray::Array2<f32> {
        let mut pixels = self.galaxies.pixels().to_owned();
        for star in &self.stars {
            let (x, y) = (star.position.x().round(), star.position.y().round());
            if x >= 0.0
                && y >= 0.0
                && let Some(pixel) = pixels.get_mut((y as usize, x as usize))
            {
                *pixel += star.flux as f32;
            }
        }
        pixels
    }
}

impl Output {
    fn new(folder: PathBuf, overwrite: bool) -> anyhow::Result<Self> {
        std::fs::create_dir_all(&folder)
            .map_err(|source| IoError::Write {
                path: folder.clone(),
                source,
            })
            .context("the output folder could not be made")?;
        Ok(Self {
            folder,
            overwrite,
            files: Vec::new(),
        })
    }

    /// The path of a file, which counts as written from here on.
    fn path(&mut self, name: &str) -> PathBuf {
        self.files.push(name.to_owned());
        self.folder.join(name)
    }

    fn write(&self, name: &str, content: &str) -> anyhow::Result<()> {
        let path = self.folder.join(name);
        psf_io::write_atomically(&path, self.overwrite, |temporary: &Path| {
            std::fs::write(temporary, content).map_err(|source| IoError::Write {
                path: path.clone(),
                source,
            })
        })?;
        Ok(())
    }

    fn text(&mut self, name: &str, content: &str) -> anyhow::Result<()> {
        self.files.push(name.to_owned());
        self.write(name, content)
    }

    fn samples(&mut self, name: &str, samples: &PsfSamples) -> anyhow::Result<()> {
        let path = self.path(name);
        Ok(psf_io::write_samples(
            path,
            samples,
            &signature(),
            psf_io::Precision::Single,
            self.overwrite,
        )?)
    }

    fn image(&mut self, name: &str, image: &Image<f32>, cards: &[Card]) -> anyhow::Result<()> {
        let path = self.path(name);
        let cards: Vec<Card> = signature().into_iter().chain(cards.iter().cloned()).collect();
        Ok(psf_io::write_image(
            path,
            image,
            &HeaderCards::new(),
            &cards,
            self.overwrite,
        )?)
    }

    fn catalogue(&mut self, name: &str, stars: &[PointSource]) -> anyhow::Result<()> {
        let path = self.path(name);
        let rows = stars
            .iter()
            .map(|star| (star.position.x(), star.position.y(), star.flux));
        Ok(psf_io::write_csv(
            path,
            &["x", "y", "flux"],
            rows,
            self.overwrite,
        )?)
    }

    fn picture<P>(&mut self, name: &str, picture: &image::ImageBuffer<P, Vec<u8>>) -> anyhow::Result<()>
    where
        P: image::Pixel<Subpixel = u8> + image::PixelWithColorType,
    {
        let path = self.path(name);
        preview::write_png(&path, picture, self.overwrite)
    }

    /// The PSFs on a grid over the frame, as a picture and as a table of measurements: their widths and ellipticities.
    fn psf_map(&mut self, model: &PsfModel, frame: FrameShape) -> anyhow::Result<(Summary, Summary)> {
        const ACROSS: usize = 9;
        let at = |k: usize, n: usize| (n - 1) as f64 * k as f64 / (ACROSS - 1) as f64;
        let positions: Result<Vec<Position>, _> = (0..ACROSS * ACROSS)
            .map(|k| Position::new(at(k % ACROSS, frame.nx()), at(k / ACROSS, frame.ny())))
            .collect();
        let stamps = evaluate(model, positions?, EvaluateOptions::default())?;
        self.picture(
            "psf_field.png",
            &preview::mosaic_picture(stamps.stamps(), ACROSS, 2),
        )?;
        let rows = MeasureOptions::default().cube(stamps.stamps(), Some(stamps.positions().as_slice()));
        let path = self.path("psf_measurements.csv");
        psf_io::write_csv(path, &MEASUREMENT_COLUMNS, &rows, self.overwrite)?;
        let fwhm = Summary::of(rows.iter().filter_map(|row| row.fwhm_px))?;
        let ellipticity = Summary::of(rows.iter().filter_map(|row| row.ellipticity))?;
        Ok((fwhm, ellipticity))
    }

    fn pictures(&mut self, sky: &Sky, image: &Image<f32>, by_patches: &Image<f32>) -> anyhow::Result<()> {
        // One stretch for both, so that they can be compared.
        let high = preview::quantile(image.pixels(), 0.9995)?.max(SOFT);
        let stretch = |pixels: ndarray::ArrayView2<'_, f32>| preview::asinh_picture(pixels, 0.0, SOFT, high);
        self.picture("scene.png", &stretch(sky.sharp().view()))?;
        self.picture("image.png", &stretch(image.pixels()))?;
        let difference = &by_patches.pixels() - &image.pixels();
        let scale = preview::quantile(difference.mapv(f32::abs).view(), 0.995)?.max(f32::MIN_POSITIVE);
        self.picture(
            "patch_error.png",
            &preview::difference_picture(difference.view(), scale),
        )
    }
}

impl Report {
    fn text(&self, frame: FrameShape) -> String {
        let s = &self.seconds;
        let check = &self.spot_check;
        format!(
            "sampled   {} PSFs over {frame} pixels ({} drawn) in {:.2} s\n\
             fitted    {} components (elbow at {}), largest fit error {:.1e}, in {:.2} s\n\
             model     off by {:.1e} (median), {:.1e} (largest) from the telescope's own PSFs\n\
             PSF       FWHM {:.2} to {:.2} pixels, ellipticity up to {:.2}\n\
             imaged    {} galaxies and {} stars in {:.2} s\n\
             checked   {} pixels against the direct sum: largest difference {:.1e}{}\n\
             patches   of {} pixels are off by {:.1e} (relative L2): see patch_error.png\n\
             wrote     {} files to {} in {:.1} s: begin with image.png, psf_field.png and report.json\n",
            self.samples,
            self.psfs_drawn,
            s.sample,
            self.rank,
            self.elbow.map_or_else(|| "-".to_owned(), |e| e.to_string()),
            self.fit_max_error,
            s.fit,
            self.model_error_median,
            self.model_error_max,
            self.fwhm_px_min,
            self.fwhm_px_max,
            self.ellipticity_max,
            self.galaxies,
            self.stars,
            s.simulate,
            check.pixels,
            check.max_abs,
            check
                .max_over_peak
                .map_or_else(String::new, |m| format!(" ({m:.1e} of the peak)")),
            self.patch,
            self.patch_relative_l2,
            self.files.len(),
            self.folder.display(),
            s.total,
        )
    }
}
