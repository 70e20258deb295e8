//! `psfield compare`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use metrics::{Comparison, MetricsError, Summary};
use ndarray::{Array3, Axis};
use psf_io::{FileKind, HduChoice, IoError};
use serde::{Serialize, Serializer};

use super::context::{Context, object};

/// Compare an image (or a cube) with a reference
///
/// Prints measures of the difference between the result F and the reference T: mean absolute error
/// (MAE), mean squared error (MSE), relative L2 = |F - T| / |T|, largest difference, largest
/// difference / peak of T, MAE / mean of T, and signal-to-noise ratio (SNR in dB: T is the signal,
/// F - T is the noise).
///
/// For cubes, prints the median of each measure over the planes, and its value in the worst plane.
/// If a measure is not defined, for example because T is 0, prints "-" (null in JSON).
#[derive(Debug, clap::Args)]
pub(crate) struct CompareArgs {
    /// Image or cube to compare (the result F)
    #[arg(value_name = "RESULT.fits")]
    result: PathBuf,
    /// Image or cube to compare it with (the reference T)
    #[arg(value_name = "REFERENCE.fits")]
    reference: PathBuf,
    /// HDU of the result: its number (0: primary), NAME or NAME,VERSION [default: the primary
    /// image, else the only one]
    #[arg(long, value_name = "N|NAME")]
    extension: Option<HduChoice>,
    /// HDU of the reference: its number (0: primary), NAME or NAME,VERSION [default: the primary
    /// image, else the only one]
    #[arg(long, value_name = "N|NAME")]
    reference_extension: Option<HduChoice>,
}

/// A measure: its key in JSON, its name, whether it exists for every reference, and its value.
type Measure = (&'static str, &'static str, bool, fn(&Comparison) -> Option<f64>);

const SNR: &str = "snr_db";
const MEASURES: [Measure; 7] = [
    ("mae", "MAE", true, |c| Some(c.mae())),
    ("mse", "MSE", true, |c| Some(c.mse())),
    ("relative_l2", "relative L2", false, |c| c.relative_l2().ok()),
    ("max_abs", "largest", true, |c| Some(c.max_abs())),
    ("max_over_peak", "largest/peak", false, |c| c.max_over_peak().ok()),
    ("mae_over_mean", "MAE/mean", false, |c| c.mae_over_mean().ok()),
    (SNR, "SNR (dB)", false, |c| c.snr_db().ok()),
];

/// The values of [`MEASURES`] for one image, or a statistic of each over the planes of a cube. None
/// (null in JSON) if the measure is not defined, for example for a reference of zeros.
#[derive(Debug)]
struct Measures([Option<f64>; 7]);

impl Serialize for Measures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(MEASURES.iter().map(|measure| measure.0).zip(self.0))
    }
}

impl CompareArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let (result, result_is_cube) = read(&self.result, self.extension.as_ref(), "hdu")?;
        let extension = self.reference_extension.as_ref();
        let (reference, reference_is_cube) = read(&self.reference, extension, "reference_extension")?;
        let planes = Comparison::by_plane(result.view(), reference.view()).with_context(|| {
            format!(
                "comparing {} with {}",
                self.result.display(),
                self.reference.display()
            )
        })?;
        if result_is_cube || reference_is_cube {
            let report = object! {
                planes: planes.len(),
                median: Measures::over(&planes, Summary::median, Summary::median)?,
                // For each measure, the value in the plane where it is worst.
                max: Measures::over(&planes, Summary::max, Summary::min)?,
            };
            context.report(&report, || {
                let median = report.median.text();
                let max = report.max.text();
                format!(
                    "{} planes\nmedian over the planes\n{median}\nworst plane for each measure\n{max}",
                    report.planes
                )
            })
        } else {
            let report = Measures::of(&planes[0]);
            context.report(&report, || report.text())
        }
    }
}

/// Reads a cube, or an image as a cube of one plane. Also returns whether the file holds a cube.
/// `setting`: the setting that errors name if another HDU must be chosen.
fn read(
    path: &Path,
    extension: Option<&HduChoice>,
    setting: &'static str,
) -> anyhow::Result<(Array3<f64>, bool)> {
    let named = |error: IoError| match error.setting() {
        Some("hdu") => error.with_setting(setting),
        _ => error,
    };
    Ok(match psf_io::detect_hdu(path, extension).map_err(named)? {
        FileKind::PsfModel => anyhow::bail!(
            "{} is a PSF model: compare its PSFs at chosen positions (psfield evaluate writes them)",
            path.display()
        ),
        FileKind::PsfSamples | FileKind::Cube => {
            let cube = psf_io::read_cube_hdu::<f64>(path, extension);
            (cube.map_err(named)?, true)
        }
        _ => (
            psf_io::read_image_hdu::<f64>(path, extension)
                .map_err(named)?
                .into_parts()
                .0
                .into_pixels()
                .insert_axis(Axis(0)),
            false,
        ),
    })
}

impl Measures {
    fn of(comparison: &Comparison) -> Self {
        Self(MEASURES.map(|(.., of)| of(comparison)))
    }

    /// Reduces the values of each measure in the planes to one value: by `of_snr` for the
    /// signal-to-noise ratio, by `of_errors` for the others. A measure that is not defined in every
    /// plane is None.
    fn over(
        planes: &[Comparison],
        of_errors: fn(&Summary) -> f64,
        of_snr: fn(&Summary) -> f64,
    ) -> Result<Self, MetricsError> {
        let mut all = [None; 7];
        for (value, (key, _, always, of)) in all.iter_mut().zip(MEASURES) {
            let Some(values) = planes.iter().map(of).collect::<Option<Vec<f64>>>() else {
                continue;
            };
            let statistic = if key == SNR { of_snr } else { of_errors };
            *value = match Summary::of(values) {
                Err(error) if always => return Err(error),
                summary => summary.ok().as_ref().map(statistic),
            };
        }
        Ok(Self(all))
    }

    fn text(&self) -> String {
        let lines = MEASURES.iter().zip(self.0).map(|(&(key, name, ..), value)| {
            let value = match value {
                None => "-".to_owned(),
                Some(v) if key == SNR => format!("{v:.3}"),
                Some(v) => format!("{v:.6e}"),
            };
            format!("{name:14}{value}")
        });
        lines.collect::<Vec<_>>().join("\n")
    }
}
