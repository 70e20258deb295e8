//! The PSF of a telescope at any field position.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use ndarray::ArrayViewMut2;
use psf_types::maths::smooth_size;
use psf_types::{FrameShape, Position, PsfSource, SourceError, StampGrid};
use rustfft::num_complex::Complex64;

use crate::error::require;
use crate::focal_plane::{AxisTransfer, FocalPlane};
use crate::pupil::{Aperture, PupilCells};
use crate::seeing::Seeing;
use crate::wavefront::Wavefront;
use crate::{FieldCoordinates, OpticsError, TelescopeParams, WavefrontUnit};

/// The TOML text of [`Telescope::survey_2m`].
pub const SURVEY_2M_TOML: &str = include_str!("../presets/survey_2m.toml");

/// The TOML text of [`Telescope::wide_field_lens`].
pub const WIDE_FIELD_LENS_TOML: &str = include_str!("../presets/wide_field_lens.toml");

/// A telescope that draws its PSF at any position on its frame. The PSF is computed from the pupil,
/// the wavefront over the field, the seeing, the pixel and the detector's blur.
///
/// See the [crate's page](crate) for the equations, the sampling and the accuracy. Drawing is
/// deterministic and takes `&self`: any number of threads may draw at the same time, each with its
/// own work arrays from a pool.
///
/// ```
/// use psf_optics::Telescope;
/// use psf_types::{Position, PsfSource};
/// let telescope = Telescope::from_toml_str(r#"
///     wavelength_nm = 600.0
///     pixel_scale_arcsec = 0.1
///     frame = { nx = 1000, ny = 800 }
///     stamp = { nx = 32, ny = 32 }
///     aperture = { diameter_m = 1.0, obscuration = 0.3 }
///     [wavefront]
///     unit = "nm"
///     modes = [{ noll = 4, terms = [{ x = 2, value = 40.0 }, { y = 2, value = 40.0 }] }]
/// "#)?;
/// let stamp = telescope.draw(Position::new(0.0, 799.0)?)?;
/// assert!(stamp.flux() > 0.9 && stamp.flux() < 1.0); // the rest falls outside the stamp
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Telescope {
    params: TelescopeParams,
    field: FrameShape,
    grid: StampGrid,
    wavefront: Wavefront,
    focal_plane: FocalPlane,
    /// Transfer function of the pixel and the Gaussian blur along an axis. Value `k` is for a lag
    /// of `k` pupil cells, which is a spatial frequency (see the crate's page). The function is
    /// equal everywhere in the field.
    detector: Vec<f64>,
}

impl Telescope {
    /// The names of the built-in telescopes.
    pub const PRESETS: [&str; 2] = ["survey-2m", "wide-field-lens"];

    /// The smallest width of the computed focal plane in units of lambda / D. This width is also
    /// the number of pupil cells across the aperture, so the pupil is well resolved.
    const MIN_PUPIL_CELLS: f64 = 64.0;
    /// The longest transform. It needs about 1.2 GB of work arrays per thread.
    const MAX_TRANSFORM: usize = 6144;
    /// Lags where the transfer function of seeing and blur is below this value are dropped.
    const NEGLIGIBLE_TRANSFER: f64 = 1e-15;

