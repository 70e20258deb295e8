//! `psfield measure`.

use std::path::{Path, PathBuf};

use ndarray::Axis;
use psf_io::{FileKind, HduChoice};
use psfield::measure::{MEASUREMENT_COLUMNS, MeasureOptions, Measurement};

use super::UsageError;
use super::context::{Context, object};
use super::files::OutputFile;
use super::table_args::TableArgs;

/// Measure size, shape and flux of PSFs
///
/// Writes CSV. Columns from the fit of an elliptical Gaussian with semi-axes a >= b: flux,
/// x_centroid, y_centroid, fwhm_px, fwhm_major_px, fwhm_minor_px, angle_rad,
/// eccentricity = sqrt(1 - b^2/a^2). Columns from adaptive moments: e1, e2 (distortion), g1, g2
/// (reduced shear), sigma_px, ellipticity = sqrt(e1^2 + e2^2). The columns x and y hold the given
/// position. If a measurement fails, its columns are empty and the column note says why.
///
/// Widths and fluxes of PSF samples are in frame pixels, for any oversampling. The oversampling of
/// a cube or an image is unknown, so its widths are in its own pixels. Centroids are 0-based pixels
/// of the image with --at, and of the stamp otherwise.
#[derive(Debug, clap::Args)]
pub(crate) struct MeasureArgs {
    /// PSF samples, cube of stamps, image with --at, or image that is a single stamp
    #[arg(value_name = "IMAGE.fits|STAMPS.fits")]
    input: PathBuf,
    /// HDU of the image: its number (0: primary), NAME or NAME,VERSION [default: the primary image,
    /// else the only one]
    #[arg(long, value_name = "N|NAME")]
    extension: Option<HduChoice>,
    /// Positions in an image: CSV or FITS table with columns x, y (0-based pixels)
    #[arg(long, value_name = "POSITIONS.csv")]
    at: Option<PathBuf>,
    #[command(flatten)]
    table: TableArgs,
    /// Fit the Gaussian to the N x N stamp pixels around the centre [default: the whole stamp; with
    /// --at: 15]
    ///
    /// With --at, the adaptive moments also use only these pixels. Otherwise they use the whole
    /// stamp.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    window: Option<u16>,
    /// Fit a constant background too
    #[arg(long)]
    background: bool,
    /// Table to write
    #[arg(short, long, value_name = "TABLE.csv")]
    output: OutputFile,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
}

impl MeasureArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let spinner = context.spinner("measuring");
        let rows = self.measure(&self.input, context)?;
        psf_io::write_csv(&self.output, MEASUREMENT_COLUMNS, &rows, self.overwrite)?;
        drop(spinner);
        let failed = rows.iter().filter(|row| row.has_failed()).count();
        let with_notes = rows.iter().filter(|row| !row.note.is_empty()).count();
        let report = object! {
            output: self.output,
            measured: rows.len(),
            // Rows with a note. In each, at least one measurement failed.
            with_notes,
        };
        context.report(&report, || {
            let failed = if with_notes > 0 {
                format!(", {with_notes} of them with a failed measurement (see the column note)")
            } else {
                String::new()
            };
            format!("{}: {} rows{failed}", report.output.display(), report.measured)
        })?;
        anyhow::ensure!(
            failed < rows.len(),
            "{} was written, but all measurements failed: the column note says why",
            report.output.display()
        );
        Ok(())
    }

    fn measure(&self, path: &Path, context: &Context) -> anyhow::Result<Vec<Measurement>> {
        let options = MeasureOptions {
            window: self.window.map(usize::from),
            background: self.background,
        };
        TableArgs::check(self.at.as_deref(), &context.given)?;
        let kind = psf_io::detect_hdu(path, self.extension.as_ref())?;
        if self.at.is_some() && kind != FileKind::Image {
            let path = path.display();
            return Err(UsageError(format!("--at needs an image, but {path} is {kind}: omit --at")).into());
        }
        Ok(match kind {
            FileKind::PsfModel => anyhow::bail!(
                "{} is a PSF model: write its PSFs at chosen positions (psfield evaluate), then measure that file",
                path.display()
            ),
            FileKind::PsfSamples if self.extension.is_some() => {
                let text = "PSF samples have only one cube of stamps: omit --extension";
                return Err(UsageError(text.to_owned()).into());
            }
            FileKind::PsfSamples => options.samples(&psf_io::read_samples(path)?),
            FileKind::Cube => options.cube(
                psf_io::read_cube_hdu::<f64>(path, self.extension.as_ref())?.view(),
                None,
            ),
            _ => {
                let image = psf_io::read_image_hdu::<f64>(path, self.extension.as_ref())?
                    .into_parts()
                    .0;
                match &self.at {
                    Some(at) => {
                        let positions = psf_io::read_positions_with(at, &self.table.options())?;
                        anyhow::ensure!(
                            !positions.is_empty(),
                            "{}: the table has no positions",
                            at.display()
                        );
                        options.image(image.pixels(), &positions)
                    }
                    None => options.cube(image.pixels().insert_axis(Axis(0)), None),
                }
            }
        })
    }
}
