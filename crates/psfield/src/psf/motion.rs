//! PSFs of exposures during which the light moves over the frame.

use ndarray::{Array2, ArrayView2};
use psf_types::StampGrid;
use psf_types::maths::gauss_legendre;
use rustfft::num_complex::Complex64;

use super::Psf;
use super::resample::native_picks;
use crate::error::{ErrorKind, PsfieldError};
use crate::stamp_plane::{Line, StampPlane, margin_of, widened};

/// The motion of light over the frame during an exposure: by how far it is shifted, and for which
/// part of the time. It is the density `p(d)` of the shift `d`, in frame pixels.
///
/// ```
/// use psfield::Motion;
/// // A steady drift by 2 pixels along x, with jitter.
/// let motion = Motion::along_line([0.0, 0.0], [2.0, 0.0])?.with_jitter_px(0.1)?;
/// assert!((motion.mean()[0] - 1.0).abs() < 1e-12);
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Motions at constant speed, each during a part of the exposure, in frame pixels. The weights' sum is 1.
    lines: Vec<Line>,
    jitter_px: f64,
}

/// Nodes and weights for a part of a line.
pub(crate) const QUADRATURE: [(f64, f64); 5] = gauss_legendre();

/// The longest motion in a straight line, in frame pixels.
const LONGEST: f64 = 1e5;

/// The longest part of a line, in frame pixels, for one quadrature. Its error is about 3e-9 of the peak
/// for a Gaussian PSF of 0.4 pixels r.m.s., and less for wider ones.
const LONGEST_PART: f64 = 0.5;
/// A line of at most this length, in frame pixels, has its middle as its only point. The error is about
/// 1e-6 of the peak for a Gaussian PSF of 0.4 pixels r.m.s., and less for wider ones.
const SHORTEST_LINE: f64 = 2e-3;
/// Motions whose shifts differ by at most this distance, in frame pixels, are equal.
const EQUAL: f64 = 1e-9;
/// Standard deviations of the jitter for which there is room around the stamps.
const DEVIATIONS: f64 = 6.0;

impl Motion {
    /// No motion: all light is shifted by the same distance (x, y).
    pub fn fixed(shift: [f64; 2]) -> Self {
        Self::of_line(shift, [0.0, 0.0])
    }

    fn of_line(middle: [f64; 2], length: [f64; 2]) -> Self {
        let line = Line {
            weight: 1.0,
            middle,
            length,
        };
        Self {
            lines: vec![line],
            jitter_px: 0.0,
        }
    }

    /// Motion along a straight line at constant speed.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for a line of more than 100 000 pixels, or an end that is not finite.
    pub fn along_line(from: [f64; 2], to: [f64; 2]) -> Result<Self, PsfieldError> {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let length = dx.hypot(dy);
        if !(length <= LONGEST && from.iter().all(|v| v.is_finite())) {
            let message = format!(
                "light moves by {length:.3e} pixels in one exposure, more than {LONGEST:.0e}: check the units, pixels and seconds"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        Ok(Self::of_line([from[0] + 0.5 * dx, from[1] + 0.5 * dy], [dx, dy]))
    }

    /// One motion after another, each with its part of the time. The parts are scaled to the sum 1. All
    /// have the same jitter.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for a shift that is not finite, a negative part, motions with different
    /// jitter, or no motion.
    pub fn sequence(motions: impl IntoIterator<Item = (f64, Self)>) -> Result<Self, PsfieldError> {
        let mut lines = Vec::new();
        let mut jitter = None;
        for (part, motion) in motions {
            if *jitter.get_or_insert(motion.jitter_px) != motion.jitter_px {
                const DIFFERS: &str = "motions in a sequence must have the same jitter";
                return Err(PsfieldError::new(ErrorKind::Data, DIFFERS));
            }
            lines.extend(motion.lines.into_iter().map(|line| Line {
                weight: line.weight * part,
                ..line
            }));
        }
        let sum: f64 = lines.iter().map(|line| line.weight).sum();
        let sound = |line: &Line| line.weight >= 0.0 && line.middle.iter().all(|v| v.is_finite());
        if !(sum > 0.0 && sum.is_finite() && lines.iter().all(sound)) {
            const MESSAGE: &str =
                "a motion needs finite shifts, and parts of the time that are 0 or more, not all 0";
            return Err(PsfieldError::new(ErrorKind::Data, MESSAGE));
        }
        for line in &mut lines {
            line.weight /= sum;
        }
        let jitter_px = jitter.unwrap_or(0.0);
        Ok(Self { lines, jitter_px })
    }

    /// Adds fast random motion, normally distributed, with this r.m.s. along each axis in frame pixels.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a value that is not finite or below 0.
    pub fn with_jitter_px(self, jitter_px: f64) -> Result<Self, PsfieldError> {
        if !(jitter_px >= 0.0 && jitter_px.is_finite()) {
            let message = format!("the jitter must be a finite number of pixels, 0 or more, not {jitter_px}");
            return Err(PsfieldError::of_setting("jitter_px", message));
        }
        Ok(Self { jitter_px, ..self })
    }

    /// The mean shift along x and y.
    pub fn mean(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            self.lines
                .iter()
                .map(|line| line.weight * line.middle[axis])
                .sum()
        })
    }

