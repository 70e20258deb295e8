//! `psfield sample FRAME.fits`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use ndarray::{Axis, stack};
use psf_io::Card;
use psf_stars::{CoverageMap, CoverageReport, RegistrationReport, SOURCE_COLUMNS, Saturation, StarSamples};
use serde::Serialize;

use crate::cli::context::{Context, signature};
use crate::cli::star_args::StarArgs;

/// Outputs for frames.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Frames")]
pub(super) struct FrameArgs {
    /// A table of all sources found, with the reasons for which any was rejected
    #[arg(long, value_name = "SOURCES.csv")]
    sources: Option<PathBuf>,
    /// A map of the field by cells: number of samples, distance to the nearest in pixels, whether inside their convex hull
    #[arg(long, value_name = "COVERAGE.fits")]
    coverage: Option<PathBuf>,
}

/// What is asked for.
pub(super) struct FrameSampling<'a> {
    pub(super) path: &'a Path,
    pub(super) threshold: Option<f64>,
    pub(super) output: &'a Path,
    pub(super) overwrite: bool,
}

#[derive(Debug, Serialize)]
struct Report<'a> {
    output: &'a Path,
    samples: usize,
    sources: usize,
    /// Sources rejected for each reason; one may have several.
    rejected: BTreeMap<&'static str, usize>,
    fwhm_px: f64,
    background: f64,
    background_rms: f64,
    saturation: Saturation,
    registration: &'a RegistrationReport,
    coverage: &'a CoverageReport,
}

impl FrameArgs {
    /// The first option given that only frames have.
    pub(super) fn given(&self) -> Option<&'static str> {
        let sources = self.sources.is_some().then_some("--sources");
        sources.or(self.coverage.is_some().then_some("--coverage"))
    }

    pub(super) fn run(
        &self,
        stars: &StarArgs,
        asked: FrameSampling<'_>,
        context: &Context,
    ) -> anyhow::Result<()> {
        for path in [&self.sources, &self.coverage].into_iter().flatten() {
            psf_io::check_output(path, asked.overwrite)?;
        }
        let spinner = context.spinner("finding stars");
        let (frame, _, sampling) = stars.open(asked.path, asked.threshold)?;
        let found = sampling
            .run(&frame)
            .with_context(|| format!("in {}", asked.path.display()))?;
        let cards = signature();
        psf_io::write_samples(
            asked.output,
            &found.samples,
            &cards,
            psf_io::Precision::Single,
            asked.overwrite,
        )?;
        if let Some(path) = &self.sources {
            psf_io::write_csv(path, &SOURCE_COLUMNS, &found.sources, asked.overwrite)?;
        }
        if let Some(path) = &self.coverage {
            write_coverage(path, &found.coverage, asked.overwrite)?;
        }
        drop(spinner);
        warn_of(&found, context);
        let report = Report {
            output: asked.output,
            samples: found.samples.len(),
            sources: found.sources.len(),
            rejected: found
                .rejection_counts()
                .into_iter()
                .map(|(reason, count)| (reason.name(), count))
                .collect(),
            fwhm_px: found.fwhm_px,
            background: found.background.typical_level(),
            background_rms: found.background.typical_rms(),
            saturation: found.saturation,
            registration: &found.registration,
            coverage: found.coverage.report(),
        };
        context.report(&report, || text(&report))
    }
}

/// What a user must know of the samples of a frame.
pub(crate) fn warn_of(found: &StarSamples, context: &Context) {
    for warning in found.coverage.warnings() {
        context.warn(&warning);
    }
    if let Some(level) = found.saturation.ignored {
        context.warn(&format!(
            "SATURATE of the header, {level}, is not above the background ({:.2}): it is ignored; give the true level (--saturation)",
            found.background.typical_level()
        ));
    }
    let registration = &found.registration;
    if registration.undersampled && registration.field_degree.is_none() {
        context.warn(&format!(
            "the stars are undersampled (FWHM {:.2} pixels), and their own pixels are interpolated: the PSF between pixels is smeared. More \
             stars (--snr, --threshold) allow an oversampled PSF (--registration epsf)",
            found.fwhm_px
        ));
    }
}

/// Writes a coverage map: planes of samples in each cell, distance to the nearest sample, inside the hull (1) or not (0).
pub(crate) fn write_coverage(path: &Path, map: &CoverageMap, overwrite: bool) -> anyhow::Result<()> {
    let cube = stack(Axis(0), &[map.counts(), map.distances_px(), map.inside_hull()])?;
    let (width, height) = map.cell_px();
    let mut cards = signature();
    cards.extend([
        Card::new("CELLNX", width, "width of a cell, pixels of the frame")?,
        Card::new("CELLNY", height, "height of a cell, pixels of the frame")?,
        Card::new("PLANE1", "samples", "number of samples in the cell")?,
        Card::new(
            "PLANE2",
            "distance",
            "pixels from its centre to the nearest sample",
        )?,
        Card::new("PLANE3", "inside", "1 inside the convex hull of the samples")?,
    ]);
    Ok(psf_io::write_cube(path, cube.view(), &cards, overwrite)?)
}

fn text(report: &Report<'_>) -> String {
    let rejected: Vec<String> = report
        .rejected
        .iter()
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    let saturation = match report.saturation.level {
        Some(_) => report.saturation.to_string(),
        None => "not known (--saturation)".to_owned(),
    };
    let registration = report.registration;
    let degree = registration.field_degree.map_or_else(String::new, |degree| {
        format!(", polynomial of degree {degree} over the field")
    });
    format!(
        "{}: {} samples of {} sources\n\
         rejected:     {} (a source may have several reasons)\n\
         FWHM:         {:.2} pixels\n\
         background:   {:.2}, r.m.s. {:.2}\n\
         saturation:   {saturation}\n\
         registration: {}, {} x {} stamps at {} x{degree}\n\
         coverage:     {:.0} % of the field outside the outermost samples, largest gap {:.0} pixels",
        report.output.display(),
        report.samples,
        report.sources,
        rejected.join(", "),
        report.fwhm_px,
        report.background,
        report.background_rms,
        registration.method,
        registration.stamp_pixels,
        registration.stamp_pixels,
        registration.oversampling,
        100.0 * report.coverage.outside_hull,
        report.coverage.largest_gap_px,
    )
}
