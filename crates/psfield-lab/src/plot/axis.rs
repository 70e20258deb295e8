//! Axes: how values lie along them, and the numbers beside them.

use psfield::readable;

/// An axis: its name with the unit, its spacing (linear or logarithmic), and the values at its ends.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) name: String,
    spacing: Spacing,
    /// None: the range of the values.
    ends: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            spacing: Spacing::Linear,
            ends: None,
        }
    }

    /// A logarithmic axis. Points whose coordinate along the axis is not above 0 are left out.
    pub fn logarithmic(name: &str) -> Self {
        Self {
            spacing: Spacing::Logarithmic,
            ..Self::linear(name)
        }
    }

    /// Sets the values at both ends of the axis.
    #[must_use]
    pub fn within(self, low: f64, high: f64) -> Self {
        Self {
            ends: Some((low, high)),
            ..self
        }
    }

    /// Returns whether the axis can show a value.
    pub(super) fn shows(&self, value: f64) -> bool {
        value.is_finite() && (value > 0.0 || self.spacing != Spacing::Logarithmic)
    }

    /// The ruler of this axis for some values: with the given ends, or else from the smallest value
    /// to the largest, with a margin (linear) or to whole powers of ten (logarithmic).
    pub(super) fn ruler(&self, values: impl Iterator<Item = f64>) -> Ruler {
        let range = || {
            let (low, high) = bounds(values.filter(|&v| self.shows(v)));
            if low > high {
                return (0.1, 1.0);
            }
            if self.spacing == Spacing::Linear {
                let room = 0.04 * (high - low).max(1e-6 * high.abs()).max(1e-12);
                return (low - room, high + room);
            }
            let (low, high) = (low.log10().floor(), high.log10().ceil());
            (10f64.powf(low), 10f64.powf(high.max(low + 1.0)))
        };
        let (low, high) = self.ends.unwrap_or_else(range);
        Ruler {
            spacing: self.spacing,
            low,
            high,
        }
    }
}

/// Returns the smallest and the largest of the finite values, or `(infinity, -infinity)` if there
/// are none.
pub(super) fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}

/// The spacing of values along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spacing {
    Linear,
    Logarithmic,
    /// `asinh(v / soft)`: linear below about `soft`, logarithmic above. The range begins at 0.
    Asinh(f64),
}

/// Gives each value from `low` to `high` its place along an axis or a colour bar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ruler {
    pub(super) spacing: Spacing,
    pub(super) low: f64,
    pub(super) high: f64,
}

/// Smallest distance between two numbers along a logarithmic axis or an asinh axis, as a fraction
/// of its length.
const APART: f64 = 0.12;
/// Approximate number of steps between numbers along a linear axis.
const STEPS: f64 = 6.0;
/// A number may lie beyond the end of its axis by this fraction of a step or of the value at the end.
const ROUNDING: f64 = 1e-9;

impl Ruler {
    /// The place of a value: 0 at `low`, 1 at `high`.
    pub(super) fn at(self, value: f64) -> f64 {
        let [value, low, high] = [value, self.low, self.high].map(|v| match self.spacing {
            Spacing::Linear => v,
            Spacing::Logarithmic => v.max(f64::MIN_POSITIVE).log10(),
            Spacing::Asinh(soft) => (v / soft).asinh(),
        });
        (value - low) / (high - low).max(f64::MIN_POSITIVE)
    }

    /// The values that have a number beside the axis.
    ///
    /// On a linear axis, the step between them is 1, 2 or 5 times a power of ten. On other axes they
    /// are 1, 2 and 5 times powers of ten, and 0 on an asinh axis. A value too close to another is left
    /// out. An axis with fewer than two of these has the numbers of a linear axis.
    fn ticks(self) -> Vec<f64> {
        let Self { spacing, low, high } = self;
        let (mut ticks, first) = match spacing {
            Spacing::Linear => return even_ticks(low, high),
            Spacing::Logarithmic => (Vec::new(), low.max(f64::MIN_POSITIVE)),
            Spacing::Asinh(soft) => (vec![0.0], soft / 10.0),
        };
        let powers = first.log10().floor() as i32..=high.log10().ceil() as i32;
        let of_powers = |factor: f64| powers.clone().map(move |k| factor * 10f64.powi(k));
        // Powers of ten come first, so that no other number displaces them.
        for value in of_powers(1.0).chain(of_powers(2.0)).chain(of_powers(5.0)) {
            let within = low * (1.0 - ROUNDING) <= value && value <= high * (1.0 + ROUNDING);
            if within
                && ticks
                    .iter()
                    .all(|&t| (self.at(t) - self.at(value)).abs() >= APART)
            {
                ticks.push(value);
            }
        }
        if ticks.len() > 1 {
            ticks
        } else {
            even_ticks(low, high)
        }
    }

