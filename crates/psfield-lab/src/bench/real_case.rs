//! The cases of the benchmark of real work: groups, PSFs and frames.

use std::fmt;

use psf_types::{FrameShape, Interpolation, PsfModelRecord, named};
use psfield::convert::to_psfex;
use psfield::evaluate::EvaluateOptions;
use psfield::psf::record_of_psfex;
use psfield::psf_basis::RankSelection;
use psfield::{FitOptions, Psf, PsfieldError};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::bench::case::{interpolated_by, random_position, stretched};
use crate::bench::real_colours::KELVINS;

/// Cases that differ in one amount. Written as the name in lower case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum RealGroup {
    /// Frames of several sizes through every PSF. Every pixel is lit.
    Pixels,
    /// Frames in which a part of the pixels is lit, chosen at random one by one. No part of the
    /// frame is empty, unless the whole frame is.
    Light,
    /// Stars of a catalogue between pixels.
    Stars,
    /// Galaxies of a catalogue, with half-light radii that are log-normal about 1.5 pixels and
    /// Sersic indices of 0.5 to 4.
    Galaxies,
    /// Stars and galaxies of a catalogue, as many of each, with fluxes over six powers of ten. The amount is the
    /// floor ([`SimulateOptions::floor`](psfield::SimulateOptions::floor)).
    Floor,
    /// Frames in which every pixel is lit, through a PSF with wings of 1023 pixels. The amount is the number of
    /// stamps of the wings.
    Wings,
    /// Stars of a catalogue that are simulated and exposed, each of the same expected number of photons.
    /// [`ShootBelow::Auto`](psfield::ShootBelow::Auto) chooses how they are drawn.
    StarPhotons,
    /// Like [`StarPhotons`](Self::StarPhotons), with galaxies.
    GalaxyPhotons,
    /// Many small frames with one plan. Every pixel is lit.
    Frames,
    /// Small frames, each with a PSF field of its own on one basis. They are parts of larger frames, with
    /// four times their side. Every pixel is lit.
    Fields,
    /// Frames of several sizes with the light of black bodies at several temperatures. The light of
    /// each has an image of its own, in which every pixel is lit.
    Colours,
    /// A series of exposures with every pixel lit. The PSF changes with time, and the telescope drifts
    /// and jitters.
    Series,
    /// Such a series with stars of a catalogue.
    StarSeries,
}

/// The side of the frames of which those of [`RealGroup::Fields`] are a part, in sides of the parts.
const FIELD: usize = 4;

named!(
    RealGroup, "group of cases",
    "pixels, light, stars, galaxies, floor, wings, starphotons, galaxyphotons, frames, fields, colours, series or starseries",
    "pixels" => Pixels, "light" => Light, "stars" => Stars, "galaxies" => Galaxies, "floor" => Floor,
    "wings" => Wings, "starphotons" => StarPhotons, "galaxyphotons" => GalaxyPhotons,
    "frames" => Frames, "fields" => Fields, "colours" => Colours, "series" => Series, "starseries" => StarSeries
);

/// A PSF over a frame, made from a model on a regular grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RealPsf {
    /// The model on its grid. It is interpolated bilinearly.
    Grid,
    /// The model on its grid, with bicubic interpolation.
    Bicubic,
    /// A PSFEx model of this degree, fitted to the PSFs on the grid.
    Psfex(usize),
    /// PSFs at 500 random positions (fewer if the grid has fewer), interpolated by natural
    /// neighbours.
    Scattered,
    /// The PSFs of black bodies in a wide band, from the optics of the survey telescope at several
    /// wavelengths.
    Spectra,
    /// The PSFs of the survey telescope at several times, with oversampled stamps.
    Times,
}

impl fmt::Display for RealPsf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Grid => f.write_str("grid"),
            Self::Bicubic => f.write_str("grid, bicubic"),
            Self::Psfex(degree) => write!(f, "psfex, degree {degree}"),
            Self::Scattered => f.write_str("scattered"),
            Self::Spectra => f.write_str("spectra"),
            Self::Times => f.write_str("times"),
        }
    }
}

/// The largest number of scattered samples.
const SCATTERED: usize = 500;

impl RealPsf {
    /// Makes the model of this PSF over a frame. `grid` is stretched to the frame. Those of
    /// [`Spectra`](Self::Spectra) and [`Times`](Self::Times) have the PSFs of all spectra and times.
    pub(super) fn record(
        self,
        grid: &PsfModelRecord,
        frame: FrameShape,
        rng: &mut ChaCha8Rng,
    ) -> Result<PsfModelRecord, PsfieldError> {
        let grid = stretched(grid, frame)?;
        match self {
            Self::Grid | Self::Spectra | Self::Times => Ok(grid),
            Self::Bicubic => Ok(interpolated_by(&grid, Interpolation::Bicubic)?),
            Self::Psfex(degree) => record_of_psfex(&to_psfex(&grid.into(), Some(degree))?.model),
            Self::Scattered => {
                let count = SCATTERED.min(grid.coefficients().positions().len());
                let positions = (0..count).map(|_| random_position(frame, rng));
                let positions = positions.collect::<Result<_, _>>()?;
                let rank = grid.basis().rank();
                let samples = Psf::from(grid).evaluate(positions, EvaluateOptions::default())?;
                let options = FitOptions {
                    rank: RankSelection::Full,
                    interpolation: Interpolation::NaturalNeighbour,
                    ..FitOptions::default()
                };
                Ok(Psf::new(samples, options).record()?.truncated(rank)?)
            }
        }
    }
}

