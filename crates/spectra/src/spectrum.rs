//! Spectra of sources.

use std::str::FromStr;

use crate::curve::Curve;
use crate::error::SpectraError;

/// Planck's radiation constant `h c / k` in micrometres times kelvin (CODATA 2018, exact).
const HC_OVER_K_UM_K: f64 = 14_387.768_775_039_337;

/// The meaning of the values of a table of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum FluxDensity {
    /// Energy per time and wavelength, `f_lambda`.
    #[default]
    PerWavelength,
    /// Energy per time and frequency, `f_nu`.
    PerFrequency,
    /// Photons per time and wavelength.
    Photons,
}

impl FromStr for FluxDensity {
    type Err = SpectraError;
    fn from_str(text: &str) -> Result<Self, SpectraError> {
        match text {
            "flambda" => Ok(Self::PerWavelength),
            "fnu" => Ok(Self::PerFrequency),
            "photons" => Ok(Self::Photons),
            _ => Err(SpectraError::Name(text.to_owned())),
        }
    }
}

/// The spectrum of a source, up to a factor.
///
/// By name: `blackbody:KELVIN` is Planck's law, `powerlaw:INDEX` is `f_lambda` proportional to
/// `lambda^INDEX`. With `@z=REDSHIFT` behind it, the spectrum is that of a source at this redshift:
/// every wavelength is `1 + z` times longer.
///
/// ```
/// use spectra::Spectrum;
/// let galaxy: Spectrum = "powerlaw:-1.5@z=0.5".parse()?;
/// assert_eq!(galaxy.redshift(), 0.5);
/// assert!("blackbody:cold".parse::<Spectrum>().is_err());
/// # Ok::<(), spectra::SpectraError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    shape: Shape,
    redshift: f64,
}

#[derive(Debug, Clone, PartialEq)]
enum Shape {
    BlackBody { kelvin: f64 },
    PowerLaw { index: f64 },
    Table(Curve, FluxDensity),
}

impl Spectrum {
    /// Planck's law for a temperature in kelvin.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless the temperature is from 100 to 1e9.
    pub fn black_body(kelvin: f64) -> Result<Self, SpectraError> {
        const ALLOWED: &str = "from 100 to 1e9 kelvin";
        SpectraError::check((100.0..=1e9).contains(&kelvin), "a temperature", ALLOWED, kelvin)?;
        Ok(Self::of(Shape::BlackBody { kelvin }))
    }

    /// A power law, `f_lambda` proportional to `lambda^index`.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless the index is from -50 to 50.
    pub fn power_law(index: f64) -> Result<Self, SpectraError> {
        let is_sound = index.abs() <= 50.0;
        SpectraError::check(is_sound, "the index of a power law", "from -50 to 50", index)?;
        Ok(Self::of(Shape::PowerLaw { index }))
    }

    /// A spectrum from a table of values.
    pub fn table(curve: Curve, values: FluxDensity) -> Self {
        Self::of(Shape::Table(curve, values))
    }

    fn of(shape: Shape) -> Self {
        Self { shape, redshift: 0.0 }
    }

    /// Sets the redshift of the source.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless the redshift is from -0.9 to 1e4.
    pub fn with_redshift(self, redshift: f64) -> Result<Self, SpectraError> {
        let is_sound = (-0.9..=1e4).contains(&redshift);
        SpectraError::check(is_sound, "a redshift", "from -0.9 to 1e4", redshift)?;
        Ok(Self { redshift, ..self })
    }

    /// The redshift.
    pub fn redshift(&self) -> f64 {
        self.redshift
    }

    /// The number of photons per wavelength at an observed wavelength, up to a factor:
    /// `f_lambda lambda`. 0 outside a table.
    pub fn photon_density(&self, wavelength_um: f64) -> f64 {
        // The factor of all wavelengths that comes with the redshift is left out.
        let emitted = wavelength_um / (1.0 + self.redshift);
        match &self.shape {
            Shape::BlackBody { kelvin } => {
                let x = HC_OVER_K_UM_K / (emitted * kelvin);
                emitted.powi(-4) / x.exp_m1()
            }
            Shape::PowerLaw { index } => emitted.powf(index + 1.0),
            Shape::Table(curve, values) => {
                let value = curve.at(emitted);
                match values {
                    FluxDensity::PerWavelength => value * emitted,
                    FluxDensity::PerFrequency => value / emitted,
                    FluxDensity::Photons => value,
                }
            }
        }
    }

