//! `psfield validate` without a reference: the round trip of a frame.

use anyhow::Context as _;
use psf_io::HeaderCards;
use psf_stars::SOURCE_COLUMNS;
use psf_types::Image;
use psfield_lab::plot::{Axis, Chart, Curve, Figure};
use psfield_lab::{
    Agreement, Distribution, ROUND_TRIP_COLUMNS, RoundTrip, RoundTripOptions, RoundTripRow, StarComparison,
};

use super::ValidateArgs;
use crate::context::{Context, object, signature, with_window_hint, write_samples};
use crate::report_folder::ReportFolder;
use crate::sample::{warn_of, write_coverage};

/// Options of a round trip.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Only without --reference")]
pub(super) struct RoundTripArgs {
    /// Simulate without noise
    #[arg(long, conflicts_with_all = ["reference", "realisations"])]
    no_noise: bool,
    /// Number of simulated frames, each with its own noise (the first is written)
    #[arg(long, value_name = "N", conflicts_with = "reference", default_value_t = RoundTripOptions::DEFAULT_REALISATIONS, value_parser = clap::value_parser!(u32).range(1..=1000))]
    realisations: u32,
    /// Seed of the noise
    #[arg(long, value_name = "N", conflicts_with = "reference", default_value_t = 1)]
    seed: u64,
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
    "summary.json",
    "distributions.svg",
];

impl RoundTripArgs {
    pub(super) fn run(&self, asked: &ValidateArgs, context: &Context) -> anyhow::Result<()> {
        asked.folder.check(&FILES)?;
        let spinner = context.spinner("round trip");
        let (frame, header, sampling) = asked.stars.open(&asked.input, &asked.mask)?;
        let options = RoundTripOptions {
            sampling,
            fit: asked.psf.fit.options(),
            window: asked.window.map(usize::from),
            noise: !self.no_noise,
            gain: asked.stars.gain,
            realisations: self.realisations,
            seed: self.seed,
        };
        let trip = RoundTrip::run(frame, &options)
            .map_err(with_window_hint)
            .with_context(|| format!("in {}", asked.input.display()))?;
        let report = object! {
            frame: &asked.input,
            folder: &asked.folder.report,
            files: FILES,
            star_fwhm_px: trip.stars.fwhm_px,
            registration: &trip.stars.registration,
            #[serde(flatten)]
            figures: &trip.report,
        };
        write(
            &trip,
            &header,
            &serde_json::to_string_pretty(&report)?,
            &asked.folder,
        )?;
        drop(spinner);
        warn_of(&trip.stars, context);
        context.report(&report, || {
            let figures = report.figures;
            let left_out = figures.left_out.as_ref().map_or_else(
                || {
                    let why = figures.left_out_error.as_deref();
                    format!("no stars were left out: {}", why.unwrap_or("there are too few"))
                },
                |stars| format!("each star drawn by a model made without it:\n{}", lines(stars)),
            );
            format!(
                "{}: {} stars ({} registration), {} measured in frame and simulation, {} sources drawn, {} simulated frame(s)\n{}\n{left_out}\n\
                 flux ratio: simulated / frame within {:.1} pixels of the star. The reduced chi-square includes {}",
                report.folder.display(),
                figures.stars,
                report.registration.method,
                figures.all.measured,
                figures.drawn,
                figures.realisations,
                lines(&figures.all),
                figures.aperture_px,
                if figures.photon_noise {
                    "the noise of background and photons"
                } else {
                    "the noise of the background, but not of photons (no --gain)"
                }
            )
        })
    }
}

/// Writes all files. The figure is the last, so that an error in drawing loses no measurement.
fn write(trip: &RoundTrip, header: &HeaderCards, summary: &str, folder: &ReportFolder) -> anyhow::Result<()> {
    folder.make()?;
    let at = |name: &str| folder.report.join(name);
    let cards = signature();
    let overwrite = folder.overwrite;
    write_samples(&at("samples.fits"), &trip.stars.samples, overwrite)?;
    psf_io::write_csv(at("sources.csv"), SOURCE_COLUMNS, &trip.stars.sources, overwrite)?;
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
    text("summary.json", summary)?;
    Ok(text("distributions.svg", &distributions(trip).svg())?)
}

/// Compares drawn stars with the frame in four lines of text.
fn lines(stars: &StarComparison) -> String {
    let shape = |name: &str, agreement: &Agreement| {
        format!(
            "{name} median {:.3} in the frame, {:.3} simulated (simulated / frame {:.3}), mean absolute difference per star {:.3}, KS distance {:.3}",
            agreement.frame.median,
            agreement.simulated.median,
            agreement.median_ratio,
            agreement.mean_absolute_error,
            agreement.ks_distance
        )
    };
    let light = |name: &str, of: Option<&Distribution>| match of {
        Some(of) => format!(
            "{name} median {:.3}, quartiles {:.3} and {:.3}, scatter {:.3} ({} isolated stars)",
            of.median, of.q25, of.q75, of.scatter, of.count
        ),
        None => format!("{name} no star is isolated"),
    };
    [
        shape("FWHM (px):         ", &stars.fwhm_px),
        shape("eccentricity:      ", &stars.eccentricity),
        light("flux ratio:        ", stars.flux_ratio.as_ref()),
        light("reduced chi-square:", stars.reduced_chi_square.as_ref()),
    ]
    .join("\n")
}

/// Draws the cumulative distributions of FWHM and eccentricity, for the stars of the frame and for
/// the simulated stars.
fn distributions(trip: &RoundTrip) -> Figure {
    let both = |row: &&RoundTripRow| row.fwhm_frame_px.is_some() && row.fwhm_simulated_px.is_some();
    let chart = |title: &str, quantity, of: fn(&RoundTripRow) -> Option<f64>, simulated: &[f64]| {
        let frame = trip.rows.iter().filter(both).filter_map(of);
        let curves = vec![
            Curve::distribution("input frame", frame),
            Curve::distribution("simulated", simulated.iter().copied()),
        ];
        let y = Axis::linear("cumulative fraction of stars");
        Chart::new(title, Axis::linear(quantity), y, curves)
    };
    let (fwhm, eccentricity) = (&trip.simulated_fwhm_px, &trip.simulated_eccentricity);
    let name = "eccentricity sqrt(1 - b^2 / a^2)";
    let charts = [
        chart("FWHM", "FWHM (pixels)", |row| row.fwhm_frame_px, fwhm),
        chart("eccentricity", name, |row| row.eccentricity_frame, eccentricity),
    ];
    Figure::new(&charts, 550.0)
}
