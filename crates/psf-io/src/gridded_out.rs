//! Gridded PSF libraries out.

mod square_grid;

use std::path::Path;

use psf_types::{PsfSamples, StampGrid, StampInterpolation};

use crate::card::Card;
use crate::card_text::text_records;
use crate::error::{bad_card, unsuitable};
use crate::gridded_psf::middle;
use crate::image::cards;
use crate::new_fits::{write_fits, write_image_header};
use crate::stpsf::{PLANE_ORDER, POSITION};
use crate::{GriddedError, HeaderCards, IoError};

use square_grid::SquareGrid;

/// The narrowest stamp that a cubic spline goes through.
const MIN_SIZE: usize = 4;

/// Writes samples on a grid as a gridded PSF library in the [layout of STPSF](crate::stpsf), for photutils
/// (`GriddedPSFModel.read(name, format="webbpsf")`) and this project; returns the number of planes written.
///
/// Values are written as they are, in double precision. `cards` are added to the header, ahead of the layout's own.
///
/// # Planes
/// Releases of photutils disagree on how positions belong to planes. Up to 3.0 the `i`-th card in the header belongs to plane `i`, and its
/// two numbers are taken as (x, y); in later ones `DET_YXi` belongs to it, and they are taken as (y, x), as written. Both read a
/// library alike when x and y of its grid have the same values and the cards stand in a certain order, so it is written like
/// that.
///
/// A grid with other values in x than in y gets more planes: one at every crossing of all these values, bilinear between
/// the samples and constant outside them. Readers interpolate the same way, so that the PSF stays the same everywhere.
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
/// [`IoError::Library`] for what the layout or its readers cannot hold: samples that are not on a grid, an oversampling that is not
/// a whole number, stamps that are not centred in their middle, without pixel response, with another rule than the cubic
/// spline between their pixels, or smaller than 4 x 4; [`IoError::Exists`] unless `overwrite`, [`IoError::MissingDirectory`], or what
/// the file system and CFITSIO report.
pub fn write_gridded(
    path: impl AsRef<Path>,
    samples: &PsfSamples,
    cards: &[Card],
    overwrite: bool,
) -> Result<usize, IoError> {
    let path = path.as_ref();
    let oversampling = check(samples.grid()).map_err(unsuitable(path))?;
    let square = SquareGrid::of(samples).map_err(unsuitable(path))?;
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
        write_image_header::<f64>(fits, &[planes, ny, nx], &header)?;
        // Plane by plane: there may be many more than samples.
        (0..planes).try_for_each(|plane| {
            let stamp = square.stamp(samples, plane);
            let values = stamp.as_slice().expect("a new array is row-major");
            fits.write_pixels(plane * ny * nx, values)
        })
    })?;
    Ok(planes)
}

/// The oversampling as a whole number, where the layout can hold stamps of this grid.
fn check(grid: StampGrid) -> Result<usize, GriddedError> {
    let oversampling = grid.oversampling();
    // Beyond 2^31 readers would not take it for a whole number either.
    if oversampling.fract() != 0.0 || oversampling > f64::from(i32::MAX) {
        return Err(GriddedError::FractionalOversampling { got: oversampling });
    }
    if grid.nx() < MIN_SIZE || grid.ny() < MIN_SIZE {
        return Err(GriddedError::SmallStamps {
            nx: grid.nx(),
            ny: grid.ny(),
        });
    }
    let middle = (middle(grid.nx()), middle(grid.ny()));
    if (grid.centre_x(), grid.centre_y()) != middle {
        return Err(GriddedError::OffCentre {
            x: grid.centre_x(),
            y: grid.centre_y(),
            middle,
        });
    }
    if !grid.pixel_response_included() {
        return Err(GriddedError::PixelResponseMissing);
    }
    if grid.interpolation() != StampInterpolation::CubicSpline {
        return Err(GriddedError::StampInterpolation {
            got: grid.interpolation().to_string(),
        });
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
        own.push(Card::comment(&format!(
            "The samples lay on a grid of {} x {} with other values in x than in y. The planes are theirs, and bilinear between them, \
             at every crossing of all these values.",
            square.columns(),
            square.rows()
        )));
    }
    Ok(own)
}

/// `DET_YXn = '(y, x)'`; numbers of three digits are too long for a plain keyword and become one of ESO's HIERARCH cards, as astropy
/// writes them.
fn position_card(plane: usize, x: f64, y: f64) -> Card {
    let keyword = format!("{POSITION}{plane}");
    // Debug gives numbers a point, as Python does.
    let text = format!("({y:?}, {x:?})");
    if keyword.len() <= 8 {
        let record = text_records(&keyword, &text, "(y, x) of this plane in detector pixels");
        return Card::from_record(record[0]);
    }
    Card::from_record(crate::card_text::padded(
        format!("HIERARCH {keyword} = '{text}'").as_bytes(),
    ))
}
