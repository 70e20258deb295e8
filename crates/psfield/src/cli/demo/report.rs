//! The figures of the demonstration.

use std::path::PathBuf;

use psf_types::FrameShape;
use psfield::SpotCheck;
use serde::Serialize;

/// The figures of the demonstration, also written as `report.json`.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) folder: PathBuf,
    pub(super) files: Vec<String>,
    pub(super) samples: usize,
    pub(super) psfs_drawn: usize,
    pub(super) rank: usize,
    pub(super) elbow: Option<usize>,
    pub(super) fit_max_error: f64,
    /// Relative L2 of the model's PSFs against the telescope's own, at random positions.
    pub(super) model_error_median: f64,
    pub(super) model_error_max: f64,
    pub(super) galaxies: usize,
    pub(super) stars: usize,
    pub(super) fwhm_px_min: f64,
    pub(super) fwhm_px_max: f64,
    pub(super) ellipticity_max: f64,
    pub(super) spot_check: SpotCheck,
    /// Relative L2 of the image by patches against the exact one.
    pub(super) patch: usize,
    pub(super) patch_relative_l2: f64,
    pub(super) seconds: Seconds,
}

/// How long the stages took.
#[derive(Debug, Serialize)]
pub(super) struct Seconds {
    pub(super) sample: f64,
    pub(super) fit: f64,
    pub(super) simulate: f64,
    pub(super) total: f64,
}

impl Report {
    pub(super) fn text(&self, frame: FrameShape) -> String {
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