    /// Makes a telescope from its parameters. Checks all parameters and computes the pupil, the FFT
    /// plans and the transfer functions.
    ///
    /// # Errors
    /// [`OpticsError::Setting`], which names the key and the allowed values,
    /// [`OpticsError::Unusable`] for values that cannot be used together, or [`OpticsError::Data`]
    /// for a frame or a stamp grid that is not possible.
    pub fn new(params: TelescopeParams) -> Result<Self, OpticsError> {
        let (nm, arcsec) = (params.wavelength_nm, params.pixel_scale_arcsec);
        let wavelength_m = 1e-9 * require("wavelength_nm", "a number of nm above 0", nm, nm > 0.0)?;
        let allowed = "a number of arcsec above 0";
        let pixel_rad = crate::arcsec_to_rad(require("pixel_scale_arcsec", allowed, arcsec, arcsec > 0.0)?);
        let field = FrameShape::new(params.frame.nx, params.frame.ny)?;
        let grid = Self::check_stamp(&params)?;
        let aperture = Aperture::new(&params.aperture)?;
        let wavefront = Wavefront::new(&params.wavefront, params.wavelength_nm)?;
        let seeing = params.seeing.map(|s| Seeing::new(&s, wavelength_m)).transpose()?;
        let sigma = params.detector.blur_sigma_px;
        let allowed = "a number of pixels, 0 or above";
        require("detector.blur_sigma_px", allowed, sigma, sigma >= 0.0)?;

        let oversampling = grid.oversampling();
        let step_rad = pixel_rad / oversampling;
        // Pupil cells across the aperture divided by stamp pixels in the period.
        let cells_per_pixel = params.aperture.diameter_m * step_rad / wavelength_m;
        let wanted = params.stamp.padding * grid.nx().max(grid.ny()) as f64;
        let period = wanted.max(Self::MIN_PUPIL_CELLS / cells_per_pixel).ceil();
        let diameter = period * cells_per_pixel;
        let too_large = |got: f64| {
            let (got, limit) = (shown(got), Self::MAX_TRANSFORM);
            let (nm, arcsec, m) = (shown(nm), shown(arcsec), shown(params.aperture.diameter_m));
            OpticsError::Unusable(format!(
                "the PSF would need transforms of {got} x {got} points, but at most {limit} x {limit} are \
                 supported: make the stamp or its padding smaller, or choose a pixel scale closer to lambda / D \
                 (wavelength_nm = {nm}, pixel_scale_arcsec = {arcsec}, aperture.diameter_m = {m})"
            ))
        };
        if period.max(diameter) > Self::MAX_TRANSFORM as f64 {
            return Err(too_large(period.max(diameter)));
        }
        let period = smooth_size(period as usize, 2, 7);
        let diameter = period as f64 * cells_per_pixel;

        let cell_m = params.aperture.diameter_m / diameter;
        let cycles_per_pixel = oversampling / period as f64;
        let blur = |lag: usize| (-2.0 * (PI * sigma * lag as f64 * cycles_per_pixel).powi(2)).exp();
        let air = |baseline: f64| seeing.map_or(1.0, |s| s.transfer(baseline));
        let all = diameter.ceil() as usize + 2;
        let lags = (0..all)
            .find(|&k| blur(k) * air(k as f64 * cell_m) < Self::NEGLIGIBLE_TRANSFER)
            .unwrap_or(all);
        let length = FocalPlane::transform_length(diameter.ceil() as usize + 2, lags);
        if length > Self::MAX_TRANSFORM {
            return Err(too_large(length as f64));
        }
        let table = seeing.map(|s| {
            (0..=lags)
                .flat_map(|ky| (0..=lags).map(move |kx| s.transfer((kx as f64).hypot(ky as f64) * cell_m)))
                .collect()
        });
        let pixel = |lag: usize| {
            if params.detector.pixel_integration {
                psf_types::maths::sinc(lag as f64 * cycles_per_pixel)
            } else {
                1.0
            }
        };
        let detector = (0..=lags).map(|k| pixel(k) * blur(k)).collect();
        Ok(Self {
            field,
            grid,
            wavefront,
            focal_plane: FocalPlane::new(PupilCells::new(&aperture, diameter), lags, period, table),
            detector,
            params,
        })
    }

