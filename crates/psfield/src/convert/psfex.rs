//! Converts a PSF to a PSFEx model.

use metrics::GaussianFitter;
use nalgebra::DMatrix;
use ndarray::{Array3, Axis};
use psf_io::{PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial};
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, Position, PsfModelRecord, PsfSamples, StampInterpolation,
};

use super::samples::{SamplesAt, relative_error, to_samples, with_centre_in_the_middle};
use crate::error::{ErrorKind, PsfieldError};
use crate::evaluate::{EvaluateOptions, evaluate};
use crate::fit::model_of;
use crate::psf::Psf;

const FORMAT: &str = "a PSFEx file";
/// The names of the coordinates in the file.
const X: &str = "X_IMAGE";
const Y: &str = "Y_IMAGE";
/// Singular values up to this fraction of the largest one count as 0. A singular value of 0 means
/// that the samples do not determine a term.
const DEGENERATE: f64 = 1e-10;

/// A PSFEx model, and its error relative to the PSFs from which it was made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PsfexConversion {
    /// The model, with values in single precision, as in a file.
    pub model: PsfexModel,
    /// Number of PSFs to which the model was fitted: samples, or PSFs of the source model.
    pub samples: usize,
    /// The largest relative L2 error over these PSFs. 0 for a PSFEx model that is not changed.
    pub max_error: f64,
    /// Notes on properties that the file does not hold, in plain sentences.
    pub notes: Vec<String>,
}

/// Converts samples or a model to a PSFEx model. The PSFEx model has one polynomial in x and y, of
/// total degree `degree`, for each pixel of the stamps. If `degree` is None, it is the degree of
/// the source model, which must then be a polynomial model.
///
/// A PSFEx model that was read from a file is returned unchanged if it has this degree. Any other
/// model whose coefficients are polynomials of this degree or a lower one is converted without
/// loss, except for rounding to single precision. Its PSFs are not scaled to unit flux, because
/// readers of PSFEx models do this. All other PSFs are fitted at their own samples or nodes, by
/// least squares.
///
/// Stamps are padded with zeros to an odd size with the centre in the middle. For such stamps,
/// PSFEx and GalSim agree on the centre.
///
/// # Errors
/// [`ErrorKind::Setting`] when no degree is known or the degree is above 10, [`ErrorKind::Fit`]
/// when the samples do not determine a polynomial of this degree, [`ErrorKind::Format`] for stamps
/// without the pixel response or centred between pixels. Other errors are the errors of
/// [`to_samples`].
pub fn to_psfex(psf: &Psf, degree: Option<usize>) -> Result<PsfexConversion, PsfieldError> {
    let own_degree = match psf.stored().map(PsfModelRecord::interpolation) {
        Some(Interpolation::Polynomial { degree }) => Some(degree),
        _ => None,
    };
    let degree = degree.or(own_degree).ok_or_else(|| {
        const NEEDED: &str =
            "the PSF is not a polynomial model, so the degree must be given: choose a total degree in x and y, 0 to 10";
        PsfieldError::of_setting("degree", NEEDED)
    })?;
    if degree > PsfexPolynomial::MAX_DEGREE {
        let message = format!("the degree of a PSFEx model must be 0 to 10, got {degree}");
        return Err(PsfieldError::of_setting("degree", message));
    }
    if !psf.grid().pixel_response_included() {
        let message = format!(
            "{FORMAT} needs stamps that include the pixel response. If these stamps include it, say so with this setting. If not, \
             evaluate the PSF on the native grid first"
        );
        return Err(PsfieldError::new(ErrorKind::Format, message).with_setting("pixel_response_included"));
    }
    if let Some(model) = psf.psfex().filter(|model| model.degree() == degree) {
        return Ok(PsfexConversion {
            model: model.clone(),
            samples: psf.positions().len(),
            max_error: 0.0,
            notes: Vec::new(),
        });
    }
    let notes = notes(psf);
    let samples = match psf.stored() {
        Some(record) if record.wings().is_none() && own_degree.is_some_and(|own| own <= degree) => {
            polynomial_samples(record, degree)?
        }
        _ => to_samples(psf, &SamplesAt::Own)?,
    };
    let samples = with_centre_in_the_middle(samples, FORMAT)?;
    let model = fitted(&samples, degree)?;
    Ok(PsfexConversion {
        max_error: max_error(&model, &samples)?,
        samples: samples.len(),
        model,
        notes,
    })
}

