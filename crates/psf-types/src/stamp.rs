//! Stamps: PSF images on a small grid.

use ndarray::{Array2, ArrayView2};
use serde::{Deserialize, Serialize};

use crate::choices::StampInterpolation;
use crate::frame::{DataError, Quantity, read_through_new};
use crate::image::row_major;

/// The pixel grid of a stamp: shape, centre, oversampling and interpolation between the pixels. It
/// also records whether the values include the pixel response.
///
/// * A stamp value at index `(row, column)` belongs to the offset
///   `((column - centre_x) / oversampling, (row - centre_y) / oversampling)` in frame pixels from
///   the source.
/// * If the pixel response is included, a value is the fraction of the source's flux that falls in
///   a *frame* pixel centred at this offset. Otherwise a value is a density at this offset: the
///   fraction of the source's flux per frame pixel. In both cases a stamp oversampled `s` times
///   holds unit flux when its values sum to `s^2`.
///
/// ```
/// use psf_types::StampGrid;
/// let grid = StampGrid::new(64, 64)?.with_oversampling(4.0)?;
/// assert_eq!((grid.centre_x(), grid.centre_y()), (32.0, 32.0));
/// assert_eq!(grid.flux_of_sum(16.0), 1.0);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawStampGrid")]
pub struct StampGrid {
    nx: usize,
    ny: usize,
    centre_x: f64,
    centre_y: f64,
    oversampling: f64,
    pixel_response_included: bool,
    interpolation: StampInterpolation,
}

#[derive(Deserialize)]
struct RawStampGrid {
    nx: usize,
    ny: usize,
    centre_x: f64,
    centre_y: f64,
    oversampling: f64,
    pixel_response_included: bool,
    #[serde(default)]
    interpolation: StampInterpolation,
}

impl StampGrid {
    /// A grid of `nx` columns and `ny` rows at the frame's own pixel scale, with the pixel response
    /// included. Its centre is index `(nx / 2, ny / 2)` (integer division).
    ///
    /// # Errors
    /// [`DataError::EmptyStamp`] when `nx` or `ny` is 0.
    pub fn new(nx: usize, ny: usize) -> Result<Self, DataError> {
        if nx == 0 || ny == 0 {
            return Err(DataError::EmptyStamp { nx, ny });
        }
        Ok(Self {
            nx,
            ny,
            centre_x: (nx / 2) as f64,
            centre_y: (ny / 2) as f64,
            oversampling: 1.0,
            pixel_response_included: true,
            interpolation: StampInterpolation::default(),
        })
    }

