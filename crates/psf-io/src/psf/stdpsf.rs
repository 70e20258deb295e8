//! STDPSF: the standard PSF libraries of J. Anderson (STScI) for HST and JWST.
//!
//! # Layout
//!
//! The only image with pixels, or else the chosen one, is a cube `[plane, y, x]` of `NXPSFS` times
//! `NYPSFS` planes, with x fastest. The stamps are oversampled 4 times, which no keyword states.
//!
//! | keyword | meaning |
//! |---|---|
//! | `NXPSFS`, `NYPSFS` | columns and rows of the grid of PSFs |
//! | `IPSFX01`, `IPSFX02` ... | x of each column in detector pixels, counted from 1 |
//! | `JPSFY01`, `JPSFY02` ... | y of each row in detector pixels, counted from 1 |
//! | `IPSFXA5`, `IPSFXB5` ... and `JPSFYA5` ... | the positions as strings of several numbers (in files of WFPC2, and of all short-wave detectors of NIRCam together) |
//!
//! Keywords may be in lower case, as some are in real files. Only the first `NXPSFS` and `NYPSFS`
//! positions are read. Unused positions hold 9999. A 9999 among the positions that are read is an
//! error. Stamps are centred at index `(n - 1) / 2` and include the response of a pixel. They are
//! normalised to 1 within a radius that a comment states, so they do not sum to 16. The reader does
//! not rescale them.
//!
//! # Detectors
//!
//! Some files hold several detectors side by side. The reader recognises these files by the shape
//! of the grid, and converts positions to pixels of the chosen detector:
//!
//! | PSFs | instrument | detectors | offset in pixels |
//! |---|---|---|---|
//! | 9 x 10 | ACS/WFC | 1: WFC2 (SCI,1), 2: WFC1 (SCI,2) | 2048 in y for the second |
//! | 7 x 8 | WFC3/UVIS | 1: UVIS2 (SCI,1), 2: UVIS1 (SCI,2) | 2048 in y for the second |
//! | 6 x 6 | WFPC2 | 1: PC, 2: WF2, 3: WF3, 4: WF4, arranged as `2 1` above `3 4` | 800 |
//! | 20 x 10 | NIRCam short-wave | 1 to 4: A1 to A4, 5 to 8: B1 to B4, arranged as `2 4 7 5` above `1 3 8 6` | 2048 |
//!
//! Detectors have the numbers of photutils' `detector_id`. Any other grid belongs to a single
//! detector.

use std::ops::Range;
use std::path::Path;

use ndarray::{Array3, ArrayView2, ArrayView3, Axis};
use psf_types::Position;

use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::hdu::HduChoice;
use crate::fits::image::read_stack;
use crate::fits::structure::FitsStructure;
use crate::psf::gridded::{GriddedPsf, LibraryCards, Planes, cube_shape};

/// Stamp pixels per detector pixel.
const OVERSAMPLING: f64 = 4.0;
const COUNT_EXPECTED: &str = "the number of PSFs along an axis of the grid, a whole number above 0";

/// Returns whether a file is an STDPSF library, that is, whether the header of its first image
/// states the number of PSFs along an axis. The reader checks that it states both numbers.
pub(crate) fn is_stdpsf(structure: &FitsStructure) -> bool {
    let cards = structure.first_image().map(LibraryCards::new);
    cards.is_ok_and(|cards| cards.has("NXPSFS") || cards.has("NYPSFS"))
}

