//! Evaluates the PSF of a model at given positions.

use conv_core::{StampInterpolator, edge_reach_of};
use ndarray::{Array2, Array3};
use psf_types::{DataError, FrameShape, Position, PsfModel, PsfSamples, SamplePositions, StampGrid};
use rayon::prelude::*;

use crate::error::{ErrorKind, PsfieldError};
use crate::psf::{Psf, native_grid_of};
use crate::stack_size::check_stack;

/// The pixels at which PSFs are evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum OutputGrid {
    /// The model's own sampling. The stamps include the pixel response if the model's stamps do
    /// ([`StampGrid::pixel_response_included`]).
    #[default]
    Model,
    /// The frame's pixels. A value is the light that falls into the pixel. If the stamps lack the
    /// pixel response, it is added, as in a [`Simulator`](crate::Simulator).
    Native,
}

/// Options for the evaluation of PSFs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EvaluateOptions {
    /// The pixels of the stamps.
    pub grid: OutputGrid,
    /// Number of columns and of rows. Stamps are cut or padded about the centre. None: the stamps
    /// keep their own size.
    pub size: Option<usize>,
    /// If true, each PSF is drawn at the sub-pixel phase of its position (its offset from the
    /// nearest pixel's centre). This needs [`OutputGrid::Native`]. If false, PSFs are centred.
    pub sub_pixel: bool,
}

/// Checks that all positions lie on the model's field, if it has one, or at most one pixel outside
/// it.
///
/// # Errors
/// [`ErrorKind::Field`] for the first position that lies outside the field.
pub fn check_on_field(model: &PsfModel, positions: &[Position]) -> Result<(), PsfieldError> {
    if let Some(field) = model.field_shape()
        && let Some(index) = positions.iter().position(|&p| !field.is_near(p))
    {
        let message = format!(
            "position {index} (0-based) at {} lies outside the field of {field} pixels over which the PSF is known",
            positions[index]
        );
        return Err(PsfieldError::new(ErrorKind::Field, message));
    }
    Ok(())
}

/// Checks that a frame is not larger than the field over which a PSF is known. Accepts every frame
/// if the field is not known.
///
/// # Errors
/// [`ErrorKind::Field`] for a frame that has more columns or more rows than the field.
pub fn check_frame_on_field(frame: FrameShape, field: Option<FrameShape>) -> Result<(), PsfieldError> {
    match field {
        Some(field) if frame.nx() > field.nx() || frame.ny() > field.ny() => {
            let message = format!(
                "the frame is {frame} pixels, but the PSF is known only over a field of {field} pixels: choose a frame that \
                 is no larger than the field. In a simulation, the frame may be a part of the scene, and light outside \
                 the frame still contributes"
            );
            Err(PsfieldError::new(ErrorKind::Field, message).with_setting("frame"))
        }
        _ => Ok(()),
    }
}

impl Psf {
    /// Evaluates the PSFs at positions and returns them as samples. See [`evaluate`].
    ///
    /// # Errors
    /// The errors of [`evaluate`] and of the fit.
    pub fn evaluate(
        &self,
        positions: Vec<Position>,
        options: EvaluateOptions,
    ) -> Result<PsfSamples, PsfieldError> {
        evaluate(self.model()?, positions, options)
    }
}

/// Evaluates the PSFs of a model at positions and returns them as samples.
///
/// # Errors
/// The errors of [`evaluate_stamps`], and [`ErrorKind::Data`] if there are no positions, if two
/// positions are equal, or for a PSF without positive flux.
pub fn evaluate(
    model: &PsfModel,
    positions: Vec<Position>,
    options: EvaluateOptions,
) -> Result<PsfSamples, PsfieldError> {
    const NONE: &str = "there are no positions: at least one is needed";
    check_on_field(model, &positions)?;
    let positions = SamplePositions::new(positions, model.field_shape()).map_err(|error| match error {
        // The caller gave positions, not samples, so the messages speak of positions.
        DataError::NoSamples => PsfieldError::new(ErrorKind::Data, NONE).because(error),
        DataError::DuplicatePosition {
            first,
            second,
            position,
        } => {
            let message = format!("positions {first} and {second} (0-based) are both {position}: remove one");
            PsfieldError::new(ErrorKind::Data, message).because(error)
        }
        other => other.into(),
    })?;
    let (stamps, grid) = evaluate_stamps(model, positions.as_slice(), options)?;
    Ok(PsfSamples::new(stamps, positions, grid)?)
}