    /// Returns this grid with its centre at the 0-based stamp index (`x`, `y`), which may be
    /// fractional. The centre is the point of the stamp that lies at the source's position.
    ///
    /// # Errors
    /// [`DataError::StampCentre`] when (`x`, `y`) does not lie on a pixel of the stamp.
    pub fn with_centre(self, x: f64, y: f64) -> Result<Self, DataError> {
        let on = |v: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&v);
        if on(x, self.nx) && on(y, self.ny) {
            Ok(Self {
                centre_x: x,
                centre_y: y,
                ..self
            })
        } else {
            Err(DataError::StampCentre {
                x,
                y,
                nx: self.nx,
                ny: self.ny,
            })
        }
    }

    /// Returns this grid with `oversampling` stamp pixels per frame pixel along each axis.
    /// `oversampling` need not be an integer. It is below 1 for stamps coarser than the frame.
    ///
    /// # Errors
    /// [`DataError::Oversampling`] when `oversampling` is not finite and positive.
    pub fn with_oversampling(self, oversampling: f64) -> Result<Self, DataError> {
        if oversampling.is_finite() && oversampling > 0.0 {
            Ok(Self { oversampling, ..self })
        } else {
            Err(DataError::Oversampling { got: oversampling })
        }
    }

    /// Sets whether the stamp values include the response of a frame pixel.
    #[must_use]
    pub fn with_pixel_response_included(self, pixel_response_included: bool) -> Self {
        Self {
            pixel_response_included,
            ..self
        }
    }

    /// Returns this grid with another interpolation between the stamp's pixels.
    #[must_use]
    pub fn with_interpolation(self, interpolation: StampInterpolation) -> Self {
        Self {
            interpolation,
            ..self
        }
    }

    /// Returns this grid with `nx` columns and `ny` rows. Its centre is index `(nx / 2, ny / 2)`.
    ///
    /// # Errors
    /// [`DataError::EmptyStamp`] when `nx` or `ny` is 0.
    pub fn with_size(self, nx: usize, ny: usize) -> Result<Self, DataError> {
        let Self {
            centre_x, centre_y, ..
        } = Self::new(nx, ny)?;
        Ok(Self {
            nx,
            ny,
            centre_x,
            centre_y,
            ..self
        })
    }

    /// Returns this grid with `margins` more pixels on the left and on the right, and below and above. Its
    /// centre lies at the same place on the old pixels.
    ///
    /// # Errors
    /// [`DataError::StampCentre`] for margins so wide that `f64` cannot hold the centre.
    pub fn with_margins(self, [mx, my]: [usize; 2]) -> Result<Self, DataError> {
        let side = |count: usize, margin: usize| count.saturating_add(margin.saturating_mul(2));
        let (nx, ny) = (side(self.nx, mx), side(self.ny, my));
        let (x, y) = (self.centre_x + mx as f64, self.centre_y + my as f64);
        Self { nx, ny, ..self }.with_centre(x, y)
    }

    /// Number of columns.
    pub fn nx(self) -> usize {
        self.nx
    }

    /// Number of rows.
    pub fn ny(self) -> usize {
        self.ny
    }

    /// Column index of the centre.
    pub fn centre_x(self) -> f64 {
        self.centre_x
    }

    /// Row index of the centre.
    pub fn centre_y(self) -> f64 {
        self.centre_y
    }

    /// Stamp pixels per frame pixel.
    pub fn oversampling(self) -> f64 {
        self.oversampling
    }

    /// Returns whether the values include the response of a frame pixel.
    pub fn pixel_response_included(self) -> bool {
        self.pixel_response_included
    }

    /// The interpolation between the stamp's pixels.
    pub fn interpolation(self) -> StampInterpolation {
        self.interpolation
    }

    /// `[rows, columns]`, the shape of the arrays.
    pub fn dim(self) -> (usize, usize) {
        (self.ny, self.nx)
    }

    /// Number of stamp pixels, or `usize::MAX` if the number does not fit into `usize`.
    pub fn pixel_count(self) -> usize {
        self.nx.saturating_mul(self.ny)
    }

    /// Returns [`DataError::StampShape`] if `got` is not the shape of this grid's stamps.
    pub(crate) fn check_dim(self, got: (usize, usize)) -> Result<(), DataError> {
        if got == self.dim() {
            Ok(())
        } else {
            Err(DataError::StampShape {
                expected: self.dim(),
                got,
            })
        }
    }

    /// Returns the centre as integer indices `(column, row)` if it is the centre of a pixel.
    pub fn whole_centre(self) -> Option<(usize, usize)> {
        (self.centre_x.fract() == 0.0 && self.centre_y.fract() == 0.0)
            .then_some((self.centre_x as usize, self.centre_y as usize))
    }

    /// This grid with `half` pixels on each side of the pixel that the centre lies on.
    ///
    /// # Errors
    /// As for [`with_size`](Self::with_size).
    pub fn about_centre(self, half: usize) -> Result<Self, DataError> {
        let centre = |c: f64| half as f64 + c.fract();
        let sized = self.with_size(2 * half + 1, 2 * half + 1)?;
        sized.with_centre(centre(self.centre_x), centre(self.centre_y))
    }

    /// The column and the row of larger stamps at which these begin, with the centres of both on each other.
    /// None if the larger stamps have another sampling, or these do not lie within them on whole pixels.
    pub fn place_in(self, larger: Self) -> Option<(usize, usize)> {
        let same = larger.oversampling == self.oversampling
            && larger.pixel_response_included == self.pixel_response_included
            && larger.interpolation == self.interpolation;
        let first = |centre: f64, own: f64, room: usize, pixels: usize| {
            let first = centre - own;
            let fits = first >= 0.0 && first.fract() == 0.0 && first + pixels as f64 <= room as f64;
            fits.then_some(first as usize)
        };
        let column = first(larger.centre_x, self.centre_x, larger.nx, self.nx)?;
        let row = first(larger.centre_y, self.centre_y, larger.ny, self.ny)?;
        same.then_some((column, row))
    }

    /// The flux (fraction of the source's light) of a stamp whose values sum to `sum`:
    /// `sum / oversampling^2`.
    pub fn flux_of_sum(self, sum: f64) -> f64 {
        sum / (self.oversampling * self.oversampling)
    }
}

