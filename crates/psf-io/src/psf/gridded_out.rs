//! Writes gridded PSF libraries.

use std::path::Path;

use ndarray::Array2;
use psf_types::{Position, PsfSamples, StampGrid, StampInterpolation};

use crate::error::{IoError, IoErrorKind, bad_card};
use crate::fits::card::{Card, padded, text_records};
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::{cards, write_fits, write_image_header};
use crate::psf::gridded::{ascending, middle};
use crate::psf::stpsf::{GRID_LINES, PLANE_ORDER, POSITION};

/// The smallest side of a stamp through which a cubic spline can be fitted.
const MIN_SIZE: usize = 4;

/// Writes samples on a grid as a gridded PSF library in the [layout of STPSF](crate::stpsf), for
/// photutils (`GriddedPSFModel.read(name, format="webbpsf")`) and psfield. Returns the number of
/// planes written.
///
/// Values are written unchanged, in double precision. `cards` are added to the header, before the
/// cards of the layout. Cards `DET_YX...` among them are left out.
///
/// # Planes
/// Releases of photutils disagree on which card holds the position of plane `i`. Up to 3.0 it is
/// the `i`-th card in the header, and its two numbers are read as (x, y). In later releases it is
/// `DET_YXi`, and the numbers are read as (y, x), as written. All releases agree if the grid has
/// the same coordinates in x and in y, and if the planes have x fastest while the cards have y
/// fastest. The library is written in this way.
///
/// If the grid of the samples has other coordinates in x than in y, more planes are written: one at
/// every crossing of all these coordinates. (A single sample is always written as a single plane.)
/// A plane between samples is interpolated bilinearly. A plane outside the grid of the samples is
/// the PSF at the nearest point of this grid. Readers interpolate in the same way, so the PSF is
/// unchanged everywhere. The card `GRIDLINE` says which planes are samples, and
/// [`read_stpsf`](crate::read_stpsf) returns only these.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("library.fits");
/// use ndarray::Array3;
/// use psf_io::{PlaneOrder, read_stpsf, write_gridded};
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// let corners = [(0.0, 0.0), (0.0, 99.0), (99.0, 0.0), (99.0, 99.0)];
/// let positions = corners.map(|(x, y)| Position::new(x, y)).into_iter().collect::<Result<_, _>>()?;
/// let grid = StampGrid::new(9, 9)?.with_oversampling(2.0)?; // an odd size: the middle is the default centre
/// let samples = PsfSamples::new(Array3::ones((4, 9, 9)), SamplePositions::new(positions, None)?, grid)?;
/// assert_eq!(write_gridded(&path, &samples, &[], false)?, 4);
/// let library = read_stpsf(&path, PlaneOrder::Auto)?;
/// assert_eq!(library.samples().grid(), grid);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Request`] for samples that the layout or its readers cannot hold: they are not on
/// a grid, their oversampling is not a whole number, or coordinates that differ in x and in y would
/// need more than 10 000 planes. It is also returned for stamps that are not centred in their
/// middle, lack the pixel response, are not interpolated by the cubic spline, or have fewer than
/// 4 x 4 pixels. Other errors are the errors of [`write_image`](crate::write_image).
pub fn write_gridded(
    path: impl AsRef<Path>,
    samples: &PsfSamples,
    cards: &[Card],
    overwrite: bool,
) -> Result<usize, IoError> {
    let path = path.as_ref();
    let refused = |problem: String| IoError::new(path, IoErrorKind::Request, problem);
    let oversampling = check(samples.grid()).map_err(refused)?;
    let square = SquareGrid::of(samples).map_err(refused)?;
    let planes = square.planes();
    let mut header = HeaderCards::new().with(cards);
    for card in &header.clone() {
        if card.keyword().starts_with(POSITION) {
            header.remove(&card.keyword());
        }
    }
    let mut header = header.with(&own_cards(path, samples.grid(), oversampling, &square)?);
    for plane in square.card_order() {
        let (x, y) = square.position(plane);
        header.push(position_card(plane, x, y));
    }
    let (ny, nx) = samples.grid().dim();
    write_fits(path, overwrite, |fits| {
        write_image_header(fits, &[planes, ny, nx], -64, &header)?;
        // The planes are written one by one, because there may be many more of them than samples.
        (0..planes).try_for_each(|plane| {
            let stamp = square.stamp(samples, plane);
            let values = stamp.as_slice().expect("a new array is row-major");
            fits.write_pixels(plane * ny * nx, values)
        })
    })?;
    Ok(planes)
}

