//! Sub-pixel phases of stamps whose oversampling is a whole number.

use psf_types::StampGrid;

use crate::stamp_interpolator::Kernel;

/// Coordinates this close to a pixel of the stamp are on it: rounding, not position.
const ON_PIXEL: f64 = 1e-9;

/// One axis of a stamp `s` times finer than the frame. Its coefficients, with what the kernel needs beyond its ends, are kept by residue
/// modulo `s`: coefficient `p = s q + r` at `[r][q]`. A star takes the same residues in every pixel of the frame, and
/// neighbouring pixels neighbouring `q`.
#[derive(Debug, Clone, Copy)]
pub(super) struct PhasedAxis {
    kernel: Kernel,
    length: usize,
    centre: f64,
    oversampling: usize,
    /// Coefficients kept before the first and after the last.
    margins: (usize, usize),
}

/// A star's place on an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phase {
    /// The first coefficient of the pixel that the star lies on, counted from the first kept.
    first: i64,
    /// The pixels that the stamp reaches, counted from that one.
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) weights: [f64; crate::stamp_interpolator::MOST_TAPS],
}

impl PhasedAxis {
    /// The columns and the rows of a grid, if its oversampling is a whole number.
    pub(super) fn both(grid: StampGrid) -> Option<[Self; 2]> {
        let s = grid.oversampling();
        if s.fract() != 0.0 || s > f64::from(u16::MAX) {
            return None;
        }
        let kernel = Kernel::of(grid.interpolation());
        let axis = |length: usize, centre: f64| {
            let domain = kernel.domain(length);
            let before = -(domain.start().round() as i64 + kernel.first_tap());
            let last = domain.end().round() as i64 + kernel.first_tap() + kernel.tap_count() as i64 - 1;
            Self {
                kernel,
                length,
                centre,
                oversampling: s as usize,
                margins: (before as usize, (last - (length as i64 - 1)) as usize),
            }
        };
        Some([axis(grid.nx(), grid.centre_x()), axis(grid.ny(), grid.centre_y())])
    }

    pub(super) fn oversampling(&self) -> usize {
        self.oversampling
    }

    pub(super) fn tap_count(&self) -> usize {
        self.kernel.tap_count()
    }

    /// Coefficients kept.
    pub(super) fn kept(&self) -> usize {
        self.margins.0 + self.length + self.margins.1
    }

    /// Where the coefficient stands in the stamp that is kept at `kept`; none where there is nothing.
    pub(super) fn index(&self, kept: usize) -> Option<usize> {
        self.kernel
            .index(kept as i64 - self.margins.0 as i64, self.length)
    }

    /// The place of a star `shift` frame pixels beyond the centre of its pixel, for pixels `from..to` about that; none where the stamp
    /// reaches no pixel.
    pub(super) fn phase(&self, shift: f64, from: i64, to: i64) -> Option<Phase> {
        let s = self.oversampling as f64;
        let mut at = self.centre - s * shift;
        if (at - at.round()).abs() < ON_PIXEL {
            at = at.round();
        }
        let domain = self.kernel.domain(self.length);
        let from = from.max(((domain.start() - at) / s).ceil() as i64);
        let to = to.min(((domain.end() - at) / s).floor() as i64 + 1);
        (from < to).then(|| Phase {
            first: at.floor() as i64 + self.kernel.first_tap() + self.margins.0 as i64,
            from,
            to,
            weights: self.kernel.weights(at - at.floor()),
        })
    }
}

impl Phase {
    /// The first coefficient of a pixel.
    pub(super) fn first_of(&self, pixel: i64, oversampling: usize) -> usize {
        (self.first + pixel * oversampling as i64) as usize
    }

    /// Residue and `q` of a tap, for the pixel `from`.
    pub(super) fn tap(&self, tap: usize, oversampling: usize) -> (usize, usize) {
        let p = self.first_of(self.from, oversampling) + tap;
        (p % oversampling, p / oversampling)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stamp_interpolator::Taps;
    use psf_types::StampInterpolation;

    /// The same coefficients and weights as the general rule gives, pixel by pixel.
    #[test]
    fn phases_are_the_taps_of_every_pixel() {
        for interpolation in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
            for (length, s, centre) in [
                (25, 4, 12.0),
                (24, 3, 11.5),
                (9, 1, 4.0),
                (7, 8, 3.0),
                (1, 1, 0.0),
            ] {
                let grid = StampGrid::new(length, 3)
                    .and_then(|g| g.with_oversampling(f64::from(s)))
                    .and_then(|g| g.with_centre(centre, 1.0))
                    .unwrap()
                    .with_interpolation(interpolation);
                let [axis, _] = PhasedAxis::both(grid).unwrap();
                for shift in [-0.5, -0.25, 0.0, 0.1, 0.37, 0.499_999_999_999] {
                    let window = -40..40;
                    let taps = Taps::new(Kernel::of(interpolation), length, 0.0, 80, |i| {
                        centre + f64::from(s) * ((i as f64 - 40.0) - shift)
                    });
                    let phase = axis.phase(shift, window.start, window.end);
                    for pixel in window.clone() {
                        let mut dense = vec![0.0; length];
                        for &(index, weight) in taps.of((pixel - window.start) as usize) {
                            dense[index] += weight;
                        }
                        if let Some(phase) = phase
                            && (phase.from..phase.to).contains(&pixel)
                        {
                            let first = phase.first_of(pixel, axis.oversampling());
                            for tap in 0..axis.tap_count() {
                                if let Some(index) = axis.index(first + tap) {
                                    dense[index] -= phase.weights[tap];
                                }
                            }
                        }
                        assert!(
                            dense.iter().all(|d| d.abs() < 1e-8),
                            "{interpolation} {length} {s} {shift} {pixel}: {dense:?}"
                        );
                    }
                    // None only where a stamp smaller than a pixel misses every centre, as the taps above say.
                    assert!(phase.is_some() || length < s as usize || length == 1);
                    assert!(phase.is_none_or(|phase| {
                        axis.kept() >= phase.first_of(phase.to - 1, axis.oversampling()) + axis.tap_count()
                    }));
                }
            }
        }
        let fractional = StampGrid::new(9, 9).unwrap().with_oversampling(2.1).unwrap();
        assert!(PhasedAxis::both(fractional).is_none());
    }
}
