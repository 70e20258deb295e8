//! The sub-pixel phases of stars: the positions of a star's pixels relative to the pixels of its
//! stamp. The oversampling of the stamp is a whole number, so all pixels of a star have one phase.

use std::ops::{Range, RangeInclusive};

use psf_types::{PixelRegion, PointSource, Position, StampGrid};

use crate::overlap::shared;
use crate::stamp_interpolator::{Kernel, MOST_TAPS};
use crate::{ConvError, ConvReal};

/// A coordinate at most this far from a pixel of the stamp counts as on that pixel: the difference
/// is rounding.
const ON_PIXEL: f64 = 1e-9;

/// One axis of a stamp `s` times finer than the frame. Its interpolation coefficients are stored by
/// residue modulo `s`: coefficient `p = s q + r` at `[r][q]`. They include the coefficients that
/// the interpolation kernel needs beyond the ends of the axis. A star uses the same residues in
/// every pixel of the frame, and neighbouring pixels use neighbouring `q`.
#[derive(Debug, Clone, Copy)]
pub(super) struct PhasedAxis {
    pub(super) kernel: Kernel,
    length: usize,
    centre: f64,
    pub(super) oversampling: usize,
    /// The pixels that a star may light, relative to its own pixel (the pixel that it lies on).
    window: (i64, i64),
    /// The position in the stamp of the first coefficient kept. Coefficients that no star can use
    /// are not kept. The first coefficient that a star uses is then at index `s` at most. So the
    /// values of every star's row begin at `q = 0`, where vectors start at cache lines.
    first: i64,
    /// The number of coefficients kept.
    pub(super) kept: usize,
}

/// A star's position on an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phase {
    /// The first coefficient that the star's own pixel uses, counted from the first coefficient
    /// kept.
    first: i64,
    /// The pixels `from..to` that the stamp reaches, relative to the star's own pixel.
    pub(super) from: i64,
    pub(super) to: i64,
    /// The weights of the coefficients that a pixel uses, equal for all pixels.
    pub(super) weights: [f64; MOST_TAPS],
}

impl PhasedAxis {
    /// The columns and the rows of a grid, for stars that light only the pixels of a window, which
    /// is relative to the star's own pixel. `None` if the oversampling is not a whole number of at
    /// most 65535.
    pub(super) fn both(grid: StampGrid, kernel: Kernel, window: PixelRegion) -> Option<[Self; 2]> {
        let s = grid.oversampling();
        if s.fract() != 0.0 || s > f64::from(u16::MAX) {
            return None;
        }
        let axis = |length: usize, centre: f64, from: i64, count: usize| {
            let window = (from, from + count as i64);
            let domain = kernel.domain(length);
            let reached = |pixel: i64, side: f64| centre + s * (pixel as f64 + side);
            let first = reached(window.0, -0.5).max(*domain.start()).floor() as i64;
            let last = reached(window.1 - 1, 0.5).min(*domain.end()).ceil() as i64;
            Self {
                kernel,
                length,
                centre,
                oversampling: s as usize,
                window,
                first: first + kernel.first_tap(),
                kept: (last - first).max(0) as usize + kernel.tap_count(),
            }
        };
        Some([
            axis(grid.nx(), grid.centre_x(), window.x0(), window.shape().nx()),
            axis(grid.ny(), grid.centre_y(), window.y0(), window.shape().ny()),
        ])
    }

    /// The pixels that a star may light: the first, relative to the star's own pixel, and their number.
    pub(super) fn window(&self) -> (i64, usize) {
        (self.window.0, (self.window.1 - self.window.0) as usize)
    }

    /// The index in the stamp of a coefficient. `kept` is its number, counted from the first
    /// coefficient kept. `None` if the coefficient is zero.
    pub(super) fn index(&self, kept: usize) -> Option<usize> {
        self.kernel.index(kept as i64 + self.first, self.length)
    }

    /// The coefficients that a pixel may use, at any phase. `pixel` is relative to the star's own pixel.
    pub(super) fn coefficients_of(&self, pixel: i64) -> Range<usize> {
        let half = self.oversampling as f64 / 2.0 + ON_PIXEL;
        let shift = pixel * self.oversampling as i64;
        let first = self.first_of(self.centre - half) + shift;
        let end = self.first_of(self.centre + half) + shift + self.kernel.tap_count() as i64;
        let within = |at: i64| at.clamp(0, self.kept as i64) as usize;
        within(first)..within(end)
    }

    /// The pixel, relative to the star's own pixel, in which a coefficient lies if the star is at the centre of
    /// its pixel. `kept` is the coefficient's number, counted from the first coefficient kept.
    pub(super) fn pixel_of(&self, kept: usize) -> i64 {
        let from_centre = (kept as i64 + self.first) as f64 - self.centre;
        (from_centre / self.oversampling as f64 + 0.5).floor() as i64
    }

    /// The coordinate in the stamp of the centre of a star's own pixel.
    fn at(&self, shift: f64) -> f64 {
        let at = self.centre - self.oversampling as f64 * shift;
        if (at - at.round()).abs() < ON_PIXEL {
            at.round()
        } else {
            at
        }
    }

    fn first_of(&self, at: f64) -> i64 {
        at.floor() as i64 + self.kernel.first_tap() - self.first
    }

    /// The range of `q` over all stars and taps: the first tap of a star's own pixel is coefficient
    /// `s q + r`, with a residue `r` from 0 to `s - 1`.
    pub(super) fn steps(&self) -> RangeInclusive<i64> {
        let half = self.oversampling as f64 / 2.0;
        let first = |at: f64| (self.first_of(at) as f64 / self.oversampling as f64).floor() as i64;
        let more = (self.kernel.tap_count() - 1).div_ceil(self.oversampling) as i64;
        // The ends are rounded outwards, because positions are rounded.
        first(self.centre - half - ON_PIXEL)..=first(self.centre + half + ON_PIXEL) + more
    }

