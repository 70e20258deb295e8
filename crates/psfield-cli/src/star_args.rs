//! Options for turning the stars of a frame into samples.

use std::path::{Path, PathBuf};

use ndarray::{Array2, Zip};
use psf_io::{HduChoice, HeaderCards, ImageReader};
use psf_stars::{
    BackgroundMesh, Camera, Detection, Registration, RegistrationMethod, Selection, StarError, StarSampling,
};

use super::UsageError;
use super::context::with_nan_setting;
use super::values::{above_zero, at_least_zero};

/// Settings for finding and selecting stars.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Stars of a frame")]
pub(crate) struct StarArgs {
    /// HDU of the image: its number (0: primary), NAME or NAME,VERSION [default: the primary image,
    /// else the only one]
    #[arg(long, value_name = "N|NAME")]
    pub(crate) extension: Option<HduChoice>,
    /// Detection threshold (sigma) [default: {detection_threshold}]
    #[arg(long, value_name = "X", value_parser = above_zero)]
    pub(crate) detection_threshold: Option<f64>,
    /// Smallest signal-to-noise ratio of a star [default: 10 to 50]
    ///
    /// The default is the ratio that 200 stars exceed, but at least 10 and at most 50. If more than 2000
    /// stars exceed 50, it is the ratio that 2000 stars exceed.
    #[arg(long, value_name = "X", value_parser = at_least_zero)]
    snr: Option<f64>,
    /// Value at and above which pixels are saturated [default: the SATURATE card]
    ///
    /// A SATURATE card that is not above the background is ignored. If neither the option nor the
    /// card gives a level, the frame's largest value counts as saturated, provided that at least
    /// two pixels have it.
    #[arg(long, value_name = "LEVEL")]
    pub(crate) saturation: Option<f64>,
    /// Gain (electrons per unit of the frame)
    ///
    /// With it, the signal-to-noise ratio includes the photon noise of the star.
    #[arg(long, value_name = "E/ADU", value_parser = above_zero)]
    pub(crate) gain: Option<f64>,
    /// Read noise (electrons), needs --gain
    ///
    /// If the background noise measured in the frame is lower, the read noise replaces it.
    #[arg(long, value_name = "E", requires = "gain", value_parser = at_least_zero, hide_short_help = true)]
    read_noise: Option<f64>,
    /// Smallest distance to other sources (pixels) [default: 2.5 FWHM]
    ///
    /// Only sources with more than a fifth of the star's flux count.
    #[arg(long, value_name = "PIXELS", value_parser = at_least_zero, hide_short_help = true)]
    isolation: Option<f64>,
    /// Smallest distance from the frame's edge (pixels) [default: half a stamp]
    ///
    /// A smaller value than half a stamp is an error.
    #[arg(long, value_name = "PIXELS", value_parser = at_least_zero, hide_short_help = true)]
    edge: Option<f64>,
    /// Side of a sample's stamp (frame pixels) [default: 3 FWHM to each side of the star, at least
    /// 11 in total]
    ///
    /// From 5 to 512. An even number is raised to the next odd number.
    #[arg(long, value_name = "N")]
    stamp_size: Option<usize>,
    /// Stamp pixels per frame pixel, 1 to 8
    ///
    /// Default of epsf: enough for 4 stamp pixels per FWHM, or 3 if stars are few. Default of stamps: 1
    /// for at least 64 stars and a FWHM of at least 2 pixels, else enough for 3 stamp pixels per FWHM.
    /// At most 8.
    #[arg(long, value_name = "N", hide_short_help = true)]
    oversampling: Option<usize>,
    /// Method that makes stamps from stars: epsf, stamps or auto [default: auto]
    ///
    /// epsf: an oversampled PSF that varies over the field as a polynomial, fitted to all stars.
    /// stamps: each star's own pixels, shifted to a common centre, with their noise.
    /// auto: if the FWHM is below 2 pixels, epsf for at least 12 stars (more for a high --oversampling),
    /// else stamps. If it is at least 2 pixels, epsf for at least 64 stars, unless the pixels of the
    /// nearest stars predict stars better that are left out.
    #[arg(long, value_name = "METHOD", verbatim_doc_comment)]
    registration: Option<RegistrationMethod>,
    /// Side of a cell of the background mesh (pixels) [default: 64]
    #[arg(long, value_name = "N", hide_short_help = true)]
    background_mesh: Option<usize>,
}