/// Reads an STDPSF library. See the [layout](self). If the file holds several detectors, `detector`
/// chooses one by the number that the layout lists.
///
/// [`GriddedPsf::notes`] names the chosen detector, and lists border rows of stamps whose values
/// cannot belong to a PSF. These values are kept.
///
/// ```no_run
/// use psf_io::read_stdpsf;
/// let library = read_stdpsf("STDPSF_ACSWFC_F814W.fits", Some(2))?;
/// assert_eq!(library.detector(), Some("WFC1"));
/// assert_eq!(library.samples().grid().oversampling(), 4.0);
/// # Ok::<(), psf_io::IoError>(())
/// ```
///
/// # Errors
/// - [`IoErrorKind::Setting`] if several images have pixels, if the file holds several detectors and
///   `detector` is `None`, or if the file has no detector of this number
/// - [`IoErrorKind::Header`] with the keyword that is missing or malformed, or if two columns or
///   two rows of the grid have the same position
/// - [`IoErrorKind::Axes`] unless the image has two or three axes
/// - [`IoErrorKind::Data`] if the number of planes is not the number of PSFs in the grid, or a
///   plane has no flux
/// - the [errors of any FITS file](crate#bad-files)
pub fn read_stdpsf(path: impl AsRef<Path>, detector: Option<usize>) -> Result<GriddedPsf, IoError> {
    read_stdpsf_hdu(path, None, detector, false)
}

/// Reads the library in the chosen HDU. Without a choice it is the only image with pixels. If
/// `skip_invalid` is true, planes without positive flux are left out ([`GriddedPsf::left_out`]) and
/// not an error. [`GriddedPsf::notes`] names them.
///
/// # Errors
/// The errors of [`read_stdpsf`], and [`IoErrorKind::Setting`] for a choice that is not an image
/// with pixels.
pub fn read_stdpsf_hdu(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
    detector: Option<usize>,
    skip_invalid: bool,
) -> Result<GriddedPsf, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.stamps(choice)?;
    let cards = &LibraryCards::new(hdu);
    let (planes, ny, nx) = cube_shape(hdu)?;
    let columns = cards.required_count("NXPSFS", 1, COUNT_EXPECTED)?;
    let rows = cards.required_count("NYPSFS", 1, COUNT_EXPECTED)?;
    // This check also limits how much of the header is read below.
    if columns.checked_mul(rows) != Some(planes) {
        let stated = format!("{columns} times {rows}");
        return Err(cards.plane_count(planes, "NXPSFS times NYPSFS", &stated));
    }
    let layout = Layout::of_grid(columns, rows);
    let chosen = layout
        .choose(detector)
        .map_err(|problem| IoError::new(path, IoErrorKind::Setting, problem).with_setting("detector"))?;
    let part = layout.part(chosen, columns, rows);
    let x = read_lines(cards, "IPSFX", columns, part.columns.clone())?;
    let y = read_lines(cards, "JPSFY", rows, part.rows.clone())?;

    let mut positions = Vec::new();
    let mut numbers = Vec::new();
    for (row, y) in part.rows.clone().zip(&y) {
        for (column, x) in part.columns.clone().zip(&x) {
            let position = Position::new(x - 1.0 - part.x0, y - 1.0 - part.y0);
            positions.push(position.map_err(invalid(path))?);
            numbers.push(row * columns + column);
        }
    }
    let cube = read_stack(hdu, (planes, ny, nx))?;
    let stamps = if numbers.len() == planes {
        cube
    } else {
        cube.select(Axis(0), &numbers)
    };
    let name = layout.name(chosen);
    let mut notes = Vec::new();
    if let Some(name) = &name {
        notes.push(format!(
            "detector: {} ({name}) of {} was read",
            chosen + 1,
            layout.len()
        ));
    }
    notes.extend(defects(&stamps, &numbers));
    let planes = Planes {
        stamps,
        numbers,
        positions,
        oversampling: OVERSAMPLING,
        detector: name.map(str::to_owned),
        notes,
    };
    GriddedPsf::new(path, planes, skip_invalid)
}

/// The arrangement of the detectors in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    /// Number of detectors along x and y.
    across: (usize, usize),
    /// Side of a detector in pixels.
    size: usize,
    names: &'static [&'static str],
    /// The place of each detector in the arrangement, counted along x, then y.
    places: &'static [usize],
}

/// The part of the grid that belongs to one detector.
#[derive(Debug, Clone, PartialEq)]
struct DetectorPart {
    columns: Range<usize>,
    rows: Range<usize>,
    /// The x of the detector's first pixel, in the pixel coordinates of the file (0-based).
    x0: f64,
    /// The y of the detector's first pixel.
    y0: f64,
}

