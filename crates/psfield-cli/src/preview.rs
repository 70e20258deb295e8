//! `psfield preview`.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use psf_io::{HduChoice, ImageReader, IoErrorKind};
use psfield_lab::preview::{
    BinnedImage, Colormap, LimitRule, Limits, Percentiles, Picture, PreviewError, Stretch,
};

use super::UsageError;
use super::context::{Context, object};
use super::files::OutputFile;

/// Show a FITS image as a PNG picture
///
/// Shows any image that psfield reads, or one plane of a cube, plain or compressed (.gz, .fz). y
/// points upwards as in ds9: row 0 is at the bottom.
///
/// Images larger than --max-size are binned: a bin is the mean of those of its pixels that have a
/// value. The black and white levels are computed from the binned image. Pixels without a value
/// (NaN, infinite, BLANK) are magenta with the colour maps grey, viridis and cividis, and cyan with
/// the others.
#[derive(Debug, clap::Args)]
pub(crate) struct PreviewArgs {
    /// Image to show
    #[arg(value_name = "IMAGE.fits")]
    image: PathBuf,
    /// Picture to write [default: IMAGE.png next to the image]
    #[arg(short, long, value_name = "IMAGE.png")]
    output: Option<OutputFile>,
    /// Replace the picture if it exists
    #[arg(long)]
    overwrite: bool,
    /// HDU of the image: its number (0: primary), NAME or NAME,VERSION [default: the primary image,
    /// else the only one]
    #[arg(long, value_name = "N|NAME")]
    extension: Option<HduChoice>,
    /// Plane of a cube, counted from 0
    #[arg(long, value_name = "N")]
    plane: Option<usize>,
    /// Stretch (brightness scale) between the black and white levels, as in astropy
    #[arg(long, default_value = "asinh", value_parser = PossibleValuesParser::new(["linear", "sqrt", "log", "asinh"])
        .try_map(|name| name.parse::<Stretch>()))]
    stretch: Stretch,
    /// Black and white levels at these percentiles of the pixels
    #[arg(long, value_name = "LO,HI", default_value = "0.5,99.8", allow_hyphen_values = true, conflicts_with_all = ["range", "zscale"])]
    percentile: Percentiles,
    /// Black and white levels at these values, instead of --percentile
    #[arg(
        long,
        value_name = "LO,HI",
        allow_hyphen_values = true,
        conflicts_with = "zscale"
    )]
    range: Option<Limits>,
    /// Black and white levels around the sky level (zscale of IRAF, ds9 and astropy), instead of
    /// --percentile
    #[arg(long)]
    zscale: bool,
    /// Colour map (all suit colour-blind readers)
    #[arg(long, default_value = "grey", value_parser = PossibleValuesParser::new(COLORMAPS)
        .try_map(|name| name.parse::<Colormap>()))]
    colormap: Colormap,
    /// Largest number of pixels of the picture along an axis
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=32768))]
    max_size: u32,
}

/// The names of the colour maps.
const COLORMAPS: [&str; 6] = ["grey", "viridis", "cividis", "inferno", "magma", "plasma"];

impl PreviewArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let named = self.output.as_deref().cloned();
        let output = named.or(self.default_picture()).expect("one of the two names");
        let ending = output.extension();
        if ending.is_some_and(|ending| !ending.eq_ignore_ascii_case("png")) {
            let text = format!(
                "{}: preview writes PNG files only: give a name that ends in .png",
                output.display()
            );
            return Err(UsageError(text).into());
        }
        let mut reader = match self.plane {
            Some(plane) => ImageReader::open_plane(&self.image, self.extension.as_ref(), plane),
            None => ImageReader::open_hdu(&self.image, self.extension.as_ref()),
        }
        .map_err(|error| {
            let is_cube = || ImageReader::open_plane(&self.image, self.extension.as_ref(), 0).is_ok();
            if error.kind() == IoErrorKind::Axes && self.plane.is_none() && is_cube() {
                anyhow::anyhow!("{error}. This is a cube: choose a plane with --plane N, counted from 0")
            } else {
                error.into()
            }
        })?;
        let image = {
            let _spinner = context.spinner("reading");
            BinnedImage::read(&mut reader, self.max_size as usize)?
        };
        let named = || format!("{} cannot be shown", self.image.display());
        let limits = self
            .rule()
            .limits(image.pixels())
            .map_err(with_option)
            .with_context(named)?;
        let picture =
            Picture::new(image.pixels(), limits, self.stretch, self.colormap).with_context(named)?;
        psf_io::write_bytes(&output, &picture.png(), self.overwrite)?;
        let report = object! {
            output,
            image_size: [reader.shape().nx(), reader.shape().ny()],
            picture_size: [picture.width(), picture.height()],
            // Pixels of the image along each side of a pixel of the picture.
            binning: image.factor,
            stretch: self.stretch.to_string(),
            colormap: self.colormap.to_string(),
            limits,
            // Pixels of the image that are NaN or infinite.
            undefined_pixels: image.undefined_pixels,
        };
        context.report(&report, || {
            let [nx, ny] = report.picture_size;
            let mut text = format!("{}: {nx} x {ny} pixels", report.output.display());
            if report.binning > 1 {
                let (n, [nx, ny]) = (report.binning, report.image_size);
                let binned = format!(", each the mean of {n} x {n} pixels of the {nx} x {ny} image");
                text.push_str(&binned);
            }
            let _ = write!(text, ", {} from {limits}", report.stretch);
            if report.undefined_pixels > 0 {
                let _ = write!(text, ", {} pixels without a value", report.undefined_pixels);
            }
            text
        })
    }

    /// The default name of the picture: `a/b.fits.gz` gives `a/b.png`. `None` if a name is given.
    pub(crate) fn default_picture(&self) -> Option<PathBuf> {
        let unpacked = match self.image.extension() {
            Some(extension) if extension == "gz" || extension == "fz" => self.image.with_extension(""),
            _ => self.image.clone(),
        };
        self.output.is_none().then(|| unpacked.with_extension("png"))
    }

    fn rule(&self) -> LimitRule {
        match self.range {
            Some(limits) => LimitRule::Range(limits),
            None if self.zscale => LimitRule::ZScale,
            None => LimitRule::Percentile(self.percentile),
        }
    }
}

/// Turns an error into a message. If the black and white levels caused the error, appends the
/// options that avoid it.
fn with_option(error: PreviewError) -> anyhow::Error {
    match error {
        PreviewError::Constant { .. } => anyhow::anyhow!("{error} (--range)"),
        PreviewError::EqualLimits { .. } => anyhow::anyhow!("{error} (--percentile 0,100 or --range)"),
        other => other.into(),
    }
}
