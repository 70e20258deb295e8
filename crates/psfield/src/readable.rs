//! Formats numbers for people to read.

/// Formats a number with `figures` significant figures (at least 1) without trailing zeros: `0.05`,
/// `9216`, `2.5e-7`. An exponent is written if the absolute value is below 0.001, or if the number
/// has more than `figures` and more than five digits before the point. Without an exponent, all
/// digits before the point are written.
pub fn readable(value: f64, figures: usize) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let mantissa_decimals = figures.saturating_sub(1);
    let rounded = format!("{value:.mantissa_decimals$e}");
    let Some((mantissa, exponent)) = rounded.split_once('e') else {
        // Infinite or NaN.
        return rounded;
    };
    let exponent: i32 = exponent.parse().expect("a number in exponent form");
    if (-3..figures.max(5) as i32).contains(&exponent) {
        let decimals = (mantissa_decimals as i32 - exponent).max(0) as usize;
        without_end_zeros(&format!("{value:.decimals$}")).to_owned()
    } else {
        format!("{}e{exponent}", without_end_zeros(mantissa))
    }
}

fn without_end_zeros(number: &str) -> &str {
    if number.contains('.') {
        number.trim_end_matches('0').trim_end_matches('.')
    } else {
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (0.1, "0.1"),
            (1.5, "1.5"),
            (0.001, "0.001"),
            (1e-4, "1e-4"),
            (0.000_999_99, "0.001"),
            (2.5e-7, "2.5e-7"),
            (1.25e-4, "1.25e-4"),
            (9216.0, "9216"),
            (12_345.0, "12345"),
            (-0.05, "-0.05"),
            (1e6, "1e6"),
            (f64::INFINITY, "inf"),
            (5e-324, "4.941e-324"),
        ] {
            assert_eq!(readable(value, 4), text);
        }
        assert_eq!(readable(-6.795_561_234e-16, 6), "-6.79556e-16");
        assert_eq!(readable(65_535.25, 6), "65535.2");
        assert_eq!(readable(1_234_567.0, 6), "1.23457e6");
    }
}