const SINGLE: Layout = Layout::new((1, 1), 0, &[], &[]);

/// The grids (columns, rows) of files with several detectors.
const DETECTOR_GRIDS: &[((usize, usize), Layout)] = &[
    ((9, 10), Layout::new((1, 2), 2048, &["WFC2", "WFC1"], &[0, 1])),
    ((7, 8), Layout::new((1, 2), 2048, &["UVIS2", "UVIS1"], &[0, 1])),
    (
        (6, 6),
        Layout::new((2, 2), 800, &["PC", "WF2", "WF3", "WF4"], &[3, 2, 0, 1]),
    ),
    (
        (20, 10),
        Layout::new((4, 2), 2048, NIRCAM, &[0, 4, 1, 5, 7, 3, 6, 2]),
    ),
];
const NIRCAM: &[&str] = &["A1", "A2", "A3", "A4", "B1", "B2", "B3", "B4"];

impl Layout {
    const fn new(
        across: (usize, usize),
        size: usize,
        names: &'static [&'static str],
        places: &'static [usize],
    ) -> Self {
        Self {
            across,
            size,
            names,
            places,
        }
    }

    /// The arrangement for a grid of this size.
    fn of_grid(columns: usize, rows: usize) -> Self {
        DETECTOR_GRIDS
            .iter()
            .find(|(grid, _)| *grid == (columns, rows))
            .map_or(SINGLE, |&(_, layout)| layout)
    }

    fn len(self) -> usize {
        self.across.0 * self.across.1
    }

    /// The 0-based index of a detector. `detector` is its number, counted from 1. Without a number,
    /// the file must hold a single detector.
    fn choose(self, detector: Option<usize>) -> Result<usize, String> {
        let number = match detector {
            None if self == SINGLE => 1,
            None => 0,
            Some(number) => number,
        };
        if (1..=self.len()).contains(&number) {
            return Ok(number - 1);
        }
        let named = |i| format!("{} ({})", i + 1, self.name(i).unwrap_or("the only one"));
        let detectors: Vec<String> = (0..self.len()).map(named).collect();
        let none = detector.map_or_else(String::new, |n| format!("there is no detector {n}: "));
        Err(format!(
            "{none}the file holds the detector(s) {}: choose one",
            detectors.join(", ")
        ))
    }

    /// The name of a detector, or `None` for a single detector, which the file does not name.
    fn name(self, index: usize) -> Option<&'static str> {
        self.names.get(index).copied()
    }

    /// The part of a grid of `columns` and `rows` that belongs to a detector.
    fn part(self, index: usize, columns: usize, rows: usize) -> DetectorPart {
        let place = self.places.get(index).copied().unwrap_or(0);
        let (i, j) = (place % self.across.0, place / self.across.0);
        let (width, height) = (columns / self.across.0, rows / self.across.1);
        DetectorPart {
            columns: i * width..(i + 1) * width,
            rows: j * height..(j + 1) * height,
            x0: (i * self.size) as f64,
            y0: (j * self.size) as f64,
        }
    }
}

/// The value of an unused position.
const UNUSED: f64 = 9999.0;
const NUMBER_EXPECTED: &str = "a position of the grid in pixels (9999 marks unused ones)";
const LIST_EXPECTED: &str = "a string of positions of the grid in pixels (9999 marks unused ones)";

