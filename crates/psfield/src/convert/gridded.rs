//! Converts a PSF to a gridded library.

use conv_core::{edge_reach, resample_samples};
use ndarray::Array2;
use psf_types::{Interpolation, Position, PsfSamples, StampGrid, StampInterpolation};

use super::samples::{SamplesAt, relative_error, to_samples, with_centre_in_the_middle};
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Psf;

const FORMAT: &str = "a gridded library";
/// The smallest number of nodes along each axis of a grid for which the caller gives no size.
const NODES: usize = 11;

/// PSFs on a regular grid, and the error of their bilinear interpolation relative to the PSF from
/// which they were made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GriddedConversion {
    /// The PSFs. As [`psf_io::write_gridded`] requires, the oversampling is a whole number, and the
    /// centre of the stamps is in their middle.
    pub samples: PsfSamples,
    /// The largest relative L2 error of the bilinear interpolation that readers of the file use. It
    /// is measured in the middle of each cell, relative to the source. None if the source is itself
    /// interpolated bilinearly between these nodes.
    pub max_error: Option<f64>,
    /// Notes on the conversion, in plain sentences.
    pub notes: Vec<String>,
}

/// Converts a PSF to PSFs on a regular grid of positions, as in libraries of ePSFs. photutils
/// (`GriddedPSFModel`) and others interpolate bilinearly between the nodes.
///
/// With [`SamplesAt::Own`], a PSF whose samples or nodes form such a grid keeps their positions, if
/// it is interpolated bilinearly or bicubically. Any other PSF is evaluated on a new square grid.
/// The new grid has at least 11 x 11 nodes, and at least as many nodes as the PSF has samples.
/// Stamps with a fractional oversampling are resampled to the next whole number.
///
/// # Errors
/// [`ErrorKind::Format`] for positions that form no grid, or for stamps whose centre lies between
/// pixels but not in the middle of the stamp. Other errors are the errors of [`to_samples`].
pub fn to_gridded(psf: &Psf, at: &SamplesAt) -> Result<GriddedConversion, PsfieldError> {
    let mut notes = Vec::new();
    let on_grid = is_on_grid(psf);
    let nodes = match at {
        SamplesAt::Own if !on_grid => {
            let n = (psf.positions().len() as f64).sqrt().ceil() as usize;
            let n = n.max(NODES);
            notes.push(format!("the PSF was evaluated on a grid of {n} x {n} positions"));
            SamplesAt::Grid { nx: n, ny: n }
        }
        other => other.clone(),
    };
    let samples = to_samples(psf, &nodes)?;
    if !is_grid(&samples) {
        let message = format!(
            "{FORMAT} cannot hold positions that are not a regular grid of at least 2 x 2: choose a grid"
        );
        return Err(PsfieldError::new(ErrorKind::Format, message).with_setting("at"));
    }
    let max_error = if interpolation_of(psf) == Interpolation::Bilinear && nodes == SamplesAt::Own {
        None
    } else {
        Some(midway_error(psf, &samples)?)
    };
    let samples = resampled(samples, &mut notes)?;
    let samples = if is_centred(samples.grid()) {
        samples
    } else {
        with_centre_in_the_middle(samples, FORMAT)?
    };
    Ok(GriddedConversion {
        samples,
        max_error,
        notes,
    })
}

/// Returns whether the PSF is interpolated between samples or nodes on a grid. If so,
/// [`to_gridded`] with [`SamplesAt::Own`] keeps their positions.
pub fn is_on_grid(psf: &Psf) -> bool {
    psf.positions().len() >= 4 && needs_grid(interpolation_of(psf))
}

/// The interpolation of a PSF. The local method if it is one that depends on all samples.
fn interpolation_of(psf: &Psf) -> Interpolation {
    let choice = match (psf.samples(), psf.stored()) {
        (Some((_, options)), _) => options.interpolation,
        (None, Some(record)) => record.interpolation(),
        (None, None) => Interpolation::Nearest,
    };
    match choice {
        Interpolation::Auto | Interpolation::Kriging(_) => coeff_field::local_method(psf.positions()),
        named => named,
    }
}