    /// The weights and the shifts (x, y) of points that stand for the motion, without jitter.
    pub fn points(&self) -> Vec<(f64, [f64; 2])> {
        self.lines.iter().flat_map(points_of).collect()
    }

    /// This motion, shifted by `-origin`.
    #[must_use]
    pub fn about(&self, origin: [f64; 2]) -> Self {
        let moved = |line: &Line| Line {
            middle: [0, 1].map(|axis| line.middle[axis] - origin[axis]),
            ..*line
        };
        Self {
            lines: self.lines.iter().map(moved).collect(),
            jitter_px: self.jitter_px,
        }
    }

    /// Returns whether two motions agree to 1e-9 pixel.
    pub(crate) fn equals(&self, other: &Self) -> bool {
        let close = |a: [f64; 2], b: [f64; 2]| (0..2).all(|axis| (a[axis] - b[axis]).abs() <= EQUAL);
        let same = |(a, b): (&Line, &Line)| {
            (a.weight - b.weight).abs() <= EQUAL && close(a.middle, b.middle) && close(a.length, b.length)
        };
        self.jitter_px == other.jitter_px
            && self.lines.len() == other.lines.len()
            && self.lines.iter().zip(&other.lines).all(same)
    }

    /// The distance along x and y up to which light moves, in frame pixels.
    pub(super) fn reach(&self) -> [f64; 2] {
        [0, 1].map(|axis| {
            let ends = |line: &Line| line.middle[axis].abs() + 0.5 * line.length[axis].abs();
            self.lines.iter().map(ends).fold(0.0, f64::max) + DEVIATIONS * self.jitter_px
        })
    }

    /// Returns whether this motion leaves PSFs as they are.
    pub(crate) fn is_none(&self) -> bool {
        let small = |v: f64| v.abs() <= EQUAL;
        let at_rest = |line: &Line| line.middle.iter().chain(&line.length).all(|&v| small(v));
        self.jitter_px == 0.0 && self.lines.iter().all(at_rest)
    }
}

/// The weights and the shifts of points that stand for the line.
fn points_of(line: &Line) -> impl Iterator<Item = (f64, [f64; 2])> {
    let Line {
        weight,
        middle,
        length,
    } = *line;
    let distance = length[0].hypot(length[1]);
    // Equal lengths get equally many parts, whatever their rounding.
    let parts = (distance / LONGEST_PART - EQUAL).ceil().max(1.0) as usize;
    let width = 1.0 / parts as f64;
    let at = move |part: f64| [0, 1].map(|axis| middle[axis] + (part - 0.5) * length[axis]);
    let quadrature = (0..parts).flat_map(move |part| {
        QUADRATURE.map(|(node, w)| (weight * w * width, at((part as f64 + node) * width)))
    });
    let short = distance <= SHORTEST_LINE;
    let only = short.then_some((weight, middle));
    only.into_iter().chain(quadrature.filter(move |_| !short))
}