/// Reads the first `count` positions along an axis, in pixels counted from 1, and returns the range
/// `wanted` of them. `stem` is `IPSFX` or `JPSFY`.
fn read_lines(
    cards: &LibraryCards<'_>,
    stem: &str,
    count: usize,
    wanted: Range<usize>,
) -> Result<Vec<f64>, IoError> {
    let mut lines = if cards.has(&list_keyword(stem, 0)) && !cards.has(&format!("{stem}01")) {
        listed(cards, stem, count)?
    } else {
        single(cards, stem, count)?
    };
    if let Some((_, keyword)) = lines.iter().find(|(value, _)| *value == UNUSED) {
        return Err(cards.hdu.wrong_value(
            keyword,
            "a position in pixels, because NXPSFS and NYPSFS count it as used (9999 marks unused positions)",
            UNUSED,
        ));
    }
    let lines: Vec<(f64, String)> = lines.drain(wanted).collect();
    for (i, (value, second)) in lines.iter().enumerate() {
        if let Some((_, first)) = lines[..i].iter().find(|(earlier, _)| earlier == value) {
            // A card with a list has several positions.
            let second = if first == second { "the same card" } else { second };
            let problem = format!("the positions in {first} and {second} are both {value}: they must differ");
            return Err(cards.hdu.error(IoErrorKind::Header, problem));
        }
    }
    Ok(lines.into_iter().map(|(value, _)| value).collect())
}

/// Reads positions from cards that hold one number each.
fn single(cards: &LibraryCards<'_>, stem: &str, count: usize) -> Result<Vec<(f64, String)>, IoError> {
    (1..=count)
        .map(|line| {
            let keyword = format!("{stem}{line:02}");
            Ok((cards.required_number(&keyword, NUMBER_EXPECTED)?, keyword))
        })
        .collect()
}

/// Reads positions from strings that hold several numbers each.
fn listed(cards: &LibraryCards<'_>, stem: &str, count: usize) -> Result<Vec<(f64, String)>, IoError> {
    let mut lines = Vec::new();
    let mut list = 0;
    while lines.len() < count {
        let keyword = list_keyword(stem, list);
        let text = cards
            .text(&keyword, LIST_EXPECTED)?
            .ok_or_else(|| cards.hdu.missing_keyword(&keyword, LIST_EXPECTED))?;
        for word in text.split_whitespace() {
            let value: Option<f64> = word.parse().ok().filter(|v: &f64| v.is_finite());
            let value = value.ok_or_else(|| cards.hdu.wrong_value(&keyword, LIST_EXPECTED, text.clone()))?;
            lines.push((value, keyword.clone()));
        }
        list += 1;
    }
    lines.truncate(count);
    Ok(lines)
}

/// The keyword of a list: `IPSFXA5`, `IPSFXB5` and so on. After Z it is not a valid keyword, so no
/// file has it.
fn list_keyword(stem: &str, list: u8) -> String {
    format!("{stem}{}5", char::from(b'A'.saturating_add(list)))
}

/// A value this far below zero, relative to the peak, is not the wing of a PSF. Negative values in
/// the good rows of real libraries are a thousand times smaller.
const NEGATIVE: f64 = 0.01;
/// A border pixel this many times brighter than its inner neighbour is not in the wing of a PSF,
/// because wings become fainter outwards.
const JUMP: f64 = 10.0;
/// A border pixel fainter than this, relative to the peak, is not tested for a jump.
const FAINT: f64 = 0.01;
/// A row is bad if more than this fraction of its pixels are bad. Bad rows along the two adjacent
/// sides cross this row, but cover a smaller fraction of it.
const PART: f64 = 0.25;
/// The number of rows divided by this gives how many of the outermost rows are tested.
const DEPTH: usize = 10;

/// Returns a note for each side on which some stamps have bad rows. `numbers` are the numbers of
/// the stamps' planes in the file.
fn defects(stamps: &Array3<f64>, numbers: &[usize]) -> Vec<String> {
    // Name of the side, axis that leads inwards, and whether the side is at the end of this axis.
    [
        ("bottom", 1, false),
        ("top", 1, true),
        ("left", 2, false),
        ("right", 2, true),
    ]
    .into_iter()
    .filter_map(|(name, axis, last)| {
        let mut inwards = stamps.view();
        if last {
            inwards.invert_axis(Axis(axis));
        }
        inwards.swap_axes(1, axis);
        side_defect(inwards, numbers, name)
    })
    .collect()
}

