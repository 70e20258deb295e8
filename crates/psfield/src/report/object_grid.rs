//! Where objects are put.

use psf_types::{FrameShape, Position};

use crate::PsfieldError;

/// Pixels of a grid of `across` by `across` objects, ordered by y, then x, at least `margin` pixels from the frame's edges.
///
/// # Errors
/// [`PsfieldError::ObjectsTooClose`] when two of them would be closer than `least_apart` pixels along an axis.
pub(super) fn object_pixels(
    frame: FrameShape,
    across: usize,
    margin: usize,
    least_apart: usize,
) -> Result<Vec<(usize, usize)>, PsfieldError> {
    let axis = |length: usize| -> Option<Vec<usize>> {
        let room = length.checked_sub(2 * margin + 1)?;
        let step = room as f64 / across.saturating_sub(1).max(1) as f64;
        (across == 1 || step >= least_apart as f64).then(|| {
            (0..across)
                .map(|k| margin + (k as f64 * step).round() as usize)
                .collect()
        })
    };
    let (Some(columns), Some(rows)) = (axis(frame.nx()), axis(frame.ny())) else {
        return Err(PsfieldError::ObjectsTooClose {
            frame,
            across,
            least_apart,
        });
    };
    Ok(rows
        .iter()
        .flat_map(|&y| columns.iter().map(move |&x| (x, y)))
        .collect())
}

/// The same as positions.
pub(super) fn positions_of(pixels: &[(usize, usize)]) -> Vec<Position> {
    pixels
        .iter()
        .map(|&(x, y)| Position::of_pixel(x as i64, y as i64))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_keep_their_distances() {
        let frame = FrameShape::new(500, 300).unwrap();
        let pixels = object_pixels(frame, 3, 40, 90).unwrap();
        assert_eq!(pixels.len(), 9);
        assert_eq!((pixels[0], pixels[8]), ((40, 40), (459, 259)));
        assert!(matches!(
            object_pixels(frame, 4, 40, 90),
            Err(PsfieldError::ObjectsTooClose { across: 4, .. })
        ));
        assert!(object_pixels(frame, 2, 200, 90).is_err());
    }
}