impl Psf {
    /// The PSF of an exposure during which all light moves: `h'(u; x) = int p(d) h(u - d; x) dd`, with
    /// the density `p` of the [`Motion`]. The PSF at a position of the result is that of light whose
    /// unmoved image is at this position.
    ///
    /// Stamps are shifted in Fourier space and get wider. They should be well sampled: two or more
    /// pixels per frame pixel, better four.
    ///
    /// ```
    /// use psfield::{Motion, Psf};
    /// use ndarray::Array3;
    /// let stamps = Array3::from_shape_fn((1, 33, 33), |(_, y, x)| {
    ///     (-((y as f64 - 16.0).powi(2) + (x as f64 - 16.0).powi(2)) / 18.0).exp()
    /// });
    /// let psf = Psf::from_samples(stamps.view(), &[(0.0, 0.0)])?;
    /// // A Gaussian of sigma 3, with a jitter of 4 pixels, is a Gaussian of sigma 5.
    /// let moved = psf.moved(&Motion::fixed([0.0, 0.0]).with_jitter_px(4.0)?)?;
    /// let stamp = moved.model()?.psf_at(psfield::psf_types::Position::of_pixel(0, 0))?;
    /// let (nx, centre) = (stamp.grid().nx(), stamp.grid().nx() / 2);
    /// let ratio = stamp.values()[(centre, centre + 5)] / stamp.values()[(centre, centre)];
    /// assert!(nx > 33 && (ratio - (-0.5f64).exp()).abs() < 1e-6);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`native`](Self::native).
    pub fn moved(&self, motion: &Motion) -> Result<Self, PsfieldError> {
        if motion.is_none() {
            return Ok(self.clone());
        }
        self.moved_in(&Moving::new(self.grid(), motion.reach())?, motion)
    }

    /// Moves the light. The motion must fit into the room.
    pub(super) fn moved_in(&self, room: &Moving, motion: &Motion) -> Result<Self, PsfieldError> {
        let (plane, factor) = (&room.plane, room.factor(motion, [0.0, 0.0]));
        let moved = |stamp: ArrayView2<'_, f64>| {
            let [moved, _] = plane.inverse(plane.forward(&[stamp], room.margin) * &factor);
            moved
        };
        self.changed(room.target, moved)
    }
}

/// Room for moved stamps.
#[derive(Debug)]
pub(super) struct Moving {
    pub(super) plane: StampPlane,
    pub(super) oversampling: f64,
    /// Along x and y.
    pub(super) margin: [usize; 2],
    pub(super) target: StampGrid,
}

impl Moving {
    /// Room for light that moves by at most this distance along x and y, in frame pixels. Along an axis
    /// with no motion, stamps get no wider.
    pub(super) fn new(grid: StampGrid, reach: [f64; 2]) -> Result<Self, PsfieldError> {
        let oversampling = grid.oversampling();
        let margin = reach.map(|reach| {
            if reach <= EQUAL {
                0
            } else {
                margin_of(std::iter::once(reach * oversampling))
            }
        });
        let target = widened(grid, margin)?;
        let step = if native_picks(grid) {
            oversampling as usize
        } else {
            1
        };
        Ok(Self {
            plane: StampPlane::new(target.dim(), step),
            oversampling,
            margin,
            target,
        })
    }

    /// The factor of a motion in Fourier space. The moved stamps are shifted by `offset` stamp pixels
    /// more.
    pub(super) fn factor(&self, motion: &Motion, offset: [f64; 2]) -> Array2<Complex64> {
        let s = self.oversampling;
        let scaled = |line: &Line| Line {
            weight: line.weight,
            middle: [0, 1].map(|axis| line.middle[axis] * s + offset[axis]),
            length: line.length.map(|length| length * s),
        };
        let lines: Vec<_> = motion.lines.iter().map(scaled).collect();
        let jitter = self.plane.gaussian_factor(motion.jitter_px * s);
        self.plane.shift_factor(&lines) * jitter.mapv(Complex64::from)
    }
}
