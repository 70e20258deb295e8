//! PSFEx models: the `.psf` files that PSFEx writes and SExtractor reads (E. Bertin 2011, ADASS XX,
//! 435).
//!
//! # Layout
//!
//! The primary HDU is empty. A binary table follows for each image extension that PSFEx has
//! modelled. Each table is usually named `PSF_DATA` and has one row:
//!
//! | in the table | meaning |
//! |---|---|
//! | column `PSF_MASK` | single-precision planes `[term, y, x]`, `TDIMn = (nx, ny, terms)` |
//! | `POLNAXIS` | 2, or 0 for a constant PSF (for other quantities, see below) |
//! | `POLNAME1`, `POLNAME2` | the coordinates in 1-based pixels of the frame: `X_IMAGE` and `Y_IMAGE`, or windowed ones (`XWIN_IMAGE` ...) |
//! | `POLZEROi`, `POLSCALi` | offset and scale of each coordinate |
//! | `POLNGRP`, `POLGRPi`, `POLDEG1` | one group of both coordinates, of total degree `POLDEG1` |
//! | `PSF_SAMP` | frame pixels per plane pixel: the stamps are oversampled `1 / PSF_SAMP` times |
//! | `PSFNAXIS`, `PSFAXIS1`, `PSFAXIS2`, `PSFAXIS3` | 3 axes: columns, rows, terms; for one term 2 axes are enough |
//! | `PSF_FWHM`, `LOADED`, `ACCEPTED`, `CHI2` | statistics of PSFEx, optional |
//!
//! The PSF at the position (x, y) is `h(u; x, y) = sum_t t(x, y) plane_t(u)`, where `u` is a pixel
//! of the planes. A term is `t = X^i Y^j` with `X = (x - POLZERO1) / POLSCAL1`, and `Y` likewise.
//! The order of the terms is `for j in 0..=d, for i in 0..=d - j`, so 1, X, X^2, Y, XY, Y^2 for
//! degree 2.
//!
//! # Conventions
//! The reference point of the PSF is the plane pixel `n / 2` (integer division), as in PSFEx.
//! (GalSim uses the middle of the plane, which differs by half a plane pixel for even `n`.
//! [`write_psfex`](crate::write_psfex) writes planes unchanged.) The values include the response of
//! a frame pixel and need not have unit flux. PSFEx's own tools interpolate between the pixels by a
//! Lanczos kernel, so the grid has
//! [`StampInterpolation::Lanczos3`](psf_types::StampInterpolation::Lanczos3). Positions are 1-based
//! in the file and 0-based in [`PsfexModel`].
//!
//! # Other quantities
//! A polynomial may depend on up to 10 quantities (*contexts*), in several groups. Of those other than the
//! position (a magnitude, a colour, a header keyword), the user chooses the values
//! ([`read_psfex_at`](crate::read_psfex_at)). A polynomial in one coordinate does not depend on the other.
//! `POLNAXIS` may be missing if the names are given, `PSFNAXIS` if `TDIMn` is given.
//!
//! # Tables of models
//! legacypipe writes the models of all CCDs of an exposure as rows of one table. The keywords above are its
//! columns (`polnaxis`, `polzero1`, ...), and `psf_mask` has the size of the largest model, filled up with
//! zeros.

mod contexts;
pub(crate) mod file;
mod rows;

use std::f64::consts::PI;

use ndarray::{Array2, Array3, ArrayView3};
use psf_types::{DataError, FrameShape, Position, Quantity, Stamp, StampGrid, StampInterpolation, maths};

/// The usual name of the table.
const EXTENSION: &str = "PSF_DATA";
/// The column that holds the planes.
const COLUMN: &str = "PSF_MASK";
/// The longest side of a frame in pixels. Longer sides come from damaged files.
const LONGEST_FRAME: f64 = 1e6;

/// One coordinate of a PSFEx polynomial: `t = (v - zero) / scale` with `v` in 0-based pixels of the
/// frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PsfexAxis {
    name: String,
    zero: f64,
    scale: f64,
}