/// Returns a note for one side of stamps `[stamp, row inwards, place along the side]`.
fn side_defect(stamps: ArrayView3<'_, f64>, numbers: &[usize], name: &str) -> Option<String> {
    let (mut depth, mut worst) = (0, 0.0_f64);
    let mut planes = Vec::new();
    for (stamp, number) in stamps.outer_iter().zip(numbers) {
        let bad = bad_rows(stamp);
        if bad > 0 {
            depth = depth.max(bad);
            planes.push(*number);
            let strongest = |worst: f64, &v: &f64| if v.abs() > worst.abs() { v } else { worst };
            worst = stamp.outer_iter().take(bad).flatten().fold(worst, strongest);
        }
    }
    (!planes.is_empty()).then(|| {
        format!(
            "border: the {depth} outermost row(s) or column(s) on the {name} side of {} plane(s) (first: {}, counted from 0) hold values that cannot belong to a PSF, such as \
             {worst} (they are used unchanged)",
            planes.len(),
            planes[0]
        )
    })
}

/// The number of rows from the border to the innermost bad row, or 0 if no row is bad.
fn bad_rows(stamp: ArrayView2<'_, f64>) -> usize {
    let peak = stamp.iter().copied().fold(0.0, f64::max);
    let is_bad = |&row: &usize| {
        let (values, inwards) = (stamp.row(row), stamp.row(row + 1));
        let bad = values.iter().zip(inwards).filter(|&(&value, &next)| {
            let size = value.abs();
            value < -NEGATIVE * peak || (size > FAINT * peak && size > JUMP * next.abs())
        });
        bad.count() as f64 > PART * values.len() as f64
    };
    let rows = stamp.nrows();
    (0..rows.div_ceil(DEPTH).min(rows.saturating_sub(1)))
        .rev()
        .find(is_bad)
        .map_or(0, |row| row + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_detector_has_a_place_of_its_own_and_a_whole_number_of_psfs() {
        for &((columns, rows), layout) in DETECTOR_GRIDS {
            let mut places = layout.places.to_vec();
            places.sort_unstable();
            assert_eq!(layout.names.len(), places.len());
            assert_eq!(places, (0..layout.len()).collect::<Vec<_>>());
            assert_eq!((columns % layout.across.0, rows % layout.across.1), (0, 0));
        }
    }

    #[test]
    fn detectors_have_their_documented_places() {
        let part =
            |columns, rows, detector: usize| Layout::of_grid(columns, rows).part(detector - 1, columns, rows);
        // The planetary camera is at the upper right of WFPC2.
        let pc = part(6, 6, 1);
        assert_eq!((pc.columns, pc.rows, pc.x0, pc.y0), (3..6, 3..6, 800.0, 800.0));
        // NIRCam B4 is the third of the four lower detectors.
        let b4 = part(20, 10, 8);
        assert_eq!((b4.columns, b4.rows, b4.x0, b4.y0), (10..15, 0..5, 4096.0, 0.0));
        let wfc1 = part(9, 10, 2);
        assert_eq!(
            (wfc1.columns, wfc1.rows, wfc1.x0, wfc1.y0),
            (0..9, 5..10, 0.0, 2048.0)
        );
        assert_eq!(part(3, 3, 1).columns, 0..3);
    }

    #[test]
    fn one_of_several_detectors_must_be_chosen() {
        assert_eq!(Layout::of_grid(5, 5).choose(None), Ok(0));
        assert_eq!(Layout::of_grid(5, 5).choose(Some(1)), Ok(0));
        assert!(Layout::of_grid(5, 5).choose(Some(2)).is_err());
        assert_eq!(Layout::of_grid(6, 6).choose(Some(4)), Ok(3));
        assert!(Layout::of_grid(6, 6).choose(Some(0)).is_err());
        let error = Layout::of_grid(6, 6).choose(None).unwrap_err();
        assert!(
            error.contains("1 (PC), 2 (WF2), 3 (WF3), 4 (WF4)") && error.contains("choose one"),
            "{error}"
        );
    }

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