fn needs_grid(interpolation: Interpolation) -> bool {
    matches!(interpolation, Interpolation::Bilinear | Interpolation::Bicubic)
}

fn is_grid(samples: &PsfSamples) -> bool {
    needs_grid(coeff_field::local_method(samples.positions()))
}

/// Returns the largest relative L2 error of the bilinear interpolation in the middle of the grid's
/// cells. Stamps are compared at the source's own sampling.
fn midway_error(psf: &Psf, nodes: &PsfSamples) -> Result<f64, PsfieldError> {
    let distinct = |of: fn(Position) -> f64| {
        let mut values: Vec<f64> = nodes.positions().as_slice().iter().map(|&p| of(p)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let (columns, rows) = (distinct(Position::x), distinct(Position::y));
    let stamp_at = |x: f64, y: f64| {
        let found = nodes
            .positions()
            .as_slice()
            .iter()
            .position(|p| p.x() == x && p.y() == y);
        nodes.stamp(found.expect("a grid has a node where a column crosses a row"))
    };
    let model = psf.model()?;
    let mut largest = 0.0_f64;
    for y in rows.windows(2) {
        for x in columns.windows(2) {
            let mut mean = Array2::<f64>::zeros(nodes.grid().dim());
            for (cx, cy) in [(x[0], y[0]), (x[1], y[0]), (x[0], y[1]), (x[1], y[1])] {
                mean.scaled_add(0.25, &stamp_at(cx, cy));
            }
            let middle = Position::new(f64::midpoint(x[0], x[1]), f64::midpoint(y[0], y[1]))?;
            let truth = model.psf_at(middle)?;
            largest = largest.max(relative_error(mean.view(), truth.values()));
        }
    }
    Ok(largest)
}

/// Resamples PSFs to the next whole oversampling that is not coarser, and sets their interpolation
/// to a cubic spline.
fn resampled(samples: PsfSamples, notes: &mut Vec<String>) -> Result<PsfSamples, PsfieldError> {
    let grid = samples.grid();
    let whole = grid.oversampling().ceil();
    if whole == grid.oversampling() {
        if grid.interpolation() == StampInterpolation::CubicSpline {
            return Ok(samples);
        }
        notes.push(
            "readers of gridded libraries interpolate between the stamps' pixels by a cubic spline, not by the source's \
             Lanczos kernel"
                .to_owned(),
        );
        return by_spline(&samples);
    }
    let ratio = whole / grid.oversampling();
    let beyond = edge_reach(None, samples.stamps(), None, grid) as f64;
    let reach =
        |centre: f64, n: usize| ((centre.max((n - 1) as f64 - centre) + beyond) * ratio).floor() as usize;
    let (rx, ry) = (
        reach(grid.centre_x(), grid.nx()),
        reach(grid.centre_y(), grid.ny()),
    );
    // A missing pixel response is not added here: the writer refuses stamps without it.
    let target = StampGrid::new(2 * rx + 1, 2 * ry + 1)?
        .with_oversampling(whole)?
        .with_pixel_response_included(grid.pixel_response_included());
    notes.push(format!(
        "the stamps were resampled from {:.6} to {whole} pixels per frame pixel, because libraries need a whole number",
        grid.oversampling()
    ));
    by_spline(&resample_samples(&samples, target)?)
}

/// Sets the interpolation of the stamps to a cubic spline.
fn by_spline(samples: &PsfSamples) -> Result<PsfSamples, PsfieldError> {
    let grid = samples.grid().with_interpolation(StampInterpolation::CubicSpline);
    let (stamps, positions) = (samples.stamps().to_owned(), samples.positions().clone());
    Ok(PsfSamples::new(stamps, positions, grid)?)
}

/// Returns whether the centre is the middle of the stamp. The middle may lie between pixels.
fn is_centred(grid: StampGrid) -> bool {
    let middle = |n: usize| (n - 1) as f64 / 2.0;
    (grid.centre_x(), grid.centre_y()) == (middle(grid.nx()), middle(grid.ny()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::FitOptions;
    use crate::psf::record_of_psfex;
    use ndarray::Array3;
    use psf_io::{PsfexAxis, PsfexModel, PsfexPolynomial};
    use psf_types::{Normalisation, SamplePositions};

    fn gauss(sigma: f64, oversampling: f64, dx: f64) -> f64 {
        (-0.5 * (dx / (sigma * oversampling)).powi(2)).exp()
    }

    fn psfex(sampling: f64) -> PsfexModel {
        let axis = |name| PsfexAxis::new(name, 500.0, 1000.0).unwrap();
        let polynomial = PsfexPolynomial::new(axis("X_IMAGE"), axis("Y_IMAGE"), 2).unwrap();
        let planes = Array3::from_shape_fn((6, 25, 25), |(t, y, x)| {
            let r = (x as f64 - 12.0).hypot(y as f64 - 12.0);
            [1.0, 0.1, 0.05, -0.1, 0.03, 0.08][t] * gauss(1.4 + 0.1 * t as f64, 1.0 / sampling, r)
        });
        PsfexModel::new(planes, sampling, Some(polynomial)).unwrap()
    }

    #[test]
    fn a_finer_grid_has_a_smaller_error_and_whole_pixels() {
        let input = Psf::from(record_of_psfex(&psfex(0.6)).unwrap());
        let of = |n| to_gridded(&input, &SamplesAt::Grid { nx: n, ny: n }).unwrap();
        let (coarse, fine) = (of(3), of(9));
        // The error of bilinear interpolation is proportional to the square of the cells' size.
        let ratio = coarse.max_error.unwrap() / fine.max_error.unwrap();
        assert!((10.0..25.0).contains(&ratio), "{ratio}");
        assert_eq!(fine.samples.grid().oversampling(), 2.0);
        let (ny, nx) = fine.samples.grid().dim();
        assert!(nx % 2 == 1 && fine.samples.grid().whole_centre() == Some((nx / 2, ny / 2)));
        assert!(fine.notes[0].contains("resampled"), "{:?}", fine.notes);
        // Resampling keeps the unit flux of a well sampled PSF.
        assert!(
            (fine.samples.flux(40) - 1.0).abs() < 1e-3,
            "{}",
            fine.samples.flux(40)
        );
        let auto = to_gridded(&input, &SamplesAt::Own).unwrap();
        assert_eq!(auto.samples.len(), NODES * NODES);
    }

    #[test]
    fn a_grid_of_samples_stays_as_it_is_and_scattered_ones_become_one() {
        let grid = StampGrid::new(7, 7).unwrap().with_oversampling(4.0).unwrap();
        let of = |positions: Vec<Position>| {
            let stamps = Array3::from_shape_fn((positions.len(), 7, 7), |(j, y, x)| {
                gauss(
                    1.0 + 0.01 * positions[j].x(),
                    1.0,
                    (x as f64 - 3.0).hypot(y as f64 - 3.0),
                )
            });
            let positions = SamplePositions::new(positions, None).unwrap();
            let options = FitOptions {
                normalisation: Normalisation::Keep,
                ..FitOptions::default()
            };
            Psf::new(PsfSamples::new(stamps, positions, grid).unwrap(), options)
        };
        let regular = of([(0, 0), (50, 0), (0, 40), (50, 40)]
            .map(|(x, y)| Position::of_pixel(x, y))
            .into());
        let same = to_gridded(&regular, &SamplesAt::Own).unwrap();
        let before = regular.samples().expect("made of samples").0.clone();
        assert_eq!(
            (same.samples, same.max_error, same.notes.len()),
            (before, None, 0)
        );
        let scattered = of([(0, 0), (50, 3), (7, 40), (50, 40), (20, 20)]
            .map(|(x, y)| Position::of_pixel(x, y))
            .into());
        let made = to_gridded(&scattered, &SamplesAt::Own).unwrap();
        assert_eq!(made.samples.len(), NODES * NODES);
        let own = scattered.positions().as_slice().to_vec();
        let error = to_gridded(&scattered, &SamplesAt::Positions(own)).unwrap_err();
        assert_eq!((error.kind(), error.setting()), (ErrorKind::Format, Some("at")));
    }
}
