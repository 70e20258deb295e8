//! `psfield roundtrip`.

use std::path::PathBuf;

use anyhow::Context as _;
use psf_io::HeaderCards;
use psf_stars::{Detection, SOURCE_COLUMNS};
use psf_types::Image;
use psfield_lab::plot::{Axis, Curve, Curves, Figure, PlotError, curve_panels};
use psfield_lab::{ROUND_TRIP_COLUMNS, RoundTrip, RoundTripOptions};

use super::context::{Context, object, signature, with_window_hint, write_samples};
use super::files::OutputFolder;
use super::report_folder;
use super::sample::{warn_of, write_coverage};
use super::star_args::StarArgs;
use super::values::above_zero;
use crate::psf_args::FitArgs;

/// Make a PSF from the stars of a frame, simulate the frame with it, and compare the stars
///
/// Makes PSF samples from the frame's stars, fits a model, and simulates the frame: all sources
/// found, at their measured positions and fluxes, on the measured background. Then compares FWHM
/// and eccentricity of the same stars in the frame and in the simulation.
///
/// The frame is simulated several times (--realisations), each time with other noise, because noise
/// widens the distributions of FWHM and eccentricity. The noise is that of the background, and with
/// --gain also the photon noise of the stars. The simulated distributions contain the stars of all
/// simulated frames.
///
/// summary.json has, among others, the keys stars (stars that became PSF samples), measured (stars
/// measured in both the frame and the first simulated frame), drawn (sources drawn into each
/// simulated frame), and residual_over_noise (r.m.s. of the frame minus the first simulated frame,
/// divided by the background noise).
#[derive(Debug, clap::Args)]
pub(crate) struct RoundTripArgs {
    /// Image with stars
    #[arg(value_name = "FRAME.fits")]
    frame: PathBuf,
    /// Folder for tables, figures, frames, samples and model
    #[arg(long, value_name = "DIR")]
    report: OutputFolder,
    /// Replace files that exist
    #[arg(long)]
    overwrite: bool,
    #[arg(long, value_name = "X", value_parser = above_zero, help = format!("Detection threshold (sigma) [default: {}]", Detection::DEFAULT_THRESHOLD))]
    threshold: Option<f64>,
    /// Measure stars in N x N pixels [default: four FWHM, at least 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(5..))]
    window: Option<u16>,
    /// Simulate without noise
    #[arg(long, conflicts_with = "realisations")]
    no_noise: bool,
    /// Number of simulated frames, each with its own noise (the first is written)
    #[arg(long, value_name = "N", default_value_t = RoundTripOptions::DEFAULT_REALISATIONS, value_parser = clap::value_parser!(u32).range(1..=1000))]
    realisations: u32,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    stars: StarArgs,
    #[command(flatten)]
    fit: FitArgs,
}

/// All files that are written.
const FILES: [&str; 9] = [
    "samples.fits",
    "sources.csv",
    "coverage.fits",
    "model.fits",
    "simulated.fits",
    "residual.fits",
    "stars.csv",
    "distributions.svg",
    "summary.json",
];

