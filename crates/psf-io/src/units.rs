//! Units of wavelengths, times and angles in files.

/// A unit of wavelengths, in micrometres. None for any other unit.
pub(crate) fn wavelength_in_um(unit: &str) -> Option<f64> {
    match unit.trim().to_ascii_lowercase().as_str() {
        "um" | "micron" | "microns" | "micrometer" | "micrometers" | "micrometre" | "micrometres" => {
            Some(1.0)
        }
        "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => Some(1e-3),
        "angstrom" | "angstroms" | "0.1 nm" => Some(1e-4),
        "mm" => Some(1e3),
        "m" => Some(1e6),
        _ => None,
    }
}

/// A value times the factor of its unit. Division by whole numbers keeps the digits of decimal units:
/// 700 nm is 0.7 um.
pub(crate) fn in_unit(value: f64, factor: f64) -> f64 {
    if factor < 1.0 {
        value / (1.0 / factor).round()
    } else {
        value * factor
    }
}

/// A unit of times, in seconds. None for any other unit.
pub(crate) fn time_in_s(unit: &str) -> Option<f64> {
    match unit.trim().to_ascii_lowercase().as_str() {
        "s" | "sec" => Some(1.0),
        "min" => Some(60.0),
        "h" => Some(3600.0),
        "d" | "day" => Some(86400.0),
        _ => None,
    }
}

/// A unit of angles, in degrees. None for any other unit.
pub(crate) fn angle_in_deg(unit: &str) -> Option<f64> {
    match unit.trim().to_ascii_lowercase().as_str() {
        "deg" | "degree" | "degrees" => Some(1.0),
        "arcmin" => Some(1.0 / 60.0),
        "arcsec" => Some(1.0 / 3600.0),
        "mas" => Some(1.0 / 3.6e6),
        "rad" | "radian" | "radians" => Some(1.0_f64.to_degrees()),
        "hourangle" | "hour" | "hr" | "h" => Some(15.0),
        _ => None,
    }
}