/// Checks that the layout can hold stamps of this grid. Returns the oversampling as a whole number.
fn check(grid: StampGrid) -> Result<usize, String> {
    let (oversampling, nx, ny) = (grid.oversampling(), grid.nx(), grid.ny());
    let (centre, middle) = ((grid.centre_x(), grid.centre_y()), (middle(nx), middle(ny)));
    // Readers would not accept a number beyond 2^31 as a whole number.
    if oversampling.fract() != 0.0 || oversampling > f64::from(i32::MAX) {
        return Err(format!(
            "the stamps are oversampled {oversampling} times, but a gridded library needs a whole number: resample the PSF first"
        ));
    }
    if nx < MIN_SIZE || ny < MIN_SIZE {
        return Err(format!(
            "the stamps have {nx} x {ny} pixels: readers of gridded libraries need at least 4 x 4"
        ));
    }
    if centre != middle {
        return Err(format!(
            "the stamps are centred at index ({}, {}): a gridded library needs the middle, ({}, {})",
            centre.0, centre.1, middle.0, middle.1
        ));
    }
    if !grid.pixel_response_included() {
        return Err(
            "the stamps lack the response of a frame pixel, which a gridded library includes: apply it first"
                .to_owned(),
        );
    }
    if grid.interpolation() != StampInterpolation::CubicSpline {
        return Err(format!(
            "the stamps are interpolated by {}, but readers of gridded libraries use a cubic spline: resample the PSF first",
            grid.interpolation()
        ));
    }
    Ok(oversampling as usize)
}

fn own_cards(
    path: &Path,
    grid: StampGrid,
    oversampling: usize,
    square: &SquareGrid,
) -> Result<Vec<Card>, IoError> {
    let mut own = cards(
        path,
        [
            ("OVERSAMP", oversampling.into(), "stamp pixels per detector pixel"),
            ("DET_SAMP", oversampling.into(), "stamp pixels per detector pixel"),
            ("NUM_PSFS", square.planes().into(), "number of PSFs"),
            (PLANE_ORDER, "cards".into(), "plane i lies at (y, x) = DET_YXi"),
        ],
    )?;
    if grid.nx() == grid.ny() && grid.nx().is_multiple_of(oversampling) {
        let across = grid.nx() / oversampling;
        let card = Card::new("FOVPIXEL", across, "detector pixels across a stamp");
        own.push(card.map_err(bad_card(path))?);
    }
    if square.is_refined() {
        let axes = square.lines.iter().map(|line| {
            match [&square.xs, &square.ys].map(|samples| samples.contains(line)) {
                [true, true] => 'b',
                [true, false] => 'x',
                _ => 'y',
            }
        });
        let axes: String = axes.collect();
        let comment = "axes of the samples, for each coordinate";
        own.push(Card::new(GRID_LINES, axes, comment).map_err(bad_card(path))?);
        own.push(Card::comment(&format!(
            "The samples were on a grid with {} coordinates in x and {} in y. A gridded library needs equal coordinates along \
             both axes, so this file uses all of them along x and along y. Its planes are interpolated bilinearly from the samples.",
            square.xs.len(),
            square.ys.len()
        )));
    }
    Ok(own)
}

/// Makes `DET_YXn = '(y, x)'`. With three digits or more, the keyword is too long for a plain card.
/// The card is then one of ESO's HIERARCH cards, as in astropy.
fn position_card(plane: usize, x: f64, y: f64) -> Card {
    let keyword = format!("{POSITION}{plane}");
    // The format `:?` writes a decimal point in every number, as Python does.
    let text = format!("({y:?}, {x:?})");
    if keyword.len() <= 8 {
        let record = text_records(&keyword, &text, "(y, x) of this plane in detector pixels");
        return Card::from_record(record[0]);
    }
    Card::from_record(padded(format!("HIERARCH {keyword} = '{text}'").as_bytes()))
}

/// The largest number of planes if some of them must be interpolated. More planes would be slow to
/// read, because readers process a card for each plane.
const MAX_PLANES: usize = 10_000;

/// A grid whose lines have the same coordinates in x and in y, and the samples from which the stamp
/// at each crossing is interpolated.
#[derive(Debug)]
struct SquareGrid {
    /// The x coordinates of the samples, ascending.
    xs: Vec<f64>,
    /// The y coordinates of the samples, ascending.
    ys: Vec<f64>,
    /// The sample at each crossing of `ys` and `xs`, with x fastest.
    sample_at: Vec<usize>,
    /// All coordinates of `xs` and `ys`, ascending.
    lines: Vec<f64>,
    /// The position of a single sample, which is written as a single plane.
    single: Option<Position>,
}