    /// The phase of a star `shift` frame pixels from the centre of its pixel. `None` if the stamp
    /// reaches no pixel of the window.
    pub(super) fn phase(&self, shift: f64) -> Option<Phase> {
        let (from, to) = self.window;
        let (s, at) = (self.oversampling as f64, self.at(shift));
        let domain = self.kernel.domain(self.length);
        let from = from.max(((domain.start() - at) / s).ceil() as i64);
        let to = to.min(((domain.end() - at) / s).floor() as i64 + 1);
        (from < to).then(|| Phase {
            first: self.first_of(at),
            from,
            to,
            weights: self.kernel.weights(at - at.floor()),
        })
    }

    /// The derivatives of the weights of a [`Phase`] with respect to the star's position in frame pixels.
    pub(super) fn slopes(&self, shift: f64) -> [f64; MOST_TAPS] {
        let (s, at) = (self.oversampling as f64, self.at(shift));
        self.kernel.slopes(at - at.floor()).map(|slope| -s * slope)
    }
}

impl Phase {
    /// The first coefficient that a pixel uses, counted from the first coefficient kept. `pixel` is
    /// relative to the star's own pixel.
    pub(super) fn first_of(&self, pixel: i64, oversampling: usize) -> usize {
        (self.first + pixel * oversampling as i64) as usize
    }
}

/// A star's position and flux.
#[derive(Debug, Clone, Copy)]
pub(super) struct Star {
    /// The pixel that it lies on, counted from the frame's first pixel.
    pub(super) pixel: (i64, i64),
    /// Its offset from the centre of that pixel, in pixels.
    pub(super) shift: (f64, f64),
    /// Its field position.
    pub(super) position: (f64, f64),
    pub(super) flux: f64,
}

/// A star with its phases and the coefficients of its kernels.
#[derive(Debug, Clone)]
pub(super) struct PhasedStar<T> {
    /// Its own pixel.
    pub(super) pixel: (i64, i64),
    /// The number of its level in the [`Reach`](super::reach::Reach) of its block. `None` if it is drawn on all
    /// pixels that it lights.
    pub(super) level: Option<usize>,
    /// The pixels that it lights.
    pub(super) columns: Range<i64>,
    pub(super) rows: Range<i64>,
    /// The first row of coefficients that its first pixel uses.
    pub(super) first_row: usize,
    /// The first column of coefficients that its first pixel uses.
    pub(super) first_column: usize,
    /// The range of its weights in the list of its group, `[row, kernel]`: the weight of each row
    /// of coefficients times the coefficient of each kernel times the star's flux.
    pub(super) weights: Range<usize>,
    /// The weights of the columns of coefficients that contribute to a pixel.
    pub(super) taps: [T; MOST_TAPS],
}

impl Star {
    pub(super) fn new(source: &PointSource, frame: PixelRegion) -> Self {
        // Field positions count from the frame's first pixel.
        let x = source.position().x() - frame.x0() as f64;
        let y = source.position().y() - frame.y0() as f64;
        let pixel = ((x + 0.5).floor() as i64, (y + 0.5).floor() as i64);
        Self {
            pixel,
            shift: (x - pixel.0 as f64, y - pixel.1 as f64),
            position: (x, y),
            flux: source.flux(),
        }
    }

    /// Its field position, if it is finite.
    pub(super) fn field_position(&self) -> Result<Position, ConvError> {
        Position::new(self.position.0, self.position.1).map_err(ConvError::Result)
    }

    /// The pixels of the frame that the star may light. `window` is relative to the star's pixel.
    pub(super) fn lit(&self, window: PixelRegion) -> PixelRegion {
        let (column, row) = self.pixel;
        let (x0, y0) = (
            column.saturating_add(window.x0()),
            row.saturating_add(window.y0()),
        );
        PixelRegion::new(x0, y0, window.shape())
    }

    /// Returns whether the star may light a pixel of a region of the frame.
    pub(super) fn reaches(&self, window: PixelRegion, region: PixelRegion) -> bool {
        self.flux != 0.0 && shared(self.lit(window), region).is_some()
    }

    /// The numbers of the first coefficients that the star's own pixel uses: in y (rows), then in x
    /// (columns). Stars with equal numbers use the same coefficients.
    pub(super) fn phase_numbers(&self, [columns, rows]: &[PhasedAxis; 2]) -> (i64, i64) {
        let number = |axis: &PhasedAxis, shift: f64| axis.first_of(axis.at(shift));
        (number(rows, self.shift.1), number(columns, self.shift.0))
    }

    /// The star with its phases and with its weights, which are a range of the list of its group.
    pub(super) fn phased<T: ConvReal>(
        &self,
        ([columns, rows], oversampling): ([Phase; 2], usize),
        level: Option<usize>,
        weights: Range<usize>,
    ) -> PhasedStar<T> {
        let (column, row) = self.pixel;
        PhasedStar {
            pixel: self.pixel,
            level,
            columns: column + columns.from..column + columns.to,
            rows: row + rows.from..row + rows.to,
            first_row: rows.first_of(rows.from, oversampling),
            first_column: columns.first_of(columns.from, oversampling),
            weights,
            taps: columns.weights.map(T::nearest),
        }
    }

    /// The star's phases: in x (columns), then in y (rows). `None` if the star lights no pixel.
    pub(super) fn phases(&self, [columns, rows]: &[PhasedAxis; 2]) -> Option<[Phase; 2]> {
        Some([columns.phase(self.shift.0)?, rows.phase(self.shift.1)?])
    }
}
