//! Which part of the grid belongs to which detector.

use std::ops::Range;

use crate::GriddedError;

/// The detectors of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// Detectors along x and y.
    across: (usize, usize),
    /// Pixels along a side of a detector.
    size: usize,
    /// Name and place of each detector, the places counted along x, then y.
    detectors: &'static [(&'static str, usize)],
}

/// The part of the grid that belongs to one detector.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Block {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    /// Where the detector begins in the positions of the file.
    pub(super) x0: f64,
    pub(super) y0: f64,
}

const SINGLE: Layout = Layout {
    across: (1, 1),
    size: 0,
    detectors: &[],
};

/// The grids (columns, rows) that hold several detectors.
const SEVERAL: &[((usize, usize), Layout)] = &[
    (
        (9, 10),
        Layout {
            across: (1, 2),
            size: 2048,
            detectors: &[("WFC2", 0), ("WFC1", 1)],
        },
    ),
    (
        (7, 8),
        Layout {
            across: (1, 2),
            size: 2048,
            detectors: &[("UVIS2", 0), ("UVIS1", 1)],
        },
    ),
    (
        (6, 6),
        Layout {
            across: (2, 2),
            size: 800,
            detectors: &[("PC", 3), ("WF2", 2), ("WF3", 0), ("WF4", 1)],
        },
    ),
    (
        (20, 10),
        Layout {
            across: (4, 2),
            size: 2048,
            detectors: &[
                ("A1", 0),
                ("A2", 4),
                ("A3", 1),
                ("A4", 5),
                ("B1", 7),
                ("B2", 3),
                ("B3", 6),
                ("B4", 2),
            ],
        },
    ),
];

impl Layout {
    /// The layout of a grid of so many columns and rows.
    pub(super) fn of_grid(columns: usize, rows: usize) -> Self {
        SEVERAL
            .iter()
            .find(|(grid, _)| *grid == (columns, rows))
            .map_or(SINGLE, |&(_, layout)| layout)
    }

    /// Number of detectors.
    pub(super) fn len(self) -> usize {
        self.across.0 * self.across.1
    }

    /// The index of the detector that is chosen by its number, counted from 1.
    pub(super) fn choose(self, detector: Option<usize>) -> Result<usize, GriddedError> {
        let number = match detector {
            None if self == SINGLE => 1,
            None => 0,
            Some(number) => number,
        };
        if (1..=self.len()).contains(&number) {
            return Ok(number - 1);
        }
        Err(GriddedError::Detector {
            got: detector,
            detectors: (0..self.len())
                .map(|i| (i + 1, self.name(i).unwrap_or("the only one").to_owned()))
                .collect(),
        })
    }

    /// The name of a detector; none where there is only one, which the file does not name.
    pub(super) fn name(self, index: usize) -> Option<&'static str> {
        self.detectors.get(index).map(|(name, _)| *name)
    }

    /// The part of a grid of so many columns and rows that belongs to a detector.
    pub(super) fn block(self, index: usize, columns: usize, rows: usize) -> Block {
        let place = self.detectors.get(index).map_or(0, |(_, place)| *place);
        let (i, j) = (place % self.across.0, place / self.across.0);
        let (width, height) = (columns / self.across.0, rows / self.across.1);
        Block {
            columns: i * width..(i + 1) * width,
            rows: j * height..(j + 1) * height,
            x0: (i * self.size) as f64,
            y0: (j * self.size) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_detector_has_a_place_of_its_own_and_a_whole_number_of_psfs() {
        for &((columns, rows), layout) in SEVERAL {
            let mut places: Vec<usize> = layout.detectors.iter().map(|(_, place)| *place).collect();
            places.sort_unstable();
            assert_eq!(places, (0..layout.len()).collect::<Vec<_>>());
            assert_eq!((columns % layout.across.0, rows % layout.across.1), (0, 0));
        }
    }

    #[test]
    fn detectors_lie_where_the_sky_has_them() {
        let block = |columns, rows, detector: usize| {
            Layout::of_grid(columns, rows).block(detector - 1, columns, rows)
        };
        // The planetary camera is the upper right of WFPC2.
        let pc = block(6, 6, 1);
        assert_eq!((pc.columns, pc.rows, pc.x0, pc.y0), (3..6, 3..6, 800.0, 800.0));
        // NIRCam B4 is the third of the lower four.
        let b4 = block(20, 10, 8);
        assert_eq!((b4.columns, b4.rows, b4.x0, b4.y0), (10..15, 0..5, 4096.0, 0.0));
        let wfc1 = block(9, 10, 2);
        assert_eq!(
            (wfc1.columns, wfc1.rows, wfc1.x0, wfc1.y0),
            (0..9, 5..10, 0.0, 2048.0)
        );
        assert_eq!(block(3, 3, 1).columns, 0..3);
    }

    #[test]
    fn a_choice_is_needed_among_several_and_must_be_one_of_them() {
        assert_eq!(Layout::of_grid(5, 5).choose(None), Ok(0));
        assert_eq!(Layout::of_grid(5, 5).choose(Some(1)), Ok(0));
        assert!(Layout::of_grid(5, 5).choose(Some(2)).is_err());
        assert_eq!(Layout::of_grid(6, 6).choose(Some(4)), Ok(3));
        assert!(Layout::of_grid(6, 6).choose(Some(0)).is_err());
        let error = Layout::of_grid(6, 6).choose(None).unwrap_err().to_string();
        assert!(
            error.contains("1 (PC), 2 (WF2), 3 (WF3), 4 (WF4)") && error.contains("--psf-detector"),
            "{error}"
        );
    }
}