impl SquareGrid {
    fn of(samples: &PsfSamples) -> Result<Self, String> {
        let positions = samples.positions().as_slice();
        let xs = ascending(positions.iter().map(|p| p.x()));
        let ys = ascending(positions.iter().map(|p| p.y()));
        if xs.len().checked_mul(ys.len()) != Some(positions.len()) {
            return Err(format!(
                "the {} samples do not fill a grid of {} x {} lines, but a gridded library needs a stamp at every crossing: \
                 evaluate the PSF on a regular grid first",
                positions.len(),
                xs.len(),
                ys.len()
            ));
        }
        // Positions are distinct, so as many positions as crossings fill all crossings.
        let mut sample_at = vec![0; positions.len()];
        let index = |lines: &[f64], v: f64| lines.partition_point(|&line| line < v);
        for (sample, position) in positions.iter().enumerate() {
            sample_at[index(&ys, position.y()) * xs.len() + index(&xs, position.x())] = sample;
        }
        let lines = ascending(xs.iter().chain(&ys).copied());
        let grid = Self {
            single: (positions.len() == 1).then(|| positions[0]),
            xs,
            ys,
            sample_at,
            lines,
        };
        match grid.planes() {
            planes if planes > MAX_PLANES && grid.is_refined() => Err(format!(
                "the samples have different coordinates in x and in y, so the library would need {planes} planes (at most {MAX_PLANES} are possible): evaluate the PSF on \
                 a grid with the same coordinates in x and y"
            )),
            _ => Ok(grid),
        }
    }

    /// Number of planes, one per crossing.
    fn planes(&self) -> usize {
        match self.single {
            Some(_) => 1,
            None => self.lines.len() * self.lines.len(),
        }
    }

    /// Returns whether some crossings have no sample.
    fn is_refined(&self) -> bool {
        self.planes() != self.sample_at.len()
    }

    /// The position (x, y) of a plane. x is fastest.
    fn position(&self, plane: usize) -> (f64, f64) {
        match self.single {
            Some(position) => (position.x(), position.y()),
            None => (
                self.lines[plane % self.lines.len()],
                self.lines[plane / self.lines.len()],
            ),
        }
    }

    /// The planes in the order of their cards in the header, with y fastest.
    fn card_order(&self) -> impl Iterator<Item = usize> {
        let side = match self.single {
            Some(_) => 1,
            None => self.lines.len(),
        };
        (0..self.planes()).map(move |place| place % side * side + place / side)
    }

    /// The stamp `[y, x]` of a plane.
    fn stamp(&self, samples: &PsfSamples, plane: usize) -> Array2<f64> {
        let mut stamp = Array2::zeros(samples.grid().dim());
        let (x, y) = self.position(plane);
        let ((left, right, u), (low, high, v)) = (between(&self.xs, x), between(&self.ys, y));
        let corners = [
            (left, low, (1.0 - u) * (1.0 - v)),
            (right, low, u * (1.0 - v)),
            (left, high, (1.0 - u) * v),
            (right, high, u * v),
        ];
        for (i, j, weight) in corners {
            // A stamp at a sample stays equal to the sample, bit by bit.
            if weight != 0.0 {
                let sample = self.sample_at[j * self.xs.len() + i];
                stamp.scaled_add(weight, &samples.stamp(sample));
            }
        }
        stamp
    }
}

/// The indices of the lines below and above a value, and the weight of the line above. Beyond the
/// outermost lines, the nearest line has all the weight.
fn between(lines: &[f64], value: f64) -> (usize, usize, f64) {
    let above = lines.partition_point(|&line| line < value).min(lines.len() - 1);
    let below = above.saturating_sub(1);
    let weight = if above == below || value >= lines[above] {
        1.0
    } else {
        (value - lines[below]) / (lines[above] - lines[below])
    };
    (below, above, weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_lies_on_a_line_between_two_or_on_the_nearest_outside() {
        let lines = [1.0, 2.0, 6.0];
        let found = |value| {
            let (below, above, weight) = between(&lines, value);
            lines[below] * (1.0 - weight) + lines[above] * weight
        };
        for (value, expected) in [
            (-3.0, 1.0),
            (1.0, 1.0),
            (1.25, 1.25),
            (2.0, 2.0),
            (5.0, 5.0),
            (6.0, 6.0),
            (9.0, 6.0),
        ] {
            assert!(
                (found(value) - expected).abs() < 1e-15,
                "{value}: {}",
                found(value)
            );
        }
        let (_, above, weight) = between(&lines, 2.0);
        assert_eq!((above, weight), (1, 1.0));
        assert_eq!(between(&[4.0], 7.0).2, 1.0);
    }
}