impl PsfexAxis {
    /// Makes a coordinate from its name (such as `X_IMAGE`), offset (0-based pixels: `POLZERO`
    /// minus 1) and scale (pixels).
    ///
    /// # Errors
    /// [`DataError::Setting`] for an offset that is not finite, or a scale that is not finite or 0.
    pub fn new(name: &str, zero: f64, scale: f64) -> Result<Self, DataError> {
        if !zero.is_finite() {
            return Err(DataError::setting(
                "POLZERO of a PSFEx model",
                "a finite number",
                zero,
            ));
        }
        if !scale.is_finite() || scale == 0.0 {
            let allowed = "a finite number other than 0";
            return Err(DataError::setting("POLSCAL of a PSFEx model", allowed, scale));
        }
        let name = name.to_owned();
        Ok(Self { name, zero, scale })
    }

    /// The name of the coordinate, such as `X_IMAGE`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The offset in 0-based pixels.
    pub fn zero(&self) -> f64 {
        self.zero
    }

    /// The scale in pixels.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The extrema of the Chebyshev polynomial of this degree over `zero +- scale / 2`, including
    /// the ends. The values at these points determine any polynomial of this degree. For degree 0
    /// the only point is `zero`.
    pub fn extrema(&self, degree: usize) -> Vec<f64> {
        if degree == 0 {
            return vec![self.zero];
        }
        (0..=degree)
            .map(|i| self.zero - 0.5 * self.scale * (PI * i as f64 / degree as f64).cos())
            .collect()
    }

    /// The powers 0 to `degree` of the scaled coordinate.
    fn powers(&self, v: f64, degree: usize) -> Vec<f64> {
        let t = (v - self.zero) / self.scale;
        std::iter::successors(Some(1.0), |power| Some(power * t))
            .take(degree + 1)
            .collect()
    }
}

/// The polynomial of a PSFEx model: two coordinates and the total degree.
#[derive(Debug, Clone, PartialEq)]
pub struct PsfexPolynomial {
    x: PsfexAxis,
    y: PsfexAxis,
    degree: usize,
}

impl PsfexPolynomial {
    /// The highest degree that PSFEx and SExtractor support.
    pub const MAX_DEGREE: usize = 10;

    /// Makes a polynomial of total degree `degree` in x and y.
    ///
    /// # Errors
    /// [`DataError::Setting`] for a degree above [`Self::MAX_DEGREE`].
    pub fn new(x: PsfexAxis, y: PsfexAxis, degree: usize) -> Result<Self, DataError> {
        if degree > Self::MAX_DEGREE {
            return Err(DataError::setting(
                "the degree of a PSFEx model",
                "0 to 10",
                degree,
            ));
        }
        Ok(Self { x, y, degree })
    }

    /// The column coordinate.
    pub fn x(&self) -> &PsfexAxis {
        &self.x
    }

    /// The row coordinate.
    pub fn y(&self) -> &PsfexAxis {
        &self.y
    }

    /// The total degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The frame that fits the stars of the model, which lie at `zero +- scale / 2` along each axis.
    /// The frame begins at pixel (0, 0) and reaches as far beyond the last star as the first star is
    /// from the first pixel. None if no frame from pixel (0, 0) holds the stars.
    ///
    /// ```
    /// use psf_io::{PsfexAxis, PsfexPolynomial};
    /// let (x, y) = (PsfexAxis::new("X_IMAGE", 1023.5, 2003.1)?, PsfexAxis::new("Y_IMAGE", 2047.3, 4051.2)?);
    /// let shape = PsfexPolynomial::new(x, y, 2)?.frame_shape().expect("a frame");
    /// assert_eq!((shape.nx(), shape.ny()), (2048, 4096));
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    pub fn frame_shape(&self) -> Option<FrameShape> {
        let pixels = |axis: &PsfexAxis| {
            let last = (2.0 * axis.zero).max(axis.zero + 0.5 * axis.scale.abs());
            let pixels = last.round() + 1.0;
            (1.0..=LONGEST_FRAME).contains(&pixels).then_some(pixels as usize)
        };
        FrameShape::new(pixels(&self.x)?, pixels(&self.y)?).ok()
    }

    /// Number of terms for a total degree: `(d+1)(d+2)/2`.
    pub fn term_count(degree: usize) -> usize {
        maths::term_count(degree)
    }

