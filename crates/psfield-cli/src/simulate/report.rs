//! The report of `psfield simulate`.

use std::path::{Path, PathBuf};

use conv_core::{DroppedLight, PhotonReport, PlanSummary, TileCounts};
use detector::ExposureReport;
use psf_types::{Anchor, Normalisation, ToleranceOn};
use psfield::SpotCheck;
use psfield::device::Placement;
use serde::{Serialize, Serializer};

use crate::context::object;

/// The object that `--json` prints.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(super) output: PathBuf,
    pub(super) method: String,
    pub(super) anchor: Anchor,
    pub(super) precision: &'static str,
    /// The tolerance, for methods that have one.
    pub(super) tolerance: Option<f64>,
    /// The errors that the tolerance bounds.
    pub(super) tolerance_on: Option<ToleranceOn>,
    /// Light of sources below it may be dropped, in flux per pixel.
    pub(super) floor: Option<f64>,
    /// Upper limits of the light that is dropped, if there is a floor.
    #[serde(serialize_with = "dropped_figures")]
    pub(super) dropped: Option<DroppedLight>,
    /// The sources that were drawn photon by photon.
    #[serde(serialize_with = "shot_figures")]
    pub(super) shot: Option<PhotonReport>,
    /// The meaning of the values of the scene's image, if there is one.
    pub(super) scene_pixels: Option<String>,
    /// Components of the model, the mean not counted.
    pub(super) rank: usize,
    /// With a plan, the mean number of modes per block of tiles (a tile needs one convolution per
    /// mode). Otherwise the number of stamps of the model.
    pub(super) modes: f64,
    pub(super) normalise: Normalisation,
    pub(super) shape: [usize; 2],
    /// Point sources.
    pub(super) sources: usize,
    pub(super) galaxies: usize,
    /// Invalid rows of the catalogue, which were skipped.
    pub(super) invalid_rows: usize,
    /// Rows of the catalogue at positions on the sky that the projection does not reach. They were
    /// skipped.
    pub(super) rows_off_projection: usize,
    /// NaN pixels of the scene, which `--nan-as` replaced.
    pub(super) nan_pixels: usize,
    /// True if the scene was read and the image written in bands of rows.
    pub(super) streamed: bool,
    #[serde(serialize_with = "plan_figures")]
    pub(super) plan: Option<PlanSummary>,
    /// Number of tiles for each way of computing them, if there is a plan.
    #[serde(serialize_with = "tile_figures")]
    pub(super) tiles: Option<TileCounts>,
    #[serde(serialize_with = "with_text")]
    pub(super) device: Placement,
    pub(super) seconds: Seconds,
    pub(super) peak_memory_bytes: Option<u64>,
    pub(super) spot_check: Option<SpotCheck>,
    /// The report of the detector, if there is one.
    pub(super) exposure: Option<ExposureReport>,
}

/// Seconds of each stage. `plan` is the time in which the engine is prepared.
#[derive(Debug, Default, Serialize)]
pub(super) struct Seconds {
    pub(super) read: f64,
    pub(super) fit: f64,
    pub(super) plan: f64,
    pub(super) execute: f64,
    pub(super) write: f64,
}

/// Writes the device of the convolution, with its description as text.
fn with_text<S: Serializer>(placement: &Placement, serializer: S) -> Result<S::Ok, S::Error> {
    object! {
        #[serde(flatten)]
        placement,
        text: placement.to_string(),
    }
    .serialize(serializer)
}

#[allow(clippy::ref_option, reason = "serde passes a reference to the field")]
fn plan_figures<S: Serializer>(plan: &Option<PlanSummary>, serializer: S) -> Result<S::Ok, S::Error> {
    let figures = plan.as_ref().map(|plan| {
        object! {
            tile: plan.tile,
            transform: plan.transform,
            tiles: plan.tiles,
            blocks: plan.blocks,
            blocks_by_modes: &plan.blocks_by_modes,
            drawn_up_to: plan.drawn_up_to,
            predicted_seconds_one_thread: plan.predicted_seconds,
            kept_bytes: plan.kept_bytes.0 + plan.kept_bytes.1,
        }
    });
    figures.serialize(serializer)
}

#[allow(clippy::ref_option, reason = "serde passes a reference to the field")]
fn tile_figures<S: Serializer>(counts: &Option<TileCounts>, serializer: S) -> Result<S::Ok, S::Error> {
    let figures = counts.map(|counts| {
        object! {
            dark: counts.dark,
            drawn: counts.drawn,
            direct: counts.direct,
            transformed: counts.transformed,
            drawn_pixels: counts.drawn_pixels,
        }
    });
    figures.serialize(serializer)
}

#[allow(clippy::ref_option, reason = "serde passes a reference to the field")]
fn dropped_figures<S: Serializer>(dropped: &Option<DroppedLight>, serializer: S) -> Result<S::Ok, S::Error> {
    let figures = dropped.as_ref().map(|dropped| {
        object! {
            largest: dropped.largest(),
            fraction: dropped.fraction(),
        }
    });
    figures.serialize(serializer)
}