/// A case of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RealCase {
    /// The group.
    pub group: RealGroup,
    /// The PSF.
    pub psf: RealPsf,
    /// Columns and rows of a frame.
    pub side: usize,
    /// The amount in which the cases of the group differ, in the [`unit`](RealGroup::unit) of the
    /// group.
    pub amount: f64,
}

impl RealGroup {
    /// The unit of [`RealCase::amount`].
    pub fn unit(self) -> &'static str {
        match self {
            Self::Pixels => "pixels",
            Self::Light => "% lit",
            Self::Stars => "stars",
            Self::Galaxies => "galaxies",
            Self::Floor => "floor",
            Self::Wings => "stamps of the wings",
            Self::StarPhotons | Self::GalaxyPhotons => "photons each",
            Self::Frames | Self::Fields => "frames",
            Self::Colours => "spectra",
            Self::Series | Self::StarSeries => "exposures",
        }
    }

    /// The cases of the group. `sizes` are the sides of the frames of [`Pixels`](Self::Pixels) and
    /// [`Colours`](Self::Colours). The frames of the other groups are at most as large as the
    /// largest of them. `quick` chooses a few small amounts.
    pub fn cases(self, sizes: &[usize], quick: bool) -> Vec<RealCase> {
        const PSFS: [RealPsf; 5] = [
            RealPsf::Grid,
            RealPsf::Bicubic,
            RealPsf::Psfex(2),
            RealPsf::Psfex(3),
            RealPsf::Scattered,
        ];
        let largest = sizes.iter().copied().max();
        let case = |psf, side, amount| RealCase {
            group: self,
            psf,
            side,
            amount,
        };
        let (side, amounts, quick_amounts): (usize, &[f64], &[f64]) = match self {
            Self::Pixels => {
                let of_psf = |psf| {
                    let cases = sizes.iter();
                    cases.map(move |&side| case(psf, side, (side * side) as f64))
                };
                return PSFS.into_iter().flat_map(of_psf).collect();
            }
            Self::Colours => {
                let spectra = KELVINS.len() as f64;
                let cases = sizes.iter();
                return cases.map(|&side| case(RealPsf::Spectra, side, spectra)).collect();
            }
            Self::Fields => {
                let side = largest.map_or(256, |largest| largest.min(256));
                let amount = if quick { 4.0 } else { 100.0 };
                return PSFS.map(|psf| case(psf, side, amount)).to_vec();
            }
            Self::Series | Self::StarSeries => {
                let side = largest.map_or(2048, |largest| largest.min(2048));
                return vec![case(RealPsf::Times, side, if quick { 4.0 } else { 100.0 })];
            }
            Self::Light => (4096, &[0.0, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0], &[0.0, 3.0, 100.0]),
            Self::Stars => (9216, &[1e3, 1e4, 1e5, 1e6, 1e7], &[1e3]),
            Self::Galaxies => (4096, &[1e3, 1e4, 1e5], &[10.0]),
            Self::Floor => (4096, &[0.0, 0.01, 0.1, 1.0, 10.0], &[0.0, 1.0]),
            Self::Wings => (4096, &[0.0, 1.0, 2.0, 3.0, 4.0], &[0.0, 2.0]),
            Self::StarPhotons | Self::GalaxyPhotons => {
                (4096, &[3.0, 10.0, 30.0, 100.0, 300.0, 1000.0], &[3.0, 300.0])
            }
            Self::Frames => (256, &[1000.0], &[10.0]),
        };
        let amounts = if quick { quick_amounts } else { amounts };
        let side = side.min(largest.unwrap_or(side));
        let case = |&amount| case(RealPsf::Scattered, side, amount);
        amounts.iter().map(case).collect()
    }
}

impl RealCase {
    /// Columns and rows of the frame to which the field of the telescope is stretched.
    pub(super) fn field_side(&self) -> usize {
        match self.group {
            RealGroup::Fields => FIELD * self.side,
            _ => self.side,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [RealGroup; 13] = [
        RealGroup::Pixels,
        RealGroup::Light,
        RealGroup::Stars,
        RealGroup::Galaxies,
        RealGroup::Floor,
        RealGroup::Wings,
        RealGroup::StarPhotons,
        RealGroup::GalaxyPhotons,
        RealGroup::Frames,
        RealGroup::Fields,
        RealGroup::Colours,
        RealGroup::Series,
        RealGroup::StarSeries,
    ];

    #[test]
    fn frames_are_no_larger_than_the_largest_size() {
        let sides = |sizes: &[usize]| {
            let cases = ALL.map(|group| group.cases(sizes, false));
            cases.map(|cases| cases.iter().map(|case| case.side).max().unwrap())
        };
        assert_eq!(
            sides(&[1024, 9216]),
            [
                9216, 4096, 9216, 4096, 4096, 4096, 4096, 4096, 256, 256, 9216, 2048, 2048
            ]
        );
        assert_eq!(sides(&[200, 100]), [200; 13]);
        let names = ALL.map(|group| group.to_string().parse::<RealGroup>());
        assert_eq!(names.map(Result::unwrap), ALL);
    }
}