    /// The terms at a position in the order of the planes, with the power of x fastest.
    ///
    /// ```
    /// use psf_io::{PsfexAxis, PsfexPolynomial};
    /// use psf_types::Position;
    /// let axis = |name| PsfexAxis::new(name, 10.0, 2.0);
    /// let polynomial = PsfexPolynomial::new(axis("X_IMAGE")?, axis("Y_IMAGE")?, 2)?;
    /// // X = 2, Y = 3: 1, X, X^2, Y, XY, Y^2.
    /// assert_eq!(polynomial.terms(Position::new(14.0, 16.0)?), [1.0, 2.0, 4.0, 3.0, 6.0, 9.0]);
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    pub fn terms(&self, position: Position) -> Vec<f64> {
        let [x, y] = [
            self.x.powers(position.x(), self.degree),
            self.y.powers(position.y(), self.degree),
        ];
        (0..=self.degree)
            .flat_map(|j| (0..=self.degree - j).map(move |i| (i, j)))
            .map(|(i, j)| x[i] * y[j])
            .collect()
    }
}

/// PSFEx's statistics of its fit. They are informative only.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct PsfexFigures {
    /// The full width at half maximum in frame pixels (`PSF_FWHM`).
    pub fwhm_px: Option<f64>,
    /// Number of stars that were tried (`LOADED`).
    pub loaded: Option<i64>,
    /// Number of stars that were used (`ACCEPTED`).
    pub accepted: Option<i64>,
    /// Reduced chi square of the fit (`CHI2`).
    pub chi2: Option<f64>,
}

/// A PSFEx model. The PSF is the sum of planes, weighted by the terms of a polynomial in the
/// position.
///
/// There are as many planes as terms, or one plane for a constant PSF. Every value is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct PsfexModel {
    planes: Array3<f64>,
    sampling: f64,
    polynomial: Option<PsfexPolynomial>,
    grid: StampGrid,
    figures: PsfexFigures,
}

impl PsfexModel {
    /// Makes a model from planes `[term, y, x]`, their sampling (`PSF_SAMP`: frame pixels per plane
    /// pixel) and the polynomial. Without a polynomial the PSF is constant.
    ///
    /// # Errors
    /// [`DataError::EmptyStamp`] for planes without pixels, [`DataError::CountMismatch`] if the
    /// number of planes is not the number of terms, [`DataError::NonFinite`] for a value that is
    /// not finite, and [`DataError::Oversampling`] for a sampling out of range.
    pub fn new(
        planes: Array3<f64>,
        sampling: f64,
        polynomial: Option<PsfexPolynomial>,
    ) -> Result<Self, DataError> {
        let (count, ny, nx) = planes.dim();
        let degree = polynomial.as_ref().map_or(0, PsfexPolynomial::degree);
        let expected = PsfexPolynomial::term_count(degree);
        let what = "planes of a PSFEx model, (d+1)(d+2)/2 for degree d";
        DataError::check_count(what, expected, count)?;
        let grid = StampGrid::new(nx, ny)?
            .with_oversampling(1.0 / sampling)?
            .with_interpolation(StampInterpolation::Lanczos3);
        DataError::check_finite(Quantity::BasisValue, planes.view())?;
        Ok(Self {
            planes: planes.as_standard_layout().into_owned(),
            sampling,
            polynomial,
            grid,
            figures: PsfexFigures::default(),
        })
    }

    /// Adds PSFEx's statistics.
    #[must_use]
    pub fn with_figures(self, figures: PsfexFigures) -> Self {
        Self { figures, ..self }
    }

