//! The options that say what a PSF file does not say of itself.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use psf_io::{HduChoice, PlaneOrder};
use psf_types::Position;
use psfield::PsfFileOptions;

use super::values::above_zero;

/// What a PSF file does not say of itself, or leaves to be chosen.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "PSF file options")]
pub(crate) struct PsfFileArgs {
    /// PSFEx: which of several models; STPSF, STDPSF and plain stamps: which of several images; by the number of the HDU (0 for the
    /// primary, 1 for the first extension) or its EXTNAME
    #[arg(long, value_name = "N|NAME")]
    psf_extension: Option<HduChoice>,
    /// STDPSF: which of several detectors
    #[arg(long, value_name = "N", value_parser = detector)]
    psf_detector: Option<usize>,
    /// STPSF: planes lie where their cards say (cards), or are sorted by y, then x, as since 2023-12-11 (sorted); auto: by the
    /// file's version or date [default: auto]
    #[arg(long, value_name = "auto|cards|sorted")]
    psf_order: Option<PlaneOrder>,
    /// ScopeSim: the PSFs for the wavelength nearest to this one, in micrometres
    #[arg(long, value_name = "UM", value_parser = above_zero, allow_negative_numbers = true)]
    psf_wavelength: Option<f64>,
    /// ScopeSim: the size of a frame pixel
    #[arg(long, value_name = "ARCSEC", value_parser = above_zero, allow_negative_numbers = true)]
    pixel_scale: Option<f64>,
    /// ScopeSim: where the centre of the PSF's field lies on the frame, 0-based
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    field_centre: Option<Point>,
    /// Cube without positions: where its planes belong, CSV or FITS table with columns x, y (0-based pixels), one row a plane
    #[arg(long, value_name = "POSITIONS.csv")]
    psf_positions: Option<PathBuf>,
    /// Cube or single stamp without positions: stamp pixels per frame pixel
    #[arg(long, value_name = "S", value_parser = above_zero, allow_negative_numbers = true)]
    psf_oversampling: Option<f64>,
    /// Cube or single stamp without positions: the pixel of a stamp where the PSF's centre lies, 0-based [default: as the file says
    /// (CENX, CENY), or NX / 2, NY / 2 rounded down]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    psf_centre: Option<Point>,
    /// Whether the response of a frame pixel is in the stamps [default: as the file says, or its format]
    #[arg(long, value_name = "included|missing", value_enum)]
    pixel_response: Option<PixelResponse>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum PixelResponse {
    Included,
    Missing,
}

/// `X,Y`, finite.
#[derive(Debug, Clone, Copy)]
struct Point(Position);

impl FromStr for Point {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y]) => Position::new(x, y).map(Self).map_err(|e| e.to_string()),
            _ => Err("two numbers are needed, as in 2047.5,2047.5".to_owned()),
        }
    }
}

fn detector(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(number) if number > 0 => Ok(number),
        _ => Err("a whole number above 0 is needed".to_owned()),
    }
}

impl PsfFileArgs {
    /// The file of the positions.
    pub(crate) fn positions_file(&self) -> Option<&Path> {
        self.psf_positions.as_deref()
    }

    /// Which of several models of a PSFEx file.
    pub(crate) fn extension(&self) -> Option<&HduChoice> {
        self.psf_extension.as_ref()
    }

    /// Reads the positions where there are any.
    pub(crate) fn options(&self) -> anyhow::Result<PsfFileOptions> {
        Ok(PsfFileOptions {
            extension: self.psf_extension.clone(),
            detector: self.psf_detector,
            plane_order: self.psf_order,
            wavelength_um: self.psf_wavelength,
            pixel_scale_arcsec: self.pixel_scale,
            field_centre: self.field_centre.map(|point| point.0),
            positions: self
                .psf_positions
                .as_ref()
                .map(psf_io::read_positions)
                .transpose()?,
            oversampling: self.psf_oversampling,
            centre: self.psf_centre.map(|point| point.0),
            pixel_response_included: self
                .pixel_response
                .map(|response| matches!(response, PixelResponse::Included)),
        })
    }
}