fn notes(psf: &Psf) -> Vec<String> {
    let mut notes = Vec::new();
    if psf.grid().interpolation() != StampInterpolation::Lanczos3 {
        notes.push(
            "readers of PSFEx models interpolate between the stamps' pixels by a Lanczos kernel, not by the source's cubic spline"
                .to_owned(),
        );
    }
    let (outside, normalisation) = match (psf.samples(), psf.stored()) {
        (Some((_, options)), _) => (OutsidePolicy::Extend, options.normalisation),
        (None, Some(record)) => (record.outside(), record.normalisation()),
        (None, None) => (OutsidePolicy::Extend, Normalisation::Keep),
    };
    if outside != OutsidePolicy::Extend {
        notes.push(format!(
            "a PSFEx model continues its polynomial outside the samples: the file does not keep the outside policy \"{outside}\""
        ));
    }
    if normalisation == Normalisation::Keep {
        notes.push(
            "readers of PSFEx models scale PSFs to unit flux: only psfield keeps their flux, if it opens the file with normalisation keep"
                .to_owned(),
        );
    }
    notes
}

/// Returns the unscaled PSFs of a polynomial model, at enough nodes over its area to determine a
/// polynomial of this degree.
fn polynomial_samples(record: &PsfModelRecord, degree: usize) -> Result<PsfSamples, PsfieldError> {
    let [x, y] = Position::bounds(record.coefficients().positions().as_slice());
    let along = |name, (low, high): (f64, f64)| -> Result<_, PsfieldError> {
        let mut nodes = axis(name, (low, high))?.extrema(degree);
        if low < high && degree > 0 {
            // Rounding could move the outermost nodes off the field, which may end there.
            nodes[0] = low;
            nodes[degree] = high;
        }
        Ok(nodes)
    };
    let (columns, rows) = (along(X, x)?, along(Y, y)?);
    let positions: Result<Vec<Position>, _> = rows
        .iter()
        .flat_map(|&y| columns.iter().map(move |&x| Position::new(x, y)))
        .collect();
    let bare = record
        .clone()
        .with_policies(OutsidePolicy::Extend, Normalisation::Keep);
    evaluate(&model_of(bare)?, positions?, EvaluateOptions::default())
}

/// Returns a coordinate whose offset and scale map the range of the samples to -1/2 ... 1/2, as in
/// PSFEx.
fn axis(name: &str, (low, high): (f64, f64)) -> Result<PsfexAxis, PsfieldError> {
    let scale = if low < high { high - low } else { 1.0 };
    Ok(PsfexAxis::new(name, f64::midpoint(low, high), scale)?)
}

