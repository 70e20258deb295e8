//! `psfield compare`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use metrics::{Comparison, MetricsError, Summary};
use ndarray::{Array3, Axis};
use psf_io::{FileKind, HduChoice};
use serde::Serialize;

use super::context::Context;

/// Compare an image (or a cube) with a reference
///
/// MAE, MSE, relative L2 = |F - T| / |T|, largest difference, and that over the peak of the reference. Of cubes, each measure's
/// median over the planes and its value in the worst plane.
#[derive(Debug, clap::Args)]
pub(crate) struct CompareArgs {
    /// The result F
    #[arg(value_name = "RESULT.fits")]
    result: PathBuf,
    /// The reference T
    #[arg(value_name = "REFERENCE.fits")]
    reference: PathBuf,
    /// Which image of the result's file: a number counted from 0 (the primary HDU), or NAME or NAME,VERSION
    #[arg(long, value_name = "N|NAME")]
    extension: Option<HduChoice>,
    /// Which image of the reference's file
    #[arg(long, value_name = "N|NAME")]
    reference_extension: Option<HduChoice>,
}

/// The measures of one image. Those that do not exist (a reference of zeros) are null.
#[derive(Debug, Serialize)]
struct Measures {
    mae: f64,
    mse: f64,
    relative_l2: Option<f64>,
    max_abs: f64,
    max_over_peak: Option<f64>,
    mae_over_mean: Option<f64>,
    snr_db: Option<f64>,
}

#[derive(Debug, Serialize)]
struct CubeReport {
    planes: usize,
    median: Measures,
    max: Measures,
}

impl CompareArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let (result, result_is_cube) = read(&self.result, self.extension.as_ref())?;
        let (reference, reference_is_cube) = read(&self.reference, self.reference_extension.as_ref())?;
        let planes = Comparison::by_plane(result.view(), reference.view()).with_context(|| {
            format!(
                "comparing {} with {}",
                self.result.display(),
                self.reference.display()
            )
        })?;
        if result_is_cube || reference_is_cube {
            let report = CubeReport {
                planes: planes.len(),
                median: Measures::median(&planes)?,
                max: Measures::worst(&planes)?,
            };
            context.report(&report, || {
                let median = report.median.text();
                let max = report.max.text();
                format!(
                    "{} planes\nmedian over the planes\n{median}\nworst plane in each\n{max}",
                    report.planes
                )
            })
        } else {
            let report = Measures::of(&planes[0]);
            context.report(&report, || report.text())
        }
    }
}

/// An image as a cube of one plane, or a cube; and which of the two it is.
fn read(path: &Path, extension: Option<&HduChoice>) -> anyhow::Result<(Array3<f64>, bool)> {
    Ok(match psf_io::detect(path)? {
        FileKind::PsfModel => anyhow::bail!(
            "{} is a PSF model: compare its PSFs at chosen positions (psfield evaluate)",
            path.display()
        ),
        FileKind::PsfSamples | FileKind::Cube => (psf_io::read_cube_hdu::<f64>(path, extension)?, true),
        _ => (
            psf_io::read_image_hdu::<f64>(path, extension)?
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
        Self {
            mae: comparison.mae(),
            mse: comparison.mse(),
            relative_l2: comparison.relative_l2().ok(),
            max_abs: comparison.max_abs(),
            max_over_peak: comparison.max_over_peak().ok(),
            mae_over_mean: comparison.mae_over_mean().ok(),
            snr_db: comparison.snr_db().ok(),
        }
    }

    /// The medians over the planes.
    fn median(planes: &[Comparison]) -> Result<Self, MetricsError> {
        Self::over(planes, Summary::median, Summary::median)
    }

    /// Of each measure the value of the plane that is worst in it.
    fn worst(planes: &[Comparison]) -> Result<Self, MetricsError> {
        Self::over(planes, Summary::max, Summary::min)
    }

    /// One statistic of the errors, and one of the signal-to-noise ratio; none where a plane has no such measure.
    fn over(
        planes: &[Comparison],
        of_errors: impl Fn(&Summary) -> f64,
        of_snr: impl Fn(&Summary) -> f64,
    ) -> Result<Self, MetricsError> {
        let planes: Vec<Self> = planes.iter().map(Self::of).collect();
        let every =
            |measure: &dyn Fn(&Self) -> f64| Summary::of(planes.iter().map(measure)).map(|s| of_errors(&s));
        let values = |measure: &dyn Fn(&Self) -> Option<f64>| {
            planes
                .iter()
                .map(measure)
                .collect::<Option<Vec<f64>>>()
                .and_then(|v| Summary::of(v).ok())
        };
        let all = |measure: &dyn Fn(&Self) -> Option<f64>| values(measure).map(|s| of_errors(&s));
        Ok(Self {
            mae: every(&|m| m.mae)?,
            mse: every(&|m| m.mse)?,
            relative_l2: all(&|m| m.relative_l2),
            max_abs: every(&|m| m.max_abs)?,
            max_over_peak: all(&|m| m.max_over_peak),
            mae_over_mean: all(&|m| m.mae_over_mean),
            snr_db: values(&|m| m.snr_db).map(|s| of_snr(&s)),
        })
    }

    fn text(&self) -> String {
        let or_dash = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.6e}"));
        format!(
            "MAE           {:.6e}\nMSE           {:.6e}\nrelative L2   {}\nlargest       {:.6e}\n\
             largest/peak  {}\nMAE/mean      {}\nSNR (dB)      {}",
            self.mae,
            self.mse,
            or_dash(self.relative_l2),
            self.max_abs,
            or_dash(self.max_over_peak),
            or_dash(self.mae_over_mean),
            self.snr_db.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}")),
        )
    }
}