    /// The observed wavelengths of the rows of a table. Empty for a formula.
    pub(crate) fn rows_um(&self) -> Vec<f64> {
        match &self.shape {
            Shape::Table(curve, _) => curve
                .wavelengths_um()
                .iter()
                .map(|w| w * (1.0 + self.redshift))
                .collect(),
            _ => Vec::new(),
        }
    }

    /// The observed range over which the spectrum is known, in micrometres.
    pub(crate) fn range_um(&self) -> (f64, f64) {
        match &self.shape {
            Shape::Table(curve, _) => {
                let (first, last) = curve.range();
                (first * (1.0 + self.redshift), last * (1.0 + self.redshift))
            }
            _ => (0.0, f64::INFINITY),
        }
    }
}

impl FromStr for Spectrum {
    type Err = SpectraError;
    fn from_str(text: &str) -> Result<Self, SpectraError> {
        let wrong = || SpectraError::Name(text.to_owned());
        let (name, redshift) = split_redshift(text)?;
        let (kind, number) = name.split_once(':').ok_or_else(wrong)?;
        let number: f64 = number.parse().map_err(|_| wrong())?;
        let spectrum = match kind {
            "blackbody" => Self::black_body(number)?,
            "powerlaw" => Self::power_law(number)?,
            _ => return Err(wrong()),
        };
        spectrum.with_redshift(redshift)
    }
}

/// Splits `NAME@z=REDSHIFT`. Without a redshift it is 0.
pub(crate) fn split_redshift(text: &str) -> Result<(&str, f64), SpectraError> {
    match text.rsplit_once("@z=") {
        None => Ok((text, 0.0)),
        Some((name, redshift)) => match redshift.parse() {
            Ok(redshift) => Ok((name, redshift)),
            Err(_) => Err(SpectraError::Name(text.to_owned())),
        },
    }
}

impl Spectrum {
    /// Splits the name of a spectrum into what stands before `@z=REDSHIFT`, and the redshift.
    ///
    /// # Errors
    /// [`SpectraError::Name`] if the redshift is not a number.
    pub fn split_redshift(text: &str) -> Result<(&str, f64), SpectraError> {
        split_redshift(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_black_body_has_its_maximum_where_wien_says() {
        // For photons per wavelength: lambda T = 3669.7 um K.
        let body = Spectrum::black_body(5800.0).unwrap();
        let at = |um: f64| body.photon_density(um);
        let peak = 3669.703 / 5800.0;
        assert!(at(peak) > at(peak * 1.001) && at(peak) > at(peak * 0.999));
        // A redshift moves the maximum.
        let far = body.clone().with_redshift(1.0).unwrap();
        assert!((far.photon_density(2.0 * peak) / at(peak) - 1.0).abs() < 1e-12);
        // Wien's limit and Rayleigh and Jeans' limit.
        assert!(Spectrum::black_body(100.0).unwrap().photon_density(0.3) >= 0.0);
        let hot = Spectrum::black_body(1e9).unwrap();
        assert!((hot.photon_density(1.0) / hot.photon_density(2.0) - 8.0).abs() < 1e-3);
    }

    #[test]
    fn tables_in_other_units_are_the_same_spectrum() {
        // f_lambda = 1 / lambda^2 is f_nu = constant, and photons = 1 / lambda.
        let wavelengths: Vec<f64> = (0..=1000).map(|i| 0.5 + 0.0005 * f64::from(i)).collect();
        let table = |values: fn(f64) -> f64, kind| {
            let values = wavelengths.iter().map(|&w| values(w)).collect();
            Spectrum::table(Curve::new(wavelengths.clone(), values).unwrap(), kind)
        };
        let tables = [
            table(|w| w.powi(-2), FluxDensity::PerWavelength),
            table(|_| 1.0, FluxDensity::PerFrequency),
            table(|w| 1.0 / w, FluxDensity::Photons),
        ];
        for table in &tables {
            for at in [0.5, 0.61, 0.9999] {
                // Linear interpolation between rows.
                assert!((table.photon_density(at) * at - 1.0).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn names_are_parsed() {
        assert_eq!("blackbody:5800".parse(), Spectrum::black_body(5800.0));
        let far = Spectrum::power_law(-1.5).unwrap().with_redshift(0.5);
        assert_eq!("powerlaw:-1.5@z=0.5".parse(), far);
        for wrong in ["blackbody", "blackbody:x", "sun:5800", "powerlaw:1@z=x", ""] {
            let message = wrong.parse::<Spectrum>().unwrap_err().to_string();
            assert!(message.contains("blackbody:KELVIN"), "{message}");
        }
        assert!("blackbody:5".parse::<Spectrum>().is_err());
        assert!("powerlaw:1@z=-1".parse::<Spectrum>().is_err());
    }
}
