//! Polynomials of a PSF, used far outside the range to which they were fitted.

use std::fmt;

use psf_types::{Interpolation, OutsidePolicy, Position};

use super::{Origin, Psf};

/// The polynomials of a PSF are used far outside the range to which they were fitted. The PSF may
/// be wrong there.
#[derive(Debug, Clone, PartialEq)]
pub struct Extrapolation {
    /// The PSF file.
    pub file: Option<String>,
    /// The smallest and the largest coordinate of the range, for x and y.
    pub range: [(f64, f64); 2],
    /// The smallest and the largest coordinate of the positions, for x and y.
    pub used: [(f64, f64); 2],
    /// Distance of the farthest position from the range, in parts of the range, along x and y.
    pub beyond: [f64; 2],
}

/// Positions may lie outside the range by this part of the range. The stars of a frame, to which
/// polynomials are fitted, reach less far than the frame.
const ALLOWED: f64 = 0.1;

impl Psf {
    /// Returns the extrapolation at positions (pixels, 0-based) if the PSF is a polynomial there that
    /// was fitted to a much smaller range.
    pub fn extrapolation(&self, positions: &[Position]) -> Option<Extrapolation> {
        let range = self.polynomial_range()?;
        let used = Position::bounds(positions);
        let beyond = [0, 1].map(|axis| {
            let ((low, high), (from, to)) = (range[axis], used[axis]);
            (low - from).max(to - high).max(0.0) / (high - low)
        });
        (beyond[0].max(beyond[1]) > ALLOWED).then(|| Extrapolation {
            file: self.file_name(),
            range,
            used,
            beyond,
        })
    }

    /// The ranges of x and of y, in pixels, over which the polynomials of the PSF were fitted, if
    /// the PSF continues these polynomials outside the ranges. None for other PSFs.
    fn polynomial_range(&self) -> Option<[(f64, f64); 2]> {
        let (interpolation, outside) = match &self.0.origin {
            Origin::Samples(_, options) => (options.interpolation, options.outside),
            Origin::Record(record) => (record.interpolation(), record.outside()),
            Origin::Model(..) => return None,
        };
        let varies = matches!(interpolation, Interpolation::Polynomial { degree } if degree > 0);
        let extended = varies && outside == OutsidePolicy::Extend;
        extended.then(|| Position::bounds(self.positions().as_slice()))
    }
}

impl fmt::Display for Extrapolation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(file) = &self.file {
            write!(f, "{file}: ")?;
        }
        let [x, y] = self.range;
        let [of_x, of_y] = self.beyond.map(|part| (100.0 * part).round());
        let [used_x, used_y] = self.used;
        write!(
            f,
            "the polynomials of the PSF were fitted to x = {:.0} to {:.0} and y = {:.0} to {:.0}, but are used at x = {:.0} \
             to {:.0} and y = {:.0} to {:.0}. The PSF is extrapolated by {of_x} % of the range in x and {of_y} % in y, where \
             it may be wrong. Check whether x and y (columns and rows) are exchanged, or use the PSF at the edge of the range \
             (nearest)",
            x.0, x.1, y.0, y.1, used_x.0, used_x.1, used_y.0, used_y.1
        )
    }
}