/// Bad pixels of a frame.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Bad pixels of a frame")]
pub(crate) struct MaskArgs {
    /// Mask of the frame: an image of its shape, in which pixels other than 0 are bad
    ///
    /// The estimates of the background and its noise ignore bad pixels. Stars with bad pixels near
    /// their core are rejected (reason: masked).
    #[arg(long, value_name = "MASK.fits")]
    mask: Option<PathBuf>,
    /// Treat NaN and infinite pixels of the frame as bad pixels [default: they are an error]
    #[arg(long)]
    nan_is_masked: bool,
}

impl MaskArgs {
    /// Reads the pixels of a frame. Bad pixels become NaN.
    fn read(&self, reader: &mut ImageReader, path: &Path) -> anyhow::Result<Array2<f64>> {
        let (shape, rows) = (reader.shape(), 0..reader.shape().ny());
        let mut frame = reader.read_rows_with_undefined(rows.clone())?;
        if self.nan_is_masked {
            frame.mapv_inplace(|v| if v.is_finite() { v } else { f64::NAN });
        }
        let mut undefined = frame.mapv(|v| !v.is_finite() && !self.nan_is_masked);
        if let Some(mask) = &self.mask {
            let mut mask_reader = ImageReader::open(mask)?;
            if mask_reader.shape() != shape {
                let (mask, path, masked) = (mask.display(), path.display(), mask_reader.shape());
                anyhow::bail!(
                    "{mask}: the mask has {masked} pixels, but {path} has {shape}: give a mask of the frame's shape (option --mask)"
                );
            }
            let bad = mask_reader.read_rows_with_undefined(rows)?.mapv(|v| v != 0.0);
            Zip::from(&mut frame)
                .and(&mut undefined)
                .and(&bad)
                .for_each(|value, undefined, &bad| {
                    if bad {
                        (*value, *undefined) = (f64::NAN, false);
                    }
                });
        }
        if undefined.iter().any(|&undefined| undefined) {
            let error = reader.undefined_error(|pixel| undefined[pixel]);
            return Err(with_nan_setting(error, "nan_is_masked").into());
        }
        Ok(frame)
    }
}

impl StarArgs {
    /// Reads a frame and its header, and builds the settings. Bad pixels of the frame become NaN.
    /// The settings include the saturation level, which the header may hold.
    pub(crate) fn open(
        &self,
        path: &Path,
        mask: &MaskArgs,
    ) -> anyhow::Result<(Array2<f64>, HeaderCards, StarSampling)> {
        let mut reader = ImageReader::open_hdu(path, self.extension.as_ref())?;
        let header = reader.header().clone();
        let sampling = self.sampling(header.number("SATURATE"));
        let sampling = sampling.map_err(|e| UsageError(e.to_string()))?;
        Ok((mask.read(&mut reader, path)?, header, sampling))
    }

    fn sampling(&self, in_header: Option<f64>) -> Result<StarSampling, StarError> {
        let detection = self
            .detection_threshold
            .map_or_else(|| Ok(Detection::default()), Detection::new)?;
        let background = self
            .background_mesh
            .map_or_else(|| Ok(BackgroundMesh::default()), BackgroundMesh::new)?;
        let camera = Camera::new();
        let camera = apply(camera, self.gain, Camera::with_gain)?;
        let camera = apply(camera, self.read_noise, Camera::with_read_noise)?;
        let camera = apply(camera, self.saturation, Camera::with_saturation)?;
        let camera = apply(camera, in_header, Camera::with_header_saturation)?;
        let selection = Selection::default();
        let selection = apply(selection, self.snr, Selection::with_snr)?;
        let selection = apply(selection, self.isolation, Selection::with_isolation_px)?;
        let selection = apply(selection, self.edge, Selection::with_edge_px)?;
        let registration = Registration::default().with_method(self.registration.unwrap_or_default());
        let registration = apply(registration, self.stamp_size, Registration::with_stamp_size)?;
        let registration = apply(registration, self.oversampling, Registration::with_oversampling)?;
        Ok(StarSampling::default()
            .with_detection(detection)
            .with_background(background)
            .with_camera(camera)
            .with_selection(selection)
            .with_registration(registration))
    }
}

/// Applies a setting if its option was given.
fn apply<S, V>(
    settings: S,
    value: Option<V>,
    with: impl FnOnce(S, V) -> Result<S, StarError>,
) -> Result<S, StarError> {
    match value {
        Some(value) => with(settings, value),
        None => Ok(settings),
    }
}
