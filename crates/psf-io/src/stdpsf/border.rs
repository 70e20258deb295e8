//! Border rows of stamps whose values cannot be those of a PSF.

use ndarray::{Array3, ArrayView1, ArrayView2, Axis};

/// A value this far below zero, relative to the peak, is no wing of a PSF: real libraries stay a thousand times closer.
const NEGATIVE: f64 = 0.01;
/// A border pixel this many times brighter than the next one inwards is not the wing of a PSF, which falls outwards ...
const JUMP: f64 = 10.0;
/// ... where it matters at all, relative to the peak.
const FAINT: f64 = 0.01;
/// A row is bad when more than this part of its pixels are, which bad rows on the adjacent sides do not reach.
const PART: f64 = 0.25;
/// Rows from the border that are looked at: one in so many of the stamp's.
const DEPTH: usize = 10;

/// A sentence for each side of the stamps with bad rows. `numbers` are the planes of the file.
pub(super) fn defects(stamps: &Array3<f64>, numbers: &[usize]) -> Vec<String> {
    SIDES
        .iter()
        .filter_map(|&(name, axis, last)| side_defect(stamps, numbers, name, axis, last))
        .collect()
}

/// Name, axis of the stamp along which one goes inwards, and whether from its end.
const SIDES: [(&str, usize, bool); 4] = [
    ("bottom", 0, false),
    ("top", 0, true),
    ("left", 1, false),
    ("right", 1, true),
];

fn side_defect(
    stamps: &Array3<f64>,
    numbers: &[usize],
    name: &str,
    axis: usize,
    last: bool,
) -> Option<String> {
    let (mut depth, mut worst) = (0, 0.0_f64);
    let mut planes = Vec::new();
    for (stamp, number) in stamps.axis_iter(Axis(0)).zip(numbers) {
        let bad = bad_rows(stamp, axis, last);
        if bad > 0 {
            depth = depth.max(bad);
            planes.push(*number);
            for row in 0..bad {
                worst = strongest(line(stamp, axis, last, row), worst);
            }
        }
    }
    (!planes.is_empty()).then(|| {
        format!(
            "border: the {depth} outermost row(s) on the {name} side of {} plane(s) (first: {}) hold values that are no PSF's, such as \
             {worst}; they are used as they are",
            planes.len(),
            planes[0]
        )
    })
}

/// How many rows from the border inwards are bad.
fn bad_rows(stamp: ArrayView2<'_, f64>, axis: usize, last: bool) -> usize {
    let peak = stamp.iter().copied().fold(0.0, f64::max);
    let is_bad = |&row: &usize| {
        let (values, inwards) = (line(stamp, axis, last, row), line(stamp, axis, last, row + 1));
        let bad = values.iter().zip(inwards).filter(|&(&value, &next)| {
            let size = value.abs();
            value < -NEGATIVE * peak || (size > FAINT * peak && size > JUMP * next.abs())
        });
        bad.count() as f64 > PART * values.len() as f64
    };
    let rows = stamp.len_of(Axis(axis));
    (0..rows.div_ceil(DEPTH).min(rows.saturating_sub(1)))
        .rev()
        .find(is_bad)
        .map_or(0, |row| row + 1)
}

/// The row at a distance from the border.
fn line(stamp: ArrayView2<'_, f64>, axis: usize, last: bool, row: usize) -> ArrayView1<'_, f64> {
    let index = if last {
        stamp.len_of(Axis(axis)) - 1 - row
    } else {
        row
    };
    stamp.index_axis_move(Axis(axis), index)
}

/// The value of the largest size.
fn strongest(values: ArrayView1<'_, f64>, first: f64) -> f64 {
    values
        .iter()
        .fold(first, |worst, &v| if v.abs() > worst.abs() { v } else { worst })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Moffat-like profile on 41 x 41 pixels.
    fn stamps() -> Array3<f64> {
        Array3::from_shape_fn((3, 41, 41), |(_, y, x)| {
            let r2 = (y as f64 - 20.0).powi(2) + (x as f64 - 20.0).powi(2);
            0.2 / (1.0 + r2 / 4.0).powf(2.5) - 1e-4
        })
    }

    #[test]
    fn wings_are_good_also_where_they_are_slightly_negative_or_cut() {
        assert!(defects(&stamps(), &[0, 1, 2]).is_empty());
        let core = stamps().slice_move(ndarray::s![.., 18..23, 18..23]);
        assert!(defects(&core, &[0, 1, 2]).is_empty());
        assert!(defects(&Array3::ones((1, 1, 1)), &[0]).is_empty());
    }

    #[test]
    fn bad_rows_are_named_with_side_depth_plane_and_value() {
        let mut bad = stamps();
        bad.slice_mut(ndarray::s![1, 39.., ..]).fill(-0.1);
        let notes = defects(&bad, &[10, 11, 12]);
        assert_eq!(notes.len(), 1, "{notes:?}");
        for part in ["2 outermost", "top", "1 plane", "first: 11", "-0.1"] {
            assert!(notes[0].contains(part), "{part}: {}", notes[0]);
        }
        let mut bright = stamps();
        bright.slice_mut(ndarray::s![.., .., 0]).fill(0.05);
        let notes = defects(&bright, &[0, 1, 2]);
        assert!(notes.len() == 1 && notes[0].contains("left"), "{notes:?}");
    }
}