    /// The planes `[term, y, x]`, row-major.
    pub fn planes(&self) -> ArrayView3<'_, f64> {
        self.planes.view()
    }

    /// Frame pixels per plane pixel.
    pub fn sampling(&self) -> f64 {
        self.sampling
    }

    /// The pixel grid of the planes: centre `n / 2`, oversampled `1 / sampling` times, with the
    /// pixel response.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// PSFEx's statistics.
    pub fn figures(&self) -> PsfexFigures {
        self.figures
    }

    /// The polynomial, or `None` for a constant PSF.
    pub fn polynomial(&self) -> Option<&PsfexPolynomial> {
        self.polynomial.as_ref()
    }

    /// The total degree, or 0 for a constant PSF.
    pub fn degree(&self) -> usize {
        self.polynomial.as_ref().map_or(0, PsfexPolynomial::degree)
    }

    /// Positions at which the values of the PSF determine the polynomial. They are all combinations
    /// of the [`extrema`](PsfexAxis::extrema) of x and of y, `(d+1)^2` for degree d, with x
    /// fastest. For a constant PSF, the list holds one arbitrary position.
    ///
    /// # Errors
    /// [`DataError::NonFinitePosition`] if offset and scale are too large for a position.
    pub fn nodes(&self) -> Result<Vec<Position>, DataError> {
        let Some(polynomial) = &self.polynomial else {
            return Ok(vec![Position::of_pixel(0, 0)]);
        };
        let [x, y] = [&polynomial.x, &polynomial.y].map(|axis| axis.extrema(polynomial.degree));
        y.iter()
            .flat_map(|&y| x.iter().map(move |&x| Position::new(x, y)))
            .collect()
    }

    /// The PSF at a position, as in PSFEx: not scaled to unit flux.
    ///
    /// # Errors
    /// [`DataError::NonFinite`] at a position so far away that the polynomial overflows.
    pub fn psf_at(&self, position: Position) -> Result<Stamp, DataError> {
        let terms = match &self.polynomial {
            Some(polynomial) => polynomial.terms(position),
            None => vec![1.0],
        };
        let mut values = Array2::zeros(self.grid.dim());
        for (term, plane) in terms.into_iter().zip(self.planes.outer_iter()) {
            values.scaled_add(term, &plane);
        }
        Stamp::new(values, self.grid)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    fn linear() -> PsfexPolynomial {
        let axis = |name, zero| PsfexAxis::new(name, zero, 4.0).unwrap();
        PsfexPolynomial::new(axis("X_IMAGE", 1.0), axis("Y_IMAGE", 2.0), 1).unwrap()
    }

    #[test]
    fn the_psf_is_the_weighted_sum_of_the_planes() {
        let planes = array![[[1.0, 2.0]], [[10.0, 0.0]], [[0.0, 100.0]]];
        let model = PsfexModel::new(planes, 0.5, Some(linear())).unwrap();
        // X = 1/2, Y = -1/4.
        let psf = model.psf_at(Position::new(3.0, 1.0).unwrap()).unwrap();
        assert_eq!(psf.values(), array![[6.0, -23.0]]);
        assert_eq!(psf.grid().oversampling(), 2.0);
        assert_eq!(psf.grid().interpolation(), StampInterpolation::Lanczos3);
        assert_eq!((psf.grid().centre_x(), psf.grid().centre_y()), (1.0, 0.0));
    }

    #[test]
    fn each_invariant_is_checked() {
        let make = |planes: Array3<f64>, sampling| PsfexModel::new(planes, sampling, Some(linear()));
        assert!(make(Array3::ones((3, 2, 2)), 0.5).is_ok());
        assert!(matches!(
            make(Array3::ones((2, 2, 2)), 0.5),
            Err(DataError::CountMismatch {
                expected: 3,
                got: 2,
                ..
            })
        ));
        assert!(matches!(
            make(Array3::ones((3, 0, 2)), 0.5),
            Err(DataError::EmptyStamp { .. })
        ));
        for sampling in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(make(Array3::ones((3, 2, 2)), sampling).is_err(), "{sampling}");
        }
        let mut planes = Array3::ones((3, 2, 2));
        planes[[2, 0, 1]] = f64::NAN;
        assert!(matches!(make(planes, 0.5), Err(DataError::NonFinite { index, .. }) if index == [2, 0, 1]));
        assert!(PsfexAxis::new("X_IMAGE", 0.0, 0.0).is_err());
        assert!(PsfexAxis::new("X_IMAGE", f64::NAN, 1.0).is_err());
        let PsfexPolynomial { x, y, .. } = linear();
        assert!(PsfexPolynomial::new(x, y, 11).is_err());
    }
}
