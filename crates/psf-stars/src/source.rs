//! Sources of a frame.

use serde::{Serialize, Serializer};

/// Why a source does not serve as a PSF sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Rejection {
    /// A pixel of its core is at the saturation level.
    Saturated,
    /// Its stamp would reach beyond the frame.
    Edge,
    /// Its signal-to-noise ratio is below the limit.
    LowSnr,
    /// Another source lies too close for its brightness.
    Neighbour,
    /// No Gaussian fits it.
    NoFit,
    /// Narrower than the stars about it: a hot pixel or a cosmic ray.
    TooSharp,
    /// Broader than the stars about it: a galaxy or a blend.
    TooBroad,
    /// Elongated otherwise than the stars about it: a blend, a trail or a galaxy.
    Elongated,
    /// The oversampled PSF made of the other stars does not fit it.
    PsfMismatch,
}

impl Rejection {
    /// All of them, in the order in which they are looked for.
    pub const ALL: [Self; 9] = [
        Self::Saturated,
        Self::Edge,
        Self::LowSnr,
        Self::Neighbour,
        Self::NoFit,
        Self::TooSharp,
        Self::TooBroad,
        Self::Elongated,
        Self::PsfMismatch,
    ];

    /// A short name, as it stands in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Saturated => "saturated",
            Self::Edge => "edge",
            Self::LowSnr => "low-snr",
            Self::Neighbour => "neighbour",
            Self::NoFit => "no-fit",
            Self::TooSharp => "too-sharp",
            Self::TooBroad => "too-broad",
            Self::Elongated => "elongated",
            Self::PsfMismatch => "psf-mismatch",
        }
    }
}

/// A set of reasons; empty for a source that serves as a sample. Written as names joined by `+`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rejections(u16);

impl Rejections {
    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether this is one of them.
    pub fn contains(self, reason: Rejection) -> bool {
        self.0 & (1 << reason as u16) != 0
    }

    /// The reasons.
    pub fn iter(self) -> impl Iterator<Item = Rejection> {
        Rejection::ALL
            .into_iter()
            .filter(move |&reason| self.contains(reason))
    }

    pub(crate) fn insert(&mut self, reason: Rejection) {
        self.0 |= 1 << reason as u16;
    }
}

impl std::fmt::Display for Rejections {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (k, reason) in self.iter().enumerate() {
            if k > 0 {
                f.write_str("+")?;
            }
            f.write_str(reason.name())?;
        }
        Ok(())
    }
}

impl Serialize for Rejections {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The columns of a table of [`Source`]s.
pub const SOURCE_COLUMNS: [&str; 15] = [
    "x",
    "y",
    "flux",
    "snr",
    "significance",
    "peak",
    "background",
    "background_rms",
    "fwhm_px",
    "e1",
    "e2",
    "pixel_count",
    "nearest_px",
    "sample",
    "rejected",
];

/// A source of a frame, whether or not it became a PSF sample.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Source {
    /// Column coordinate of the centre, 0-based pixels of the frame: of the PSF fitted to it, else of a Gaussian.
    pub x: f64,
    /// Row coordinate of the centre.
    pub y: f64,
    /// Flux in units of the frame: the PSF of the nearest sample, in unit flux over its stamp, fitted to the source. Saturated pixels
    /// do not count.
    pub flux: f64,
    /// Signal-to-noise ratio in an aperture of radius 1.25 FWHM ([`Camera`](crate::Camera)).
    pub snr: f64,
    /// Height of the matched-filtered peak in sigma of the background noise.
    pub significance: f64,
    /// The brightest pixel of its core, background included.
    pub peak: f64,
    /// The background at its centre.
    pub background: f64,
    /// The noise of the background at its centre.
    pub background_rms: f64,
    /// FWHM of the Gaussian fit in pixels (geometric mean of the axes), none where there is no fit.
    pub fwhm_px: Option<f64>,
    /// Distortion of the Gaussian fit along the axes of the grid.
    pub e1: Option<f64>,
    /// Distortion along the diagonals.
    pub e2: Option<f64>,
    /// Pixels above the threshold that belong to it.
    pub pixel_count: usize,
    /// Distance to the nearest other source in pixels, none for a lonely one.
    pub nearest_px: Option<f64>,
    /// Index of its PSF sample, none where it was rejected.
    pub sample: Option<usize>,
    /// Why it was rejected.
    pub rejected: Rejections,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_a_set_with_names() {
        let mut reasons = Rejections::default();
        assert!(reasons.is_empty() && reasons.to_string().is_empty());
        for reason in Rejection::ALL {
            assert!(!reasons.contains(reason));
            reasons.insert(reason);
            reasons.insert(reason);
            assert!(reasons.contains(reason));
        }
        assert_eq!(reasons.iter().count(), Rejection::ALL.len());
        assert!(reasons.to_string().starts_with("saturated+edge+low-snr"));
    }
}