#[allow(clippy::ref_option, reason = "serde passes a reference to the field")]
fn shot_figures<S: Serializer>(shot: &Option<PhotonReport>, serializer: S) -> Result<S::Ok, S::Error> {
    let figures = shot.map(|shot| {
        object! {
            sources: shot.sources,
            photons: shot.photons,
        }
    });
    figures.serialize(serializer)
}

/// Returns an error if the image in the file `written` failed its spot check.
pub(crate) fn verdict(check: &SpotCheck, written: &Path) -> anyhow::Result<()> {
    anyhow::ensure!(
        check.passed != Some(false),
        "{} was written, but it failed its spot check: it differs from the direct sum by more than the method promises. Do not use the image",
        written.display()
    );
    Ok(())
}

impl Report {
    /// Returns an error if the image failed its spot check.
    pub(crate) fn verdict(&self) -> anyhow::Result<()> {
        self.spot_check
            .as_ref()
            .map_or(Ok(()), |check| verdict(check, &self.output))
            .map_err(|error| anyhow::anyhow!("{error}, but choose another --method, such as direct"))
    }

    pub(crate) fn text(&self) -> String {
        let [nx, ny] = self.shape;
        let s = &self.seconds;
        let plan = self.plan.as_ref().map_or_else(String::new, |plan| {
            format!("plan: {}\n", plan.to_string().replace('\n', "\n  "))
        });
        let tiles = self.tiles.as_ref().map_or_else(String::new, |t| {
            format!(
                "tiles: {} by transforms, {} by direct sums, {} by drawing stamps, {} without light; lit pixels drawn as stamps: {}\n",
                t.transformed, t.direct, t.drawn, t.dark, t.drawn_pixels
            )
        });
        let check = self.spot_check.as_ref().map_or_else(String::new, |check| {
            let over_peak = check
                .max_over_peak
                .map_or_else(String::new, |m| format!(" ({m:.1e} of the peak)"));
            let relative = check
                .relative_rms
                .map_or_else(String::new, |r| format!(" ({r:.1e} of the sum's r.m.s.)"));
            let part = |worst: Option<f64>| {
                worst.map_or_else(String::new, |w| format!("; errors at most {w:.1e} of their limits"))
            };
            let sources = if check.sources > 0 {
                format!("\n  around {} sources{}", check.sources, part(check.worst_source))
            } else {
                String::new()
            };
            format!(
                "spot check against the direct sum, {} pixels: largest difference {:.2e}{over_peak}, r.m.s. {:.2e}{relative}{}{sources}\n",
                check.pixels, check.max_abs, check.rms, part(check.worst_pixel),
            )
        });
        let sources: Vec<String> = [
            (self.sources, "star", "stars"),
            (self.galaxies, "galaxy", "galaxies"),
            (self.invalid_rows, "invalid row skipped", "invalid rows skipped"),
            (
                self.rows_off_projection,
                "row outside the sky projection skipped",
                "rows outside the sky projection skipped",
            ),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, one, more)| format!("{count} {}", if count == 1 { one } else { more }))
        .collect();
        let sources = if sources.is_empty() {
            String::new()
        } else {
            format!("catalogue: {}\n", sources.join(", "))
        };
        let replaced = match self.nan_pixels {
            0 => String::new(),
            count => format!("NaN pixels of the scene that were replaced: {count}\n"),
        };
        let dropped = self.dropped.as_ref().map_or_else(String::new, |dropped| {
            format!(
                "dropped light: at most {:.2e} in any pixel, {:.1e} of the flux\n",
                dropped.largest(),
                dropped.fraction()
            )
        });
        let shot = self.shot.map_or_else(String::new, |shot| {
            let unchecked = if self.spot_check.is_some() {
                ", not in the spot check"
            } else {
                ""
            };
            format!(
                "drawn photon by photon: {} sources, {} photons{unchecked}\n",
                shot.sources, shot.photons
            )
        });
        let exposure = self.exposure.as_ref().map_or_else(String::new, |e| {
            format!(
                "detector: sky {} e, dark {} e, seed {}; pixels: {} saturated, {} bad, {} below 0 before noise\n",
                e.mean_sky_e, e.dark_e, e.seed, e.saturated_pixels, e.bad_pixels, e.negative_pixels
            )
        });
        let streamed = if self.streamed { ", streamed" } else { "" };
        format!(
            "{}: {nx} x {ny} pixels, rank {}, method {}, anchor {}, {}{streamed}\n{sources}{dropped}{shot}{replaced}{plan}{tiles}{exposure}\
             device: {}\n\
             seconds: read {:.3}, fit {:.3}, plan {:.3}, convolve {:.3}, write {:.3}\n{check}",
            self.output.display(),
            self.rank,
            self.method,
            self.anchor,
            self.precision,
            self.device,
            s.read,
            s.fit,
            s.plan,
            s.execute,
            s.write,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_that_differs_fails() {
        for (passed, fails) in [(None, false), (Some(true), false), (Some(false), true)] {
            let mut check = SpotCheck::default();
            check.passed = passed;
            let result = verdict(&check, Path::new("image.fits"));
            assert_eq!(result.is_err(), fails);
            let text = result.map_or_else(|e| e.to_string(), |()| "image.fits".to_owned());
            assert!(text.contains("image.fits"), "{text}");
        }
    }
}