impl RoundTripArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let spinner = context.spinner("round trip");
        let (frame, header, sampling) = self.stars.open(&self.frame, self.threshold)?;
        let options = RoundTripOptions {
            sampling,
            fit: self.fit.options(),
            window: self.window.map(usize::from),
            noise: !self.no_noise,
            gain: self.stars.gain,
            realisations: self.realisations,
            seed: self.seed,
        };
        report_folder::check(&self.report, &FILES, self.overwrite)?;
        let trip = RoundTrip::run(&frame, &options)
            .map_err(with_window_hint)
            .with_context(|| format!("in {}", self.frame.display()))?;
        let report = object! {
            frame: &self.frame,
            folder: &self.report,
            files: FILES,
            star_fwhm_px: trip.stars.fwhm_px,
            registration: &trip.stars.registration,
            #[serde(flatten)]
            figures: &trip.report,
        };
        self.write(&trip, &header, &serde_json::to_string_pretty(&report)?)?;
        drop(spinner);
        warn_of(&trip.stars, context);
        context.report(&report, || {
            let figures = report.figures;
            let line = |name: &str, agreement: &psfield_lab::Agreement| {
                format!(
                    "{name}  median {:.3} in the frame, {:.3} simulated (simulated / frame {:.3}), mean absolute difference per star {:.3}, KS distance {:.3}",
                    agreement.frame.median,
                    agreement.simulated.median,
                    agreement.median_ratio,
                    agreement.mean_absolute_error,
                    agreement.ks_distance
                )
            };
            format!(
                "{}: {} stars ({} registration), {} measured in both, {} sources drawn, {} simulated frame(s)\n{}\n{}",
                report.folder.display(),
                figures.stars,
                report.registration.method,
                figures.measured,
                figures.drawn,
                figures.realisations,
                line("FWHM (px):   ", &figures.fwhm_px),
                line("eccentricity:", &figures.eccentricity),
            )
        })
    }

    fn write(&self, trip: &RoundTrip, header: &HeaderCards, summary: &str) -> anyhow::Result<()> {
        report_folder::make(&self.report)?;
        let at = |name: &str| self.report.join(name);
        let cards = signature();
        let overwrite = self.overwrite;
        write_samples(&at("samples.fits"), &trip.stars.samples, overwrite)?;
        psf_io::write_csv(at("sources.csv"), &SOURCE_COLUMNS, &trip.stars.sources, overwrite)?;
        write_coverage(&at("coverage.fits"), &trip.stars.coverage, overwrite)?;
        psf_io::write_model(
            at("model.fits"),
            &trip.model,
            &trip.singular_values,
            &cards,
            overwrite,
        )?;
        let image = |name: &str, image: &Image<f64>, header: &HeaderCards| -> anyhow::Result<()> {
            let single = Image::new(image.pixels().mapv(|v| v as f32))?;
            Ok(psf_io::write_image(at(name), &single, header, &cards, overwrite)?)
        };
        image("simulated.fits", &trip.simulated, header)?;
        image("residual.fits", &trip.residual, header)?;
        psf_io::write_csv(at("stars.csv"), ROUND_TRIP_COLUMNS, &trip.rows, overwrite)?;
        let text = |name: &str, content: &str| psf_io::write_text(at(name), content, overwrite);
        text("distributions.svg", distributions(trip)?.svg())?;
        Ok(text("summary.json", summary)?)
    }
}

/// Draws the cumulative distributions of FWHM and eccentricity, for the stars of the frame and for
/// the simulated stars.
fn distributions(trip: &RoundTrip) -> Result<Figure, PlotError> {
    let both =
        |row: &&psfield_lab::RoundTripRow| row.fwhm_frame_px.is_some() && row.fwhm_simulated_px.is_some();
    let rows = || trip.rows.iter().filter(both);
    let panel = |title: &str, quantity, frame: Vec<f64>, simulated: &[f64]| {
        let curves = Curves {
            x: Axis::linear(quantity),
            y: Axis::linear("cumulative fraction of stars"),
            curves: vec![
                Curve::distribution("input frame", frame),
                Curve::distribution("simulated", simulated.iter().copied()),
            ],
            marks: Vec::new(),
        };
        (title.to_owned(), curves)
    };
    curve_panels(&[
        panel(
            "FWHM",
            "FWHM (pixels)",
            rows().filter_map(|row| row.fwhm_frame_px).collect(),
            &trip.simulated_fwhm_px,
        ),
        panel(
            "eccentricity",
            "eccentricity sqrt(1 - b^2 / a^2)",
            rows().filter_map(|row| row.eccentricity_frame).collect(),
            &trip.simulated_eccentricity,
        ),
    ])
}
