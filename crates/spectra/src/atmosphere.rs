//! Refraction of the atmosphere.

use crate::error::SpectraError;

/// The state of the atmosphere above a telescope, and the direction of a source. Its refraction
/// shifts light of each wavelength by another angle towards the zenith.
///
/// The refractive index is that of Filippenko (1982, PASP 94, 715, equations 1 to 3), after Edlen
/// (1953) and Barrell (1951): with `s = 1 / wavelength_um`, pressure `P` (mmHg), temperature `t`
/// (Celsius) and the pressure `f` of water vapour (mmHg),
///
/// ```text
/// (n0 - 1) 1e6 = 64.328 + 29498.1 / (146 - s^2) + 255.4 / (41 - s^2)
/// (n - 1) 1e6 = (n0 - 1) 1e6 P (1 + (1.049 - 0.0157 t) 1e-6 P) / (720.883 (1 + 0.003661 t))
///               - f (0.0624 - 0.000680 s^2) / (1 + 0.003661 t)
/// ```
///
/// The refraction at the zenith distance `z` is `(n^2 - 1) / (2 n^2) tan z` (Stone 1996, PASP 108,
/// 1051), which holds for a flat atmosphere, up to about 75 degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Atmosphere {
    zenith_distance_deg: f64,
    pressure_hpa: f64,
    temperature_c: f64,
    water_vapour_hpa: f64,
}

/// Millimetres of mercury per hectopascal.
const MMHG_PER_HPA: f64 = 0.750_061_683;
const ARCSEC_PER_RADIAN: f64 = 206_264.806_247_096_36;

impl Atmosphere {
    /// An atmosphere of Filippenko's example: 600 mmHg (799.9 hPa), 7 degrees Celsius, 8 mmHg
    /// (10.67 hPa) of water vapour, at a zenith distance in degrees.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless the zenith distance is from 0 to below 90.
    pub fn new(zenith_distance_deg: f64) -> Result<Self, SpectraError> {
        let (name, allowed) = ("the zenith distance", "from 0 to below 90 degrees");
        let is_sound = (0.0..90.0).contains(&zenith_distance_deg);
        SpectraError::check(is_sound, name, allowed, zenith_distance_deg)?;
        Ok(Self {
            zenith_distance_deg,
            pressure_hpa: 600.0 / MMHG_PER_HPA,
            temperature_c: 7.0,
            water_vapour_hpa: 8.0 / MMHG_PER_HPA,
        })
    }

    /// Sets the pressure, in hectopascals.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless it is from 0 to 1200.
    pub fn with_pressure_hpa(self, pressure_hpa: f64) -> Result<Self, SpectraError> {
        let is_sound = (0.0..=1200.0).contains(&pressure_hpa);
        SpectraError::check(is_sound, "the pressure", "from 0 to 1200 hPa", pressure_hpa)?;
        Ok(Self { pressure_hpa, ..self })
    }

    /// Sets the temperature, in degrees Celsius.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless it is from -100 to 60.
    pub fn with_temperature_c(self, temperature_c: f64) -> Result<Self, SpectraError> {
        let is_sound = (-100.0..=60.0).contains(&temperature_c);
        let allowed = "from -100 to 60 degrees Celsius";
        SpectraError::check(is_sound, "the temperature", allowed, temperature_c)?;
        Ok(Self {
            temperature_c,
            ..self
        })
    }

    /// Sets the pressure of water vapour, in hectopascals.
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless it is from 0 to 200.
    pub fn with_water_vapour_hpa(self, water_vapour_hpa: f64) -> Result<Self, SpectraError> {
        let is_sound = (0.0..=200.0).contains(&water_vapour_hpa);
        let name = "the pressure of water vapour";
        SpectraError::check(is_sound, name, "from 0 to 200 hPa", water_vapour_hpa)?;
        Ok(Self {
            water_vapour_hpa,
            ..self
        })
    }

    /// Sets the pressure of water vapour from the relative humidity, 0 to 1, at this temperature. The
    /// pressure of saturation is that of Buck (1981, J. Appl. Meteorol. 20, 1527, with the constants
    /// of his 1996 manual).
    ///
    /// # Errors
    /// [`SpectraError::Setting`] unless the humidity is from 0 to 1.
    pub fn with_humidity(self, humidity: f64) -> Result<Self, SpectraError> {
        let is_sound = (0.0..=1.0).contains(&humidity);
        SpectraError::check(is_sound, "the relative humidity", "from 0 to 1", humidity)?;
        let t = self.temperature_c;
        let saturated_hpa = 6.1121 * ((18.678 - t / 234.5) * (t / (257.14 + t))).exp();
        self.with_water_vapour_hpa(humidity * saturated_hpa)
    }

    /// `n - 1` of the air at a wavelength in micrometres.
    pub fn refractivity(&self, wavelength_um: f64) -> f64 {
        let s2 = wavelength_um.powi(-2);
        let (p, t) = (self.pressure_hpa * MMHG_PER_HPA, self.temperature_c);
        let f = self.water_vapour_hpa * MMHG_PER_HPA;
        let warmth = 1.0 + 0.003_661 * t;
        let sea_level = 64.328 + 29_498.1 / (146.0 - s2) + 255.4 / (41.0 - s2);
        let dry = sea_level * p * (1.0 + (1.049 - 0.0157 * t) * 1e-6 * p) / (720.883 * warmth);
        (dry - f * (0.0624 - 0.000_680 * s2) / warmth) * 1e-6
    }

    /// The angle by which light of a wavelength in micrometres is shifted towards the zenith, in
    /// arcseconds.
    ///
    /// ```
    /// use spectra::Atmosphere;
    /// // At an air mass of 1.5, light of 0.4 um lies 0.712 arcseconds higher than light of 0.5 um
    /// // (GalSim 2.8.5, dcr.get_refraction, agrees).
    /// let atmosphere = Atmosphere::new((1.0f64 / 1.5).acos().to_degrees())?;
    /// let above = |um| atmosphere.refraction_arcsec(um) - atmosphere.refraction_arcsec(0.5);
    /// assert!((above(0.4) - 0.71222).abs() < 1e-5);
    /// # Ok::<(), spectra::SpectraError>(())
    /// ```
    pub fn refraction_arcsec(&self, wavelength_um: f64) -> f64 {
        let square = (1.0 + self.refractivity(wavelength_um)).powi(2);
        let tan = self.zenith_distance_deg.to_radians().tan();
        (square - 1.0) / (2.0 * square) * tan * ARCSEC_PER_RADIAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn humid_air_has_the_vapour_of_its_temperature() {
        // Saturated air at 20 degrees holds 23.4 hPa (Buck 1981).
        let air = Atmosphere::new(30.0).unwrap().with_temperature_c(20.0).unwrap();
        let humid = air.with_humidity(1.0).unwrap();
        assert!((humid.water_vapour_hpa - 23.38).abs() < 0.02);
        assert!(humid.refractivity(0.5) < air.with_humidity(0.0).unwrap().refractivity(0.5));
        assert!(air.with_humidity(1.1).is_err());
    }

    #[test]
    fn light_at_the_zenith_is_not_shifted() {
        assert_eq!(Atmosphere::new(0.0).unwrap().refraction_arcsec(0.4), 0.0);
        assert!(Atmosphere::new(90.0).is_err());
        let vacuum = Atmosphere::new(60.0).unwrap().with_pressure_hpa(0.0).unwrap();
        let vacuum = vacuum.with_water_vapour_hpa(0.0).unwrap();
        assert_eq!(vacuum.refraction_arcsec(0.4), 0.0);
    }
}
