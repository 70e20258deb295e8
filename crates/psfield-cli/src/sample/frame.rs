//! `psfield sample` of a frame with stars.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use ndarray::{Axis, stack};
use psf_io::Card;
use psf_stars::{CoverageMap, SOURCE_COLUMNS, StarSamples};
use psf_types::PsfSamples;

use super::SampleArgs;
use crate::context::{Context, object, signature};
use crate::files::OutputFile;

/// Outputs that exist only for frames.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Only for a frame")]
pub(super) struct FrameArgs {
    /// Also write a table of all sources found, with the reasons why some were rejected
    #[arg(long, value_name = "SOURCES.csv")]
    sources: Option<OutputFile>,
    /// Also write a coverage map of the field
    ///
    /// Three planes over the cells of the map: number of samples, distance to the nearest sample
    /// (pixels), and 1 inside the convex hull of the samples or 0 outside.
    #[arg(long, value_name = "COVERAGE.fits", hide_short_help = true)]
    coverage: Option<OutputFile>,
}

impl FrameArgs {
    pub(super) fn run(&self, path: &Path, asked: &SampleArgs, context: &Context) -> anyhow::Result<()> {
        let seed = asked.seed(false, "for a frame")?;
        let spinner = context.spinner("finding stars");
        let (frame, _, sampling) = asked.stars.open(path, &asked.mask)?;
        let found = sampling
            .with_hold_out(asked.hold_out.map_or(0, usize::from), seed)
            .run_masked(frame)
            .with_context(|| format!("in {}", path.display()))?;
        psf_io::write_together(|| -> anyhow::Result<()> {
            if let Some(path) = &self.sources {
                psf_io::write_csv(path, SOURCE_COLUMNS, &found.sources, asked.overwrite)?;
            }
            if let Some(path) = &self.coverage {
                write_coverage(path, &found.coverage, asked.overwrite)?;
            }
            asked.write(&found.samples, found.held_out.as_ref())
        })?;
        drop(spinner);
        warn_of(&found, context);
        let (held_out, wanted) = (found.held_out.as_ref().map_or(0, PsfSamples::len), asked.hold_out);
        if let Some(wanted) = wanted.filter(|&wanted| held_out < usize::from(wanted)) {
            context.warn(&format!(
                "only {held_out} of the {wanted} stars of --hold-out could be written: the pixels of the others have no flux"
            ));
        }
        // Number of rejected sources for each reason. A source may be rejected for several reasons.
        let counts = found.rejection_counts().into_iter();
        let rejected: BTreeMap<&str, usize> = counts.map(|(reason, count)| (reason.name(), count)).collect();
        let report = object! {
            output: &asked.output,
            samples: found.samples.len(),
            hold_out: asked.hold_out_file(),
            held_out: found.held_out.as_ref().map(PsfSamples::len),
            sources: found.sources.len(),
            rejected: &rejected,
            fwhm_px: found.fwhm_px,
            background: found.background.typical_level(),
            background_rms: found.background.typical_rms(),
            saturation: found.saturation,
            registration: &found.registration,
            coverage: found.coverage.report(),
        };
        context.report(&report, || {
            let rejected: Vec<String> = rejected
                .iter()
                .map(|(name, count)| format!("{count} {name}"))
                .collect();
            let saturation = match found.saturation.level {
                Some(_) => found.saturation.to_string(),
                None => "unknown (give --saturation)".to_owned(),
            };
            let registration = &found.registration;
            let degree = registration.field_degree.map_or_else(String::new, |degree| {
                format!(", polynomial of degree {degree} over the field")
            });
            format!(
                "{}: {} samples of {} sources\n\
                 rejected:     {} (one source may have several reasons)\n\
                 FWHM:         {:.2} pixels\n\
                 background:   {:.2}, r.m.s. {:.2}\n\
                 saturation:   {saturation}\n\
                 registration: {}, stamps of {} x {} pixels, {} per frame pixel{degree}\n\
                 coverage:     {:.0} % of the field is outside the outermost samples, largest distance to a sample {:.0} pixels{}",
                report.output.display(),
                report.samples,
                report.sources,
                if rejected.is_empty() { "none".to_owned() } else { rejected.join(", ") },
                report.fwhm_px,
                report.background,
                report.background_rms,
                registration.method,
                registration.stamp_pixels,
                registration.stamp_pixels,
                registration.oversampling,
                100.0 * report.coverage.outside_hull,
                report.coverage.largest_gap_px,
                asked.held_out_text(found.held_out.as_ref()),
            )
        })
    }
}

/// Noise of samples above this part of their norm is warned of.
const NOISY_STAMPS: f64 = 0.1;

/// Prints the warnings about the samples of a frame.
pub(crate) fn warn_of(found: &StarSamples, context: &Context) {
    for warning in found.coverage.warnings() {
        context.warn(&warning);
    }
    if let Some(level) = found.saturation.ignored {
        context.warn(&format!(
            "SATURATE = {level} in the header is not above the background ({:.2}) and is ignored: give the true level (--saturation)",
            found.background.typical_level()
        ));
    }
    let registration = &found.registration;
    if let Some(noise) = registration.stamp_noise.filter(|noise| *noise > NOISY_STAMPS) {
        context.warn(&format!(
            "the samples are the stars' own pixels, half of them with noise above {:.0} % of their norm: a model of them has this \
             noise, unless many stars share its components (more or brighter stars, or --registration epsf)",
            100.0 * noise
        ));
    }
    if registration.undersampled && registration.field_degree.is_none() {
        context.warn(&format!(
            "the stars are undersampled (FWHM {:.2} pixels) and their pixels are interpolated, which smears the PSF: more stars \
             (lower --snr or --detection-threshold) allow an oversampled PSF (--registration epsf)",
            found.fwhm_px
        ));
    }
}

/// Writes a coverage map with three planes: number of samples in each cell, distance to the nearest
/// sample, and 1 inside the convex hull of the samples or 0 outside.
pub(crate) fn write_coverage(path: &Path, map: &CoverageMap, overwrite: bool) -> anyhow::Result<()> {
    let cube = stack(Axis(0), &[map.counts(), map.distances_px(), map.inside_hull()])?;
    let (width, height) = map.cell_px();
    let mut cards = signature();
    cards.extend([
        Card::new("CELLNX", width, "width of a cell, pixels of the frame")?,
        Card::new("CELLNY", height, "height of a cell, pixels of the frame")?,
        Card::new("PLANE1", "samples", "number of samples in the cell")?,
        Card::new("PLANE2", "distance", "pixels from cell centre to nearest sample")?,
        Card::new("PLANE3", "inside", "1 inside the convex hull of the samples")?,
    ]);
    Ok(psf_io::write_cube(path, cube.view(), &cards, overwrite)?)
}