    /// The places of the numbers beside the axis, and their texts.
    pub(super) fn numbers(self) -> impl Iterator<Item = (f64, String)> {
        self.ticks().into_iter().map(move |tick| {
            // A value that is 0 up to rounding is shown as 0.
            let is_zero = self.low <= 0.0 && tick.abs() < ROUNDING * (self.high - self.low);
            (self.at(tick), readable(if is_zero { 0.0 } else { tick }, 4))
        })
    }
}

fn even_ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / STEPS;
    if !(rough > 0.0 && rough.is_finite()) {
        return vec![low];
    }
    let unit = 10f64.powf(rough.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|factor| factor * unit).into_iter();
    let step = steps.into_iter().find(|step| *step >= rough * (1.0 - ROUNDING));
    let step = step.unwrap_or(10.0 * unit);
    let (first, last) = (
        (low / step - ROUNDING).ceil() as i64,
        (high / step + ROUNDING).floor() as i64,
    );
    (first..=last).map(|k| k as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(spacing: Spacing, low: f64, high: f64) -> Vec<String> {
        let ruler = Ruler { spacing, low, high };
        ruler.numbers().map(|(_, text)| text).collect()
    }

    #[test]
    fn rulers_hold_all_values_and_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0], vec![-1.0, 5.0, f64::NAN]] {
            let ruler = Axis::linear("x").ruler(values.iter().copied());
            assert!(ruler.low < ruler.high);
            assert!(
                values
                    .iter()
                    .all(|&v| v.is_nan() || (0.0..1.0).contains(&ruler.at(v)))
            );
            let ruler = Axis::logarithmic("x").ruler(values.iter().copied());
            assert!(ruler.low > 0.0 && ruler.low < ruler.high);
        }
        let ruler = Axis::logarithmic("x").ruler([2e-3, 5e-2].into_iter());
        assert_eq!((ruler.low, ruler.high), (1e-3, 1e-1));
        assert_eq!((ruler.at(1e-3), ruler.at(1e-2), ruler.at(1e-1)), (0.0, 0.5, 1.0));
    }

    #[test]
    fn even_steps_are_round_and_hold_the_ends() {
        let even = |low, high| shown(Spacing::Linear, low, high);
        assert_eq!(even(-1.0, 1.0), ["-1", "-0.5", "0", "0.5", "1"]);
        assert_eq!(even(0.0, 1024.0), ["0", "200", "400", "600", "800", "1000"]);
        assert_eq!(even(0.0, 0.3), ["0", "0.05", "0.1", "0.15", "0.2", "0.25", "0.3"]);
        assert_eq!(even_ticks(3.0, 3.0), [3.0]);
    }

    #[test]
    fn logarithmic_axes_have_powers_of_ten_and_what_fits_between_them() {
        let of = |low, high| shown(Spacing::Logarithmic, low, high);
        assert_eq!(of(1e-4, 1e-1), ["1e-4", "0.001", "0.01", "0.1"]);
        assert_eq!(of(3e-12, 2e-9), ["1e-11", "1e-10", "1e-9"]);
        assert_eq!(of(1e-30, 1e30).len(), 8);
        assert_eq!(of(3e-12, 4e-11), ["1e-11", "2e-11", "5e-12"]);
        assert_eq!(of(2.1, 2.5), ["2.1", "2.2", "2.3", "2.4", "2.5"]);
    }

    #[test]
    fn asinh_axes_have_round_numbers_apart() {
        for (soft, high) in [(30.0, 3000.0), (0.02, 1.0), (1e-12, 1e-3), (1.0, 1.5)] {
            let ruler = Ruler {
                spacing: Spacing::Asinh(soft),
                low: 0.0,
                high,
            };
            let mut places: Vec<f64> = ruler.numbers().map(|(place, _)| place).collect();
            places.sort_by(f64::total_cmp);
            assert!(places.len() >= 3 && places[0] == 0.0, "{places:?}");
            assert!(places.windows(2).all(|w| w[1] - w[0] >= APART), "{places:?}");
        }
    }
}
