//! A PSF library in memory, and access to the cards of its header.

use std::collections::HashMap;
use std::path::Path;

use ndarray::{Array3, Axis};
use psf_types::{DataError, Position, PsfSamples, SamplePositions, StampGrid};

use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::card::{Card, FromValue};
use crate::fits::hdu::Hdu;
use crate::fits::image::stack_shape;

/// PSFs at positions on one detector, read from a library of [STPSF](crate::stpsf) or
/// [STDPSF](crate::stdpsf).
///
/// - [`samples`](Self::samples): positions are 0-based pixels of the detector. The reference point
///   of the stamps is their middle, index `(n - 1) / 2`. The stamps include the pixel response.
///   Between their pixels the interpolating cubic spline applies. The values are the values in the
///   file, not scaled to unit flux.
/// - photutils' `GriddedPSFModel` interpolates bilinearly between the positions. Outside their grid
///   it uses the PSF at the nearest point of the grid. In psfield these choices are named
///   [`Interpolation::Bilinear`](psf_types::Interpolation::Bilinear) and
///   [`OutsidePolicy::Nearest`](psf_types::OutsidePolicy::Nearest).
#[derive(Debug, Clone, PartialEq)]
pub struct GriddedPsf {
    samples: PsfSamples,
    detector: Option<String>,
    notes: Vec<String>,
    left_out: Vec<usize>,
}

/// The content of a library as a reader found it.
pub(crate) struct Planes {
    /// `[sample, y, x]`.
    pub(crate) stamps: Array3<f64>,
    /// The plane of the file from which each sample comes.
    pub(crate) numbers: Vec<usize>,
    pub(crate) positions: Vec<Position>,
    pub(crate) oversampling: f64,
    pub(crate) detector: Option<String>,
    pub(crate) notes: Vec<String>,
}

/// The number of invalid planes that a note lists.
const LISTED: usize = 5;

impl GriddedPsf {
    /// Makes a library from the planes of a file. A plane without positive flux is an error, or is
    /// left out if `skip_invalid` is true and other planes are valid.
    pub(crate) fn new(path: &Path, mut planes: Planes, skip_invalid: bool) -> Result<Self, IoError> {
        let (count, ny, nx) = planes.stamps.dim();
        let grid = centred_grid(nx, ny, planes.oversampling).map_err(invalid(path))?;
        let dark: Vec<(usize, f64)> = without_flux(&planes.stamps, grid).collect();
        let named = |&(sample, flux): &(usize, f64)| {
            let (number, position) = (planes.numbers[sample], planes.positions[sample]);
            format!("plane {number} (0-based) at {position} has flux {flux}")
        };
        if let Some(first) = dark.first()
            && (!skip_invalid || dark.len() == count)
        {
            let problem = format!("{}: a PSF must have positive flux", named(first));
            let error = |problem| IoError::new(path, IoErrorKind::Data, problem);
            return Err(if dark.len() == count {
                error(format!("{problem}. No plane of the library has positive flux"))
            } else {
                error(format!(
                    "{problem}. Leave invalid planes out to read the other planes"
                ))
                .with_setting("skip_invalid")
            });
        }
        let left_out: Vec<usize> = dark.iter().map(|&(sample, _)| planes.numbers[sample]).collect();
        if !dark.is_empty() {
            let mut listed: Vec<String> = dark.iter().take(LISTED).map(named).collect();
            if dark.len() > LISTED {
                listed.push(format!("and {} more", dark.len() - LISTED));
            }
            planes.notes.push(format!(
                "planes: {} of {count} left out, because a PSF must have positive flux: {}",
                dark.len(),
                listed.join(", ")
            ));
            let is_valid = |sample: &usize| dark.iter().all(|(dark, _)| dark != sample);
            let valid: Vec<usize> = (0..count).filter(is_valid).collect();
            planes.stamps = planes.stamps.select(Axis(0), &valid);
            planes.positions = valid.iter().map(|&sample| planes.positions[sample]).collect();
        }
        let positions = SamplePositions::new(planes.positions, None).map_err(invalid(path))?;
        Ok(Self {
            samples: PsfSamples::new(planes.stamps, positions, grid).map_err(invalid(path))?,
            detector: planes.detector,
            notes: planes.notes,
            left_out,
        })
    }

    /// The PSFs with their positions.
    pub fn samples(&self) -> &PsfSamples {
        &self.samples
    }

    /// Notes for the user on how the file was read, in plain sentences: the order of the planes,
    /// the chosen detector, bad border rows, planes that were left out.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The planes of the file (0-based) that were left out because they have no positive flux.
    pub fn left_out(&self) -> &[usize] {
        &self.left_out
    }

    /// Returns the PSFs with their positions without a copy.
    pub fn into_samples(self) -> PsfSamples {
        self.samples
    }

    /// The name of the detector, if the file states it.
    pub fn detector(&self) -> Option<&str> {
        self.detector.as_deref()
    }
}

/// The index of the middle of `n` pixels.
pub(crate) fn middle(n: usize) -> f64 {
    (n as f64 - 1.0) / 2.0
}

