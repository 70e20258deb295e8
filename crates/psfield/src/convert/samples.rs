//! Converts a PSF to samples, and pads stamps so that their centre is in the middle.

use ndarray::{Array3, ArrayView2, Zip, s};
use psf_types::{Normalisation, Position, PsfSamples};

use crate::error::{ErrorKind, PsfieldError};
use crate::evaluate::EvaluateOptions;
use crate::psf::Psf;
use crate::stack_size::check_stack;

/// Chooses the positions at which a PSF is evaluated.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum SamplesAt {
    /// At its own samples, or at the nodes of its model.
    #[default]
    Own,
    /// On a regular grid over the field. If the field is not known, over the area that the PSF's
    /// own samples cover.
    Grid {
        /// Number of columns.
        nx: usize,
        /// Number of rows.
        ny: usize,
    },
    /// At these positions.
    Positions(Vec<Position>),
}

/// Converts a PSF to samples whose stamps have the PSF's own sampling. With [`SamplesAt::Own`],
/// samples are returned unchanged, except for a scaling to unit flux if their options ask for it.
/// In all other cases the model is evaluated.
///
/// # Errors
/// [`ErrorKind::Format`] for a grid over a PSF that is known only at one position or along a line,
/// and the errors of the fit and of [`Psf::evaluate`].
pub fn to_samples(psf: &Psf, at: &SamplesAt) -> Result<PsfSamples, PsfieldError> {
    let positions = match (at, psf.samples()) {
        (SamplesAt::Own, Some((samples, options))) => {
            return Ok(match options.normalisation {
                Normalisation::Keep => samples.clone(),
                _ => samples.clone().into_unit_flux(),
            });
        }
        (SamplesAt::Own, None) => psf.positions().as_slice().to_vec(),
        (SamplesAt::Grid { nx, ny }, _) => grid_positions(psf, *nx, *ny)?,
        (SamplesAt::Positions(positions), _) => positions.clone(),
    };
    psf.evaluate(positions, EvaluateOptions::default())
}

/// Returns a regular grid over the field, from the centre of the first pixel to the centre of the
/// last. If the field is not known, the grid covers the area of the samples. x changes fastest.
fn grid_positions(psf: &Psf, nx: usize, ny: usize) -> Result<Vec<Position>, PsfieldError> {
    // Check the size of the stack of stamps now: for a huge grid, the positions alone would fill
    // the memory.
    check_stack(nx.saturating_mul(ny), psf.whole_grid())?;
    let known = psf.positions();
    let [x, y] = match known.field() {
        Some(field) => [(0.0, (field.nx() - 1) as f64), (0.0, (field.ny() - 1) as f64)],
        None => Position::bounds(known.as_slice()),
    };
    if (nx > 1 && x.0 == x.1) || (ny > 1 && y.0 == y.1) {
        const NO_AREA: &str = "a grid of positions needs an area, but the PSF is known only along a line or at one \
                               position, and no larger field is stated: give positions";
        return Err(PsfieldError::new(ErrorKind::Format, NO_AREA));
    }
    let (columns, rows) = (evenly(x, nx), evenly(y, ny));
    rows.iter()
        .flat_map(|&y| columns.iter().map(move |&x| Ok(Position::new(x, y)?)))
        .collect()
}

/// Returns `count` evenly spaced numbers from `low` to `high`, both included. A single number is
/// the middle.
fn evenly((low, high): (f64, f64), count: usize) -> Vec<f64> {
    match count {
        1 => vec![f64::midpoint(low, high)],
        _ => (0..count)
            .map(|i| low + (high - low) * i as f64 / (count - 1) as f64)
            .collect(),
    }
}

/// The relative L2 error of a stamp.
pub(super) fn relative_error(stamp: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> f64 {
    let (mut rest, mut whole) = (0.0, 0.0);
    Zip::from(stamp).and(truth).for_each(|a, b| {
        rest += (a - b) * (a - b);
        whole += b * b;
    });
    (rest / whole).sqrt()
}

/// Pads stamps with zeros to an odd size, so that the centre is the middle pixel. The two
/// conventions for the centre, `n / 2` and `(n - 1) / 2`, then mean the same pixel.
///
/// # Errors
/// [`ErrorKind::Format`] if the centre lies between pixels.
pub(super) fn with_centre_in_the_middle(
    samples: PsfSamples,
    format: &str,
) -> Result<PsfSamples, PsfieldError> {
    let grid = samples.grid();
    let Some((cx, cy)) = grid.whole_centre() else {
        let message = format!(
            "{format} cannot hold these stamps, because their centre lies between pixels: evaluate the PSF on the native grid first"
        );
        return Err(PsfieldError::new(ErrorKind::Format, message));
    };
    let reach = |centre: usize, n: usize| centre.max(n - 1 - centre);
    let (rx, ry) = (reach(cx, grid.nx()), reach(cy, grid.ny()));
    let wide = grid.with_size(2 * rx + 1, 2 * ry + 1)?;
    if wide == grid {
        return Ok(samples);
    }
    let mut stamps = Array3::zeros((samples.len(), wide.ny(), wide.nx()));
    let (x0, y0) = (rx - cx, ry - cy);
    stamps
        .slice_mut(s![.., y0..y0 + grid.ny(), x0..x0 + grid.nx()])
        .assign(&samples.stamps());
    Ok(PsfSamples::new(stamps, samples.positions().clone(), wide)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::{SamplePositions, StampGrid};

    fn samples(grid: StampGrid) -> PsfSamples {
        let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
        let stamps = Array3::from_shape_fn((1, grid.ny(), grid.nx()), |(_, y, x)| (10 * y + x + 1) as f64);
        PsfSamples::new(stamps, positions, grid).unwrap()
    }

    #[test]
    fn the_centre_keeps_its_value_and_moves_to_the_middle() {
        for (nx, ny, cx, cy) in [(4, 5, 2, 2), (3, 3, 0, 2), (1, 1, 0, 0), (4, 4, 1, 2)] {
            let grid = StampGrid::new(nx, ny)
                .unwrap()
                .with_centre(f64::from(cx), f64::from(cy))
                .unwrap();
            let wide = with_centre_in_the_middle(samples(grid), "a file").unwrap();
            let (ny, nx) = wide.grid().dim();
            assert!(nx % 2 == 1 && ny % 2 == 1);
            assert_eq!(wide.stamps()[[0, ny / 2, nx / 2]], f64::from(10 * cy + cx + 1));
            assert_eq!(wide.stamps().sum(), samples(grid).stamps().sum());
            assert_eq!(wide.grid().whole_centre(), Some((nx / 2, ny / 2)));
        }
        let between = StampGrid::new(4, 4).unwrap().with_centre(1.5, 1.5).unwrap();
        let error = with_centre_in_the_middle(samples(between), "a file").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Format);
        assert!(
            error
                .to_string()
                .starts_with("a file cannot hold these stamps, because")
        );
    }
}