/// Fits each pixel by least squares in double precision, then rounds to single.
fn fitted(samples: &PsfSamples, degree: usize) -> Result<PsfexModel, PsfieldError> {
    let [x, y] = Position::bounds(samples.positions().as_slice());
    let polynomial = PsfexPolynomial::new(axis(X, x)?, axis(Y, y)?, degree)?;
    let terms = PsfexPolynomial::term_count(degree);
    let (count, ny, nx) = samples.stamps().dim();
    let undetermined = || {
        let message = format!(
            "a polynomial of degree {degree} in x and y has {terms} terms, which the samples ({count} in all, at these \
             positions) do not determine: choose a lower degree"
        );
        PsfieldError::new(ErrorKind::Fit, message).with_setting("degree")
    };
    if count < terms {
        return Err(undetermined());
    }
    let rows = samples.positions().as_slice().iter();
    let mut design = DMatrix::from_row_iterator(count, terms, rows.flat_map(|&p| polynomial.terms(p)));
    // High powers of coordinates below 1/2 are small. With columns scaled to norm 1, a small
    // singular value means a term that the samples do not determine, not a small power.
    let norms: Vec<f64> = design.column_iter().map(|column| column.norm()).collect();
    if norms.contains(&0.0) {
        return Err(undetermined());
    }
    for (mut column, norm) in design.column_iter_mut().zip(&norms) {
        column /= *norm;
    }
    let svd = design.svd(true, true);
    let limit = DEGENERATE * svd.singular_values.max();
    if svd.singular_values.iter().any(|&value| value <= limit) {
        return Err(undetermined());
    }
    let stamps = samples.stamps();
    let stamps = DMatrix::from_row_slice(count, ny * nx, stamps.as_slice().expect("samples are row-major"));
    let solution = svd.solve(&stamps, 0.0).expect("the SVD has both U and V");
    let planes = Array3::from_shape_fn((terms, ny, nx), |(term, y, x)| {
        f64::from((solution[(term, y * nx + x)] / norms[term]) as f32)
    });
    let sampling = 1.0 / samples.grid().oversampling();
    let model = PsfexModel::new(planes, sampling, Some(polynomial))?;
    let mut figures = PsfexFigures::default();
    // The FWHM is only information for the user. A PSF without a peak has none.
    let fit = GaussianFitter::elliptical().fit(model.planes().index_axis_move(Axis(0), 0));
    figures.fwhm_px = fit.ok().map(|fit| fit.fwhm_px() * sampling);
    (figures.loaded, figures.accepted) = (Some(count as i64), Some(count as i64));
    Ok(model.with_figures(figures))
}