    /// This telescope at another wavelength, in micrometres. Diffraction and seeing change with it.
    /// The wavefront keeps its lengths: if the parameters give it in waves, they are waves of this
    /// telescope's wavelength.
    ///
    /// ```
    /// use psf_optics::Telescope;
    /// let telescope = Telescope::wide_field_lens();
    /// let blue = telescope.at_wavelength_um(0.45)?;
    /// assert_eq!(blue.params().wavelength_nm, 450.0);
    /// # Ok::<(), psf_optics::OpticsError>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn at_wavelength_um(&self, um: f64) -> Result<Self, OpticsError> {
        let mut params = self.params.clone();
        if params.wavefront.unit == WavefrontUnit::Waves {
            params.wavefront.unit = WavefrontUnit::Nm;
            for term in params.wavefront.modes.iter_mut().flat_map(|mode| &mut mode.terms) {
                term.value *= params.wavelength_nm;
            }
        }
        params.wavelength_nm = 1e3 * um;
        Self::new(params)
    }

    /// Makes a telescope from TOML text with the keys of [`TelescopeParams`].
    ///
    /// # Errors
    /// [`OpticsError::Toml`], with line, column and key, for text that is not TOML with these keys.
    /// Otherwise the errors of [`new`](Self::new).
    pub fn from_toml_str(text: &str) -> Result<Self, OpticsError> {
        Self::new(toml::from_str(text).map_err(|e| OpticsError::Toml(Box::new(e)))?)
    }

    /// Makes a telescope from a TOML file.
    ///
    /// # Errors
    /// [`OpticsError::Read`] or [`OpticsError::InFile`], which name the file.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self, OpticsError> {
        let path = path.as_ref();
        let text = psf_types::read_text_file(path).map_err(|source| OpticsError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_toml_str(&text).map_err(|source| OpticsError::InFile {
            path: path.to_owned(),
            source: Box::new(source),
        })
    }

    /// A 2 m off-axis survey telescope in space, without obscuration, at 0.074 arcsec per pixel on
    /// 9232 x 9216 pixels. The CSST survey camera has this frame size and pixel scale. The
    /// aberrations are invented.
    ///
    /// [`SURVEY_2M_TOML`] is its description.
    pub fn survey_2m() -> Self {
        Self::from_toml_str(SURVEY_2M_TOML).expect("the preset is valid")
    }

    /// An undersampled wide-field lens on the ground: 180 mm aperture, 11.7 arcsec per pixel on
    /// 4096 x 4096 pixels. It resembles the GWAC cameras, but the aberrations are invented.
    ///
    /// [`WIDE_FIELD_LENS_TOML`] is its description.
    pub fn wide_field_lens() -> Self {
        Self::from_toml_str(WIDE_FIELD_LENS_TOML).expect("the preset is valid")
    }

    /// The built-in telescope with a name of [`PRESETS`](Self::PRESETS). `None` for another name.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "survey-2m" => Some(Self::survey_2m()),
            "wide-field-lens" => Some(Self::wide_field_lens()),
            _ => None,
        }
    }

    /// The parameters that the telescope was made from. To make another telescope, change a copy
    /// and call [`new`](Self::new).
    pub fn params(&self) -> &TelescopeParams {
        &self.params
    }

    fn check_stamp(params: &TelescopeParams) -> Result<StampGrid, OpticsError> {
        let stamp = params.stamp;
        if !(1..=64).contains(&stamp.oversampling) {
            return Err(OpticsError::setting(
                "stamp.oversampling",
                "a whole number from 1 to 64",
                stamp.oversampling,
            ));
        }
        let padded = (1.0..=16.0).contains(&stamp.padding);
        require("stamp.padding", "a number from 1 to 16", stamp.padding, padded)?;
        Ok(StampGrid::new(stamp.nx, stamp.ny)?
            .with_oversampling(stamp.oversampling as f64)?
            .with_pixel_response_included(params.detector.pixel_integration))
    }

    /// The transfer function along an axis for a source at the index `centre` of the stamp,
    /// including the pixel and the blur.
    fn axis_transfer(&self, centre: f64) -> AxisTransfer {
        let turn = -TAU * centre / self.focal_plane.period as f64;
        let lags = self.detector.iter().enumerate();
        AxisTransfer(
            lags.map(|(k, &t)| Complex64::from_polar(t, turn * k as f64))
                .collect(),
        )
    }
}

impl PsfSource for Telescope {
    fn grid(&self) -> StampGrid {
        self.grid
    }

    fn field(&self) -> FrameShape {
        self.field
    }

    fn draw_into(&self, position: Position, stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        self.draw_shifted_into(position, (0.0, 0.0), stamp)
    }

    fn draw_shifted_into(
        &self,
        position: Position,
        (dx, dy): (f64, f64),
        stamp: ArrayViewMut2<'_, f64>,
    ) -> Result<(), SourceError> {
        assert_eq!(stamp.dim(), self.grid.dim(), "the stamp has the grid's shape");
        let s = self.grid.oversampling();
        let x = self.axis_transfer(self.grid.centre_x() + dx * s);
        let y = self.axis_transfer(self.grid.centre_y() + dy * s);
        let phase = self.wavefront.phase(FieldCoordinates::of(position, self.field));
        let gain = (s / self.focal_plane.period as f64).powi(2);
        let steepest = self.focal_plane.draw(&phase, (&x, &y), gain, stamp);
        if steepest <= PI {
            return Ok(());
        }
        let period_px = self.focal_plane.period as f64 / s;
        let (got_px, limit_px) = (
            shown((steepest / TAU * period_px * 10.0).round() / 10.0),
            period_px / 2.0,
        );
        let source = OpticsError::Unusable(format!(
            "the wavefront at {position} sends light {got_px} frame pixels off the PSF's centre, but the computed focal \
             plane reaches only {limit_px:.1}: enlarge the stamp or stamp.padding, or check the Zernike coefficients"
        ));
        Err(SourceError::External {
            position,
            source: Box::new(source),
        })
    }
}
/// Formats a number for messages. Very small and very large numbers get an exponent.
fn shown(number: f64) -> String {
    if number == 0.0 || (1e-6..1e6).contains(&number.abs()) {
        number.to_string()
    } else {
        format!("{number:.1e}")
    }
}