/// Evaluates the PSFs of a model at positions. Returns plain stamps `[position, y, x]` and the grid
/// of their pixels. Positions may be repeated, and there may be none.
///
/// With [`OutputGrid::Native`] and `sub_pixel`, each stamp is the image that
/// [`Simulator`](crate::Simulator) draws of a star of unit flux at this position. All stamps have
/// the size of centred ones. If the edges of the model's stamps are bright, the simulator draws
/// also pixels farther out.
///
/// # Errors
/// [`ErrorKind::Field`] for a position outside the model's field, or where the model has no value.
/// If the model scales PSFs to unit flux, also where the flux is not positive.
/// [`ErrorKind::Setting`] for sub-pixel phases on another grid than the native one,
/// [`ErrorKind::Data`] for a size of 0, [`ErrorKind::TooLarge`] if the stamps would fill more
/// memory than [`check_stack`] allows.
///
/// ```no_run
/// use psfield::psf_types::Position;
/// use psfield::{Psf, evaluate::{EvaluateOptions, OutputGrid, evaluate_stamps}};
/// let psf = Psf::open("psf.fits")?;
/// let options = EvaluateOptions { grid: OutputGrid::Native, sub_pixel: true, ..Default::default() };
/// let stars = [Position::new(100.25, 80.5)?, Position::new(100.25, 80.5)?];
/// let (stamps, grid) = evaluate_stamps(psf.model()?, &stars, options)?;
/// assert_eq!(stamps.dim(), (2, grid.ny(), grid.nx()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn evaluate_stamps(
    model: &PsfModel,
    positions: &[Position],
    options: EvaluateOptions,
) -> Result<(Array3<f64>, StampGrid), PsfieldError> {
    if options.sub_pixel && options.grid != OutputGrid::Native {
        const NATIVE: &str = "sub-pixel phases need the frame's own pixels: choose the native grid";
        return Err(PsfieldError::of_setting("grid", NATIVE));
    }
    check_on_field(model, positions)?;
    let target = target_grid(model, options)?;
    check_stack(positions.len(), target)?;
    let stamps: Vec<Result<Array2<f64>, PsfieldError>> = positions
        .par_iter()
        .map(|&position| {
            let psf = model.psf_at(position)?;
            let phase = |v: f64| v - (v + 0.5).floor();
            let shift = if options.sub_pixel {
                (phase(position.x()), phase(position.y()))
            } else {
                (0.0, 0.0)
            };
            Ok(if target == model.whole_grid() && shift == (0.0, 0.0) {
                psf.into_values()
            } else {
                StampInterpolator::new(psf.values(), model.whole_grid()).resample(shift, target)
            })
        })
        .collect();
    let mut cube = Array3::zeros((positions.len(), target.ny(), target.nx()));
    for (mut plane, stamp) in cube.outer_iter_mut().zip(stamps) {
        plane.assign(&stamp?);
    }
    Ok((cube, target))
}

fn target_grid(model: &PsfModel, options: EvaluateOptions) -> Result<StampGrid, PsfieldError> {
    let grid = model.whole_grid();
    let base = match options.grid {
        OutputGrid::Model => grid,
        OutputGrid::Native => native_grid_of(grid, 1.0, 0.0, || match model.wings() {
            Some(_) => 0,
            None => edge_reach_of(model),
        })?,
    };
    let Some(size) = options.size else { return Ok(base) };
    // A centre between pixels stays between pixels, so that values need no interpolation.
    let centre = |c: f64| (size / 2) as f64 + c.fract();
    let sized = base.with_size(size, size)?;
    Ok(sized.with_centre(centre(base.centre_x()), centre(base.centre_y()))?)
}