impl TryFrom<RawStampGrid> for StampGrid {
    type Error = DataError;
    fn try_from(raw: RawStampGrid) -> Result<Self, DataError> {
        Ok(Self::new(raw.nx, raw.ny)?
            .with_centre(raw.centre_x, raw.centre_y)?
            .with_oversampling(raw.oversampling)?
            .with_pixel_response_included(raw.pixel_response_included)
            .with_interpolation(raw.interpolation))
    }
}

/// One PSF image `[y, x]` on its [`StampGrid`]. Every value is finite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawStamp")]
pub struct Stamp {
    values: Array2<f64>,
    grid: StampGrid,
}

read_through_new!(RawStamp => Stamp { values: Array2<f64>, grid: StampGrid });

impl Stamp {
    /// A stamp from its values `[y, x]`.
    ///
    /// # Errors
    /// [`DataError::StampShape`] when the array does not have the grid's shape,
    /// [`DataError::NonFinite`] for a NaN or an infinity.
    pub fn new(values: Array2<f64>, grid: StampGrid) -> Result<Self, DataError> {
        grid.check_dim(values.dim())?;
        DataError::check_finite(Quantity::StampValue, values.view())?;
        Ok(Self {
            values: row_major(values),
            grid,
        })
    }

    /// The values `[y, x]`.
    pub fn values(&self) -> ArrayView2<'_, f64> {
        self.values.view()
    }

    /// The pixel grid.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// Returns the values without copying them.
    pub fn into_values(self) -> Array2<f64> {
        self.values
    }

    /// The fraction of the source's light in the stamp: the sum of the values divided by
    /// `oversampling^2`.
    pub fn flux(&self) -> f64 {
        self.grid.flux_of_sum(self.values.sum())
    }

    /// The stamp mirrored in both axes. Its centre is mirrored too (index 32 of 64 becomes 31).
    ///
    /// Convolution with the mirrored stamp is correlation with the stamp itself.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let grid = StampGrid {
            centre_x: (self.grid.nx - 1) as f64 - self.grid.centre_x,
            centre_y: (self.grid.ny - 1) as f64 - self.grid.centre_y,
            ..self.grid
        };
        Self {
            values: row_major(self.values.slice(ndarray::s![..;-1, ..;-1]).to_owned()),
            grid,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn mirroring_moves_the_centre_and_is_its_own_inverse() {
        let grid = StampGrid::new(4, 3).unwrap();
        let stamp = Stamp::new(Array2::from_shape_fn((3, 4), |(y, x)| (4 * y + x) as f64), grid).unwrap();
        let mirrored = stamp.mirrored();
        assert_eq!(
            (mirrored.grid().centre_x(), mirrored.grid().centre_y()),
            (1.0, 1.0)
        );
        assert_eq!(mirrored.values()[[1, 1]], stamp.values()[[1, 2]]);
        assert_eq!(mirrored.mirrored(), stamp);
    }

    #[test]
    fn bad_stamps_are_refused_also_through_serde() {
        let grid = StampGrid::new(2, 1).unwrap();
        assert!(matches!(
            Stamp::new(array![[1.0]], grid),
            Err(DataError::StampShape { .. })
        ));
        assert!(matches!(
            Stamp::new(array![[1.0, f64::NAN]], grid),
            Err(DataError::NonFinite { .. })
        ));
        let good = serde_json::to_string(&Stamp::new(array![[1.0, 2.0]], grid).unwrap()).unwrap();
        assert!(serde_json::from_str::<Stamp>(&good).is_ok());
        assert!(
            serde_json::from_str::<Stamp>(&good.replace("\"oversampling\":1.0", "\"oversampling\":0.0"))
                .is_err()
        );
        assert!(serde_json::from_str::<Stamp>(&good.replace("\"nx\":2", "\"nx\":3")).is_err());
    }
}