/// The distinct values in ascending order.
pub(crate) fn ascending(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// The grid of stamps whose reference point is in the middle.
pub(crate) fn centred_grid(nx: usize, ny: usize, oversampling: f64) -> Result<StampGrid, DataError> {
    StampGrid::new(nx, ny)?
        .with_centre(middle(nx), middle(ny))?
        .with_oversampling(oversampling)
}

/// The shape `(planes, ny, nx)` of a cube. An image is a cube of one plane.
pub(crate) fn cube_shape(hdu: &Hdu) -> Result<(usize, usize, usize), IoError> {
    stack_shape(hdu, "a cube of PSFs [plane, y, x]")
}

/// Returns the index and the flux of every stamp whose flux is not positive.
fn without_flux(stamps: &Array3<f64>, grid: StampGrid) -> impl Iterator<Item = (usize, f64)> {
    let fluxes = stamps
        .axis_iter(Axis(0))
        .map(move |stamp| grid.flux_of_sum(stamp.sum()));
    fluxes
        .enumerate()
        .filter(|(_, flux)| !(*flux > 0.0 && flux.is_finite()))
}

/// Returns an error for a stamp whose flux is not positive, with the number of its plane in the
/// file.
pub(crate) fn check_flux(
    path: &Path,
    stamps: &Array3<f64>,
    grid: StampGrid,
    plane: impl Fn(usize) -> usize,
) -> Result<(), IoError> {
    match without_flux(stamps, grid).next() {
        Some((sample, flux)) => {
            let plane = plane(sample);
            let problem = format!("plane {plane} (0-based) has flux {flux}: a PSF must have positive flux");
            Err(IoError::new(path, IoErrorKind::Data, problem))
        }
        None => Ok(()),
    }
}

/// The header of an HDU, for keywords that are built at run time, such as numbered ones.
///
/// Case is ignored in keywords, because real STDPSF files have `NXPSFs`.
#[derive(Debug)]
pub(crate) struct LibraryCards<'a> {
    pub(crate) hdu: &'a Hdu,
    /// The first card of each keyword, in a hash table because long headers are searched for many
    /// keywords.
    cards: HashMap<String, &'a Card>,
}

impl<'a> LibraryCards<'a> {
    pub(crate) fn new(hdu: &'a Hdu) -> Self {
        let mut cards = HashMap::new();
        for card in &hdu.header {
            cards.entry(card.keyword().to_ascii_uppercase()).or_insert(card);
        }
        Self { hdu, cards }
    }

    /// The value of a keyword after `convert`, if the keyword exists. A value that `convert`
    /// rejects is an error.
    fn optional<V: FromValue, T>(
        &self,
        keyword: &str,
        expected: &str,
        convert: impl FnOnce(V) -> Option<T>,
    ) -> Result<Option<T>, IoError> {
        let Some(card) = self.cards.get(keyword) else {
            return Ok(None);
        };
        match card.value().and_then(V::from_value).and_then(convert) {
            Some(value) => Ok(Some(value)),
            None => Err(self.hdu.wrong_value(keyword, expected, card.shown())),
        }
    }

    /// The finite number in a card, if the keyword exists.
    pub(crate) fn number(&self, keyword: &str, expected: &str) -> Result<Option<f64>, IoError> {
        self.optional(keyword, expected, Some::<f64>)
    }

    /// The finite number in a card. A missing keyword is an error.
    pub(crate) fn required_number(&self, keyword: &str, expected: &str) -> Result<f64, IoError> {
        self.number(keyword, expected)?
            .ok_or_else(|| self.hdu.missing_keyword(keyword, expected))
    }

    /// The whole number in a card, at least `least`, if the keyword exists. It may be written with
    /// a decimal point.
    pub(crate) fn count(
        &self,
        keyword: &str,
        least: usize,
        expected: &str,
    ) -> Result<Option<usize>, IoError> {
        self.optional(keyword, expected, |number: f64| {
            // Above 2^53 not every whole number is a float. No file holds that many of anything.
            let counts = number.fract() == 0.0 && (least as f64..=2_f64.powi(53)).contains(&number);
            counts.then_some(number as usize)
        })
    }

    /// Works like [`count`](Self::count), but a missing keyword is an error.
    pub(crate) fn required_count(
        &self,
        keyword: &str,
        least: usize,
        expected: &str,
    ) -> Result<usize, IoError> {
        self.count(keyword, least, expected)?
            .ok_or_else(|| self.hdu.missing_keyword(keyword, expected))
    }

    /// The string in a card, if the keyword exists.
    pub(crate) fn text(&self, keyword: &str, expected: &str) -> Result<Option<String>, IoError> {
        self.optional(keyword, expected, |text: String| Some(text.trim().to_owned()))
    }

    pub(crate) fn has(&self, keyword: &str) -> bool {
        self.cards.contains_key(keyword)
    }

    /// The error for a number of planes that differs from the number in the cards.
    pub(crate) fn plane_count(&self, planes: usize, cards: &str, stated: &str) -> IoError {
        let problem = format!(
            "there are {planes} planes, but {cards} states {stated}: the file is damaged or of another format"
        );
        self.hdu.error(IoErrorKind::Data, problem)
    }
}