/// The largest relative L2 error over the samples.
fn max_error(model: &PsfexModel, samples: &PsfSamples) -> Result<f64, PsfieldError> {
    let mut largest = 0.0_f64;
    for (&position, truth) in samples
        .positions()
        .as_slice()
        .iter()
        .zip(samples.stamps().outer_iter())
    {
        let found = model.psf_at(position)?;
        largest = largest.max(relative_error(found.values(), truth));
    }
    Ok(largest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::FitOptions;
    use crate::psf::record_of_psfex;
    use psf_types::{FrameShape, SamplePositions, StampGrid};

    /// Error of a sum of values that were rounded to single precision, relative to the peak.
    const SINGLE: f64 = 1e-6;

    /// A Gaussian whose width changes over the field in such a way that no pixel's value is a
    /// polynomial of degree 2.
    fn samples(across: usize, size: usize) -> PsfSamples {
        let positions: Vec<Position> = (0..across * across)
            .map(|i| Position::of_pixel(100 * (i % across) as i64, 80 * (i / across) as i64 + 3))
            .collect();
        let stamps = Array3::from_shape_fn((positions.len(), size, size), |(j, y, x)| {
            let p = positions[j];
            let sigma = 1.5 + p.x() / 2000.0 + (p.y() / 700.0).powi(2);
            let r2 = (x as f64 - (size / 2) as f64).powi(2) + (y as f64 - (size / 2) as f64).powi(2);
            (-0.5 * r2 / (sigma * sigma)).exp()
        });
        let grid = StampGrid::new(size, size)
            .unwrap()
            .with_oversampling(2.0)
            .unwrap();
        let field = FrameShape::new(2000, 2000).ok();
        let positions = SamplePositions::new(positions, field).unwrap();
        PsfSamples::new(stamps, positions, grid).unwrap()
    }

    fn input(samples: PsfSamples) -> Psf {
        Psf::new(samples, FitOptions::default())
    }

    #[test]
    fn the_error_falls_with_the_degree_and_is_the_one_reported() {
        let mut last = f64::INFINITY;
        for degree in 0..=4 {
            let converted = to_psfex(&input(samples(6, 17)), Some(degree)).unwrap();
            assert!(converted.max_error < 0.5 * last, "degree {degree}");
            last = converted.max_error;
            let truth = samples(6, 17).into_unit_flux();
            let mut largest = 0.0f64;
            for (j, &p) in truth.positions().as_slice().iter().enumerate() {
                let difference = converted.model.psf_at(p).unwrap().into_values() - truth.stamp(j);
                let norm = |v: f64| v.sqrt();
                let error =
                    norm(difference.mapv(|v| v * v).sum()) / norm(truth.stamp(j).mapv(|v| v * v).sum());
                largest = largest.max(error);
            }
            assert!((largest / converted.max_error - 1.0).abs() < 1e-9);
        }
        assert!(last < 1e-3, "{last:e}");
    }

    #[test]
    fn a_psfex_model_comes_back_from_its_record_also_at_a_higher_degree() {
        let first = to_psfex(&input(samples(5, 17)), Some(2)).unwrap().model;
        let record = record_of_psfex(&first).unwrap();
        for (degree, terms) in [(None, 6), (Some(2), 6), (Some(3), 10)] {
            let again = to_psfex(&Psf::from(record.clone()), degree).unwrap();
            assert!(again.max_error < SINGLE && again.notes.is_empty());
            assert_eq!(again.model.planes().dim().0, terms);
            for (x, y) in [(0.0, 0.0), (250.0, 1.0), (600.0, -50.0)] {
                let at = Position::new(x, y).unwrap();
                let difference =
                    again.model.psf_at(at).unwrap().into_values() - first.psf_at(at).unwrap().values();
                let peak = first.psf_at(at).unwrap().values()[[8, 8]];
                assert!(
                    difference.iter().all(|d| d.abs() <= SINGLE * peak),
                    "{degree:?} {at}"
                );
            }
        }
        let again = to_psfex(&Psf::from(record), None).unwrap().model;
        let (a, b) = (again.polynomial().unwrap(), first.polynomial().unwrap());
        assert!((a.x().zero() - b.x().zero()).abs() < 1e-9 && (a.y().scale() - b.y().scale()).abs() < 1e-9);
        let difference = again.planes().to_owned() - first.planes();
        assert!(difference.iter().all(|d| d.abs() < SINGLE));
    }

    #[test]
    fn even_stamps_get_their_centre_in_the_middle() {
        let converted = to_psfex(&input(samples(3, 16)), Some(1)).unwrap();
        assert_eq!(converted.model.grid().dim(), (17, 17));
        let psf = converted.model.psf_at(Position::of_pixel(100, 83)).unwrap();
        let peak = psf.values().iter().copied().fold(0.0, f64::max);
        assert_eq!(psf.values()[[8, 8]], peak);
        let fwhm = converted.model.figures().fwhm_px.unwrap();
        assert!((1.5..3.0).contains(&fwhm), "{fwhm} frame pixels");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let error = |psf: &Psf, degree| {
            let error = to_psfex(psf, degree).unwrap_err();
            (error.kind(), error.setting())
        };
        let input_of = |across| input(samples(across, 9));
        assert_eq!(error(&input_of(3), None), (ErrorKind::Setting, Some("degree")));
        for (across, degree) in [(2, 2), (3, 3), (1, 1)] {
            assert_eq!(
                error(&input_of(across), Some(degree)),
                (ErrorKind::Fit, Some("degree"))
            );
        }
        let absurd = (ErrorKind::Setting, Some("degree"));
        assert_eq!(error(&input_of(3), Some(usize::MAX)), absurd);
        let record = record_of_psfex(&to_psfex(&input_of(4), Some(1)).unwrap().model).unwrap();
        assert_eq!(error(&Psf::from(record), Some(1_000_000)), absurd);
        let samples = samples(3, 9);
        let grid = samples.grid().with_pixel_response_included(false);
        let bare = PsfSamples::new(samples.stamps().to_owned(), samples.positions().clone(), grid).unwrap();
        let expected = (ErrorKind::Format, Some("pixel_response_included"));
        assert_eq!(error(&input(bare), Some(1)), expected);
    }
}
