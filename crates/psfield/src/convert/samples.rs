//! A PSF as samples.

use psf_types::{Normalisation, Position, PsfSamples};

use crate::{EvaluateOptions, PsfInput, PsfieldError, check_stack, evaluate};

/// Where a PSF is evaluated.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum SamplesAt {
    /// At its own samples, or at the nodes of its model.
    #[default]
    Own,
    /// On a regular grid over the field where that is known, else over the area that its own samples cover.
    Grid {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// At these positions.
    Positions(Vec<Position>),
}

/// The PSFs of samples or a model, at their own sampling: samples at their own positions as they are (scaled to unit flux
/// where their options say so), everything else through the model.
///
/// # Errors
/// [`PsfieldError::NoExtent`] for a grid over a PSF that is known at a single position, and those of the fit and of
/// [`evaluate`].
pub fn to_samples(input: PsfInput, at: &SamplesAt) -> Result<PsfSamples, PsfieldError> {
    let positions = match at {
        SamplesAt::Own => match input {
            PsfInput::Samples(samples, options) => {
                return Ok(match options.normalisation {
                    Normalisation::Keep => samples,
                    _ => samples.into_unit_flux(),
                });
            }
            PsfInput::Model(ref record) => record.coefficients().positions().as_slice().to_vec(),
        },
        SamplesAt::Grid { nx, ny } => grid_positions(&input, *nx, *ny)?,
        SamplesAt::Positions(positions) => positions.clone(),
    };
    evaluate(&input.into_model()?, positions, EvaluateOptions::default())
}

/// A regular grid over the field, from the centre of its first pixel to that of its last, or over the samples; x fastest.
fn grid_positions(input: &PsfInput, nx: usize, ny: usize) -> Result<Vec<Position>, PsfieldError> {
    // Before the positions themselves fill the memory.
    check_stack(nx.saturating_mul(ny), input.grid())?;
    let known = input.positions();
    let [x, y] = match known.field() {
        Some(field) => [(0.0, (field.nx() - 1) as f64), (0.0, (field.ny() - 1) as f64)],
        None => bounds(known.as_slice()),
    };
    if (nx > 1 && x.0 == x.1) || (ny > 1 && y.0 == y.1) {
        return Err(PsfieldError::NoExtent);
    }
    let (columns, rows) = (evenly(x, nx), evenly(y, ny));
    rows.iter()
        .flat_map(|&y| columns.iter().map(move |&x| Ok(Position::new(x, y)?)))
        .collect()
}

/// The smallest and the largest coordinate, of x and of y.
pub(super) fn bounds(positions: &[Position]) -> [(f64, f64); 2] {
    [Position::x, Position::y].map(|of: fn(Position) -> f64| {
        positions
            .iter()
            .map(|&p| of(p))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            })
    })
}

/// `count` numbers from `low` to `high`, both included; one is the middle.
fn evenly((low, high): (f64, f64), count: usize) -> Vec<f64> {
    match count {
        1 => vec![f64::midpoint(low, high)],
        _ => (0..count)
            .map(|i| low + (high - low) * i as f64 / (count - 1) as f64)
            .collect(),
    }
}
