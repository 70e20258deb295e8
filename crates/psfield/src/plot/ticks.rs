//! Where numbers stand on an axis.

/// The most whole decades that are numbered.
const DECADES: i32 = 7;
/// Steps of an even axis, about.
const STEPS: f64 = 5.0;
/// Numbers of a stretched bar keep this part of its length apart.
const APART: f64 = 0.09;
/// Decades of a stretched bar that are looked at.
const MOST_DECADES: i32 = 40;

/// Multiples of 1, 2 or 5 times a power of ten.
pub(super) fn even(low: f64, high: f64) -> Vec<f64> {
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) {
        return vec![low];
    }
    let rough = span / STEPS;
    let unit = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * unit)
        .find(|&step| step >= rough * (1.0 - ROUNDING))
        .unwrap_or(10.0 * unit);
    let (first, last) = (
        (low / step - ROUNDING).ceil() as i64,
        (high / step + ROUNDING).floor() as i64,
    );
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Of a range above 0: whole decades, of many every second, third, ...; where there are fewer than two, 1, 2 and 5 within; and even
/// steps in a range that has hardly any of these.
pub(super) fn logarithmic(low: f64, high: f64) -> Vec<f64> {
    let low = low.max(f64::MIN_POSITIVE);
    let first = (low.log10() - ROUNDING).ceil() as i32;
    let last = (high.log10() + ROUNDING).floor() as i32;
    if (high / low).log10() >= 2.0 - ROUNDING {
        let stride = (last - first) / DECADES + 1;
        return (first..=last)
            .step_by(stride as usize)
            .map(|k| 10f64.powi(k))
            .collect();
    }
    let within = one_two_five(first - 1, last, low, high);
    if within.len() > 1 { within } else { even(low, high) }
}

/// Of a bar from 0 to `high` that is linear up to `soft` and logarithmic above (`asinh(v / soft)`): 0 and 1, 2, 5 of each decade, as far as
/// they are not too close.
pub(super) fn asinh(soft: f64, high: f64) -> Vec<f64> {
    let along = |v: f64| (v / soft).asinh() / (high / soft).asinh();
    let last = high.log10().floor() as i32;
    let first = ((soft / 10.0).log10().floor() as i32).max(last.saturating_sub(MOST_DECADES));
    let mut ticks = vec![0.0];
    // Whole decades go first.
    let mut candidates = one_two_five(first, last, 0.0, high);
    candidates.sort_by_key(|&v| (v.log10() - v.log10().round()).abs() > ROUNDING);
    for value in candidates {
        if ticks.iter().all(|&t| (along(value) - along(t)).abs() >= APART) {
            ticks.push(value);
        }
    }
    ticks.sort_by(f64::total_cmp);
    ticks
}

/// Part of a step by which a tick may miss the end of its axis.
const ROUNDING: f64 = 1e-9;

fn one_two_five(first: i32, last: i32, low: f64, high: f64) -> Vec<f64> {
    (first..=last)
        .flat_map(|k| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(k)))
        .filter(|v| (low * (1.0 - ROUNDING)..=high * (1.0 + ROUNDING)).contains(v))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readable::readable;

    fn shown(ticks: &[f64]) -> Vec<String> {
        ticks.iter().map(|&v| readable(v, 4)).collect()
    }

    #[test]
    fn decades_are_whole() {
        assert_eq!(shown(&logarithmic(3e-12, 2e-9)), ["1e-11", "1e-10", "1e-9"]);
        assert_eq!(shown(&logarithmic(1e-4, 1e-1)), ["1e-4", "0.001", "0.01", "0.1"]);
        assert_eq!(shown(&logarithmic(1e-30, 1e30)).len(), 7);
        // Fewer than two.
        assert_eq!(shown(&logarithmic(3e-12, 4e-11)), ["5e-12", "1e-11", "2e-11"]);
        assert_eq!(shown(&logarithmic(2.0, 5.0)), ["2", "5"]);
        assert_eq!(shown(&logarithmic(2.1, 2.5)), ["2.1", "2.2", "2.3", "2.4", "2.5"]);
    }

    #[test]
    fn even_steps_are_round_and_hold_the_ends() {
        assert_eq!(shown(&even(-1.0, 1.0)), ["-1", "-0.5", "0", "0.5", "1"]);
        assert_eq!(shown(&even(0.0, 0.3)), ["0", "0.1", "0.2", "0.3"]);
        assert_eq!(even(3.0, 3.0), [3.0]);
    }

    #[test]
    fn a_stretched_bar_has_round_numbers_apart() {
        for (soft, high) in [(30.0, 3000.0), (0.02, 1.0), (1e-12, 1e-3), (1.0, 1.5)] {
            let ticks = asinh(soft, high);
            let along = |v: f64| (v / soft).asinh() / (high / soft).asinh();
            assert!(ticks.len() >= 3, "{ticks:?}");
            assert!(
                ticks.windows(2).all(|w| along(w[1]) - along(w[0]) >= APART),
                "{ticks:?}"
            );
        }
        assert_eq!(shown(&asinh(30.0, 3000.0))[..2], ["0", "20"]);
    }
}
