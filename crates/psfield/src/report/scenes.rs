//! Stars and galaxies over the frame, drawn and true.

use ndarray::Array2;
use psf_types::{FrameShape, Position, PsfModel, PsfSource, SersicProfile, SersicSource};
use rayon::prelude::*;

use super::extended_truth::{true_galaxy, true_psf};
use super::object_grid::{object_pixels, positions_of};
use super::transform_images::{Drawn, draw_by_transforms};
use super::{Evaluation, ObjectKind, ToleranceRow};
use crate::PsfieldError;

/// Half-light radius in pixels, Sersic index, axis ratio, angle in degrees.
pub(super) const GALAXY: [f64; 4] = [3.0, 1.0, 0.7, 30.0];
/// Pixels along each side of a galaxy's light; truth and scene hold the same light.
const GALAXY_SIDE: usize = 32;

/// Objects and what they truly look like.
#[derive(Debug)]
pub(super) struct Scenes {
    frame: FrameShape,
    columns: usize,
    pixels: Vec<(usize, usize)>,
    pub(super) positions: Vec<Position>,
    galaxy: Array2<f64>,
    pub(super) star_truth: Vec<Array2<f64>>,
    galaxy_truth: Vec<Array2<f64>>,
}

impl Scenes {
    /// A grid of `across` by `across` objects and the telescope's own images of each.
    ///
    /// # Errors
    /// [`PsfieldError::ObjectsTooClose`], [`PsfieldError::Source`].
    pub(super) fn new(telescope: &dyn PsfSource, across: usize) -> Result<Self, PsfieldError> {
        let (frame, grid) = (telescope.field(), telescope.grid());
        let margin = grid.nx().max(grid.ny());
        let pixels = object_pixels(frame, across, margin, margin + GALAXY_SIDE)?;
        let positions = positions_of(&pixels);
        let galaxy = galaxy_light()?;
        Ok(Self {
            star_truth: positions
                .par_iter()
                .map(|&at| true_psf(telescope, at))
                .collect::<Result<_, _>>()?,
            galaxy_truth: pixels
                .par_iter()
                .map(|&at| true_galaxy(telescope, at, galaxy.view()))
                .collect::<Result<_, _>>()?,
            frame,
            columns: across,
            pixels,
            positions,
            galaxy,
        })
    }

    /// Stars and galaxies drawn at a tolerance and measured, with a row for each.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub(super) fn drawn(
        &self,
        model: &PsfModel,
        tolerance: f64,
        rows: &mut Vec<ToleranceRow>,
    ) -> Result<(Evaluation, Evaluation), PsfieldError> {
        let star = Array2::from_elem((1, 1), 1.0);
        let kinds = [star.view(), self.galaxy.view()];
        let mut drawn = draw_by_transforms(model, self.frame, &self.pixels, &kinds, tolerance)?;
        let galaxies = drawn.pop().expect("two kinds");
        let stars = drawn.pop().expect("two kinds");
        let mut measured = |kind, drawn: &Drawn, truth: &[Array2<f64>]| {
            let evaluation = Evaluation::measure(
                &self.positions,
                &drawn.windows,
                truth,
                Some(self.frame),
                Some(self.columns),
            );
            rows.push(ToleranceRow {
                tolerance,
                kind,
                summary: evaluation.summary.clone(),
                seconds: drawn.seconds,
            });
            evaluation
        };
        Ok((
            measured(ObjectKind::Point, &stars, &self.star_truth),
            measured(ObjectKind::Extended, &galaxies, &self.galaxy_truth),
        ))
    }
}

/// A galaxy of unit flux on its pixels; what lies beyond is left out of scene and truth alike.
fn galaxy_light() -> Result<Array2<f64>, PsfieldError> {
    let [radius, index, axis_ratio, angle] = GALAXY;
    let profile = SersicProfile::new(radius, index, axis_ratio, angle)?;
    let middle = Position::of_pixel((GALAXY_SIDE / 2) as i64, (GALAXY_SIDE / 2) as i64);
    let mut light = Array2::<f64>::zeros((GALAXY_SIDE, GALAXY_SIDE));
    sersic::add_galaxies(
        light.view_mut(),
        (0, 0),
        &[SersicSource::new(middle, 1.0, profile)?],
    );
    let sum = light.sum();
    Ok(light / sum)
}
