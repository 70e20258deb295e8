//! Interpolators on the coefficients of a telescope.

use integration_tests::{model_errors, small_telescope, uniform_samples};
use psfield::FitOptions;
use psfield::fit::fit;
use psfield::psf_basis::RankSelection;
use psfield::psf_types::{Interpolation, Normalisation};

fn options(interpolation: Interpolation) -> FitOptions {
    FitOptions {
        rank: RankSelection::Error(1e-8),
        interpolation,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    }
}

const ALL: [Interpolation; 7] = [
    Interpolation::Bilinear,
    Interpolation::Bicubic,
    Interpolation::Delaunay,
    Interpolation::NaturalNeighbour,
    Interpolation::InverseDistance { power: 2.0 },
    Interpolation::Polynomial { degree: 6 },
    Interpolation::Nearest,
];

/// Halving the distance of the samples must reduce the error by the order of each method. Linear
/// methods gain a factor of about 4, nearest about 2. Inverse distance has no order but improves.
#[test]
fn errors_fall_with_the_sampling_as_theory_says() {
    let telescope = small_telescope(1);
    for interpolation in ALL {
        let error = |nx, ny| {
            let fitted = fit(uniform_samples(&telescope, nx, ny), &options(interpolation)).unwrap();
            model_errors(&fitted.into_model().unwrap(), &telescope, 23).rms()
        };
        let (coarse, fine) = (error(9, 7), error(17, 13));
        println!("{interpolation}: {coarse:.2e} with 9 x 7 samples, {fine:.2e} with 17 x 13");
        match interpolation {
            Interpolation::Bilinear | Interpolation::Delaunay => {
                assert!(
                    (3.3..4.7).contains(&(coarse / fine)),
                    "{interpolation}: {}",
                    coarse / fine
                );
            }
            Interpolation::Nearest => {
                assert!(
                    (1.7..2.3).contains(&(coarse / fine)),
                    "{interpolation}: {}",
                    coarse / fine
                );
            }
            // Their error has parts of order 3 and of order 2. The latter is that of the tree's cells.
            Interpolation::NaturalNeighbour => {
                assert!(
                    (4.0..9.0).contains(&(coarse / fine)),
                    "{interpolation}: {}",
                    coarse / fine
                );
            }
            // The error has parts of order 4 and of order 2. The part of order 2 is about 1/25 of
            // the error of bilinear interpolation.
            Interpolation::Bicubic => {
                assert!(
                    (4.5..16.5).contains(&(coarse / fine)),
                    "{interpolation}: {}",
                    coarse / fine
                );
            }
            Interpolation::Polynomial { .. } => assert!(coarse < 2e-3, "{coarse}"),
            _ => assert!(fine < 0.75 * coarse),
        }
    }
}

#[test]
fn leave_one_out_predicts_the_error_between_samples() {
    let telescope = small_telescope(1);
    // The prediction leaves out a sample, so it interpolates over twice the distance. For linear
    // methods the error is then four times the error in the middle of a cell. The error of a cubic
    // has parts of order 2 and 4. The prediction of natural neighbours lacks the error of the tree's
    // cells, which is about as large as theirs on a grid.
    for (interpolation, at_least, at_most) in [
        (Interpolation::Bilinear, 1.0, 8.0),
        (Interpolation::NaturalNeighbour, 0.9, 8.0),
        (Interpolation::Bicubic, 1.0, 16.0),
    ] {
        let fitted = fit(uniform_samples(&telescope, 13, 11), &options(interpolation)).unwrap();
        let left_out = fitted.report().unwrap().leave_one_out;
        assert!(left_out.predicted >= 11 * 9);
        let median = left_out.median.unwrap();
        let errors = model_errors(&fitted.into_model().unwrap(), &telescope, 23);
        let ratio = median / errors.median();
        println!(
            "{interpolation}: predicted {median:.2e}, found {:.2e}",
            errors.median()
        );
        assert!((at_least..at_most).contains(&ratio), "{interpolation}: {ratio}");
    }
}
