//! Shared parts of the tests of gridded PSF libraries: comparison with the PSFs of photutils.

use libtest_mimic::Failed;
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate};
use psfield::fit::fit;
use psfield::metrics::Comparison;
use psfield::psf_basis::RankSelection;
use psfield::psf_types::{Interpolation, Normalisation, Position, PsfModel, PsfSamples};
use psfield::{FitOptions, psf_io};

use crate::data::{ensure, file};

/// Truths are in single precision (6e-8 of a value). The peaks of two stamps may differ by a factor
/// of a few.
const OWN_GRID: f64 = 1e-6;
/// photutils and psfield evaluate the same kind of spline. The difference comes from the truths'
/// single precision, relative to faint wings.
const NATIVE: f64 = 1e-4;
/// Planes in wrong places differ by more than this, a thousand times the tolerance.
const WRONG: f64 = 1e-3;

/// Positions at which photutils evaluated a library.
pub(crate) struct Truth {
    folder: &'static str,
    positions: Vec<Position>,
    on_own_grid: Vec<bool>,
}

impl Truth {
    /// Opens the truth `name`: the part of the file names between `truth_` and `_positions`.
    pub(crate) fn open(folder: &'static str, name: &str) -> Result<Self, Failed> {
        let path = file(&format!("{folder}/truth_{name}_positions.csv"));
        let [x, y, own] = psf_io::read_columns(path, ["x0", "y0", "in_epsf4x"])?;
        let positions = x.into_iter().zip(y).map(|(x, y)| Position::new(x, y));
        Ok(Self {
            folder,
            positions: positions.collect::<Result<_, _>>()?,
            on_own_grid: own.iter().map(|&v| v != 0.0).collect(),
        })
    }

    /// The largest error over the peak on the library's own grid.
    pub(crate) fn own_grid_error(&self, samples: &PsfSamples, name: &str) -> Result<f64, Failed> {
        self.own_grid_error_of(&model(samples)?, name)
    }

    /// [`own_grid_error`](Self::own_grid_error) for a model.
    pub(crate) fn own_grid_error_of(&self, model: &PsfModel, name: &str) -> Result<f64, Failed> {
        let truth = psf_io::read_cube::<f64>(file(&format!("{}/truth_{name}_epsf4x.fits", self.folder)))?;
        let marked = self
            .positions
            .iter()
            .zip(&self.on_own_grid)
            .filter(|(_, own)| **own);
        let positions = marked.map(|(&position, _)| position).collect();
        let stamps = evaluate(model, positions, EvaluateOptions::default())?;
        let planes = Comparison::by_plane(stamps.stamps(), truth.view())?;
        let errors: Result<Vec<f64>, _> = planes.iter().map(Comparison::max_over_peak).collect();
        Ok(errors?.into_iter().fold(0.0, f64::max))
    }

    /// Checks that the error on the own grid is within the tolerance.
    pub(crate) fn check_own_grid(&self, samples: &PsfSamples, name: &str) -> Result<(), Failed> {
        let error = self.own_grid_error(samples, name)?;
        println!("{name}: own grid: largest error / peak {error:.2e}");
        ensure(error <= OWN_GRID, || {
            format!("{name}: {error:e} of peak, at most {OWN_GRID:e}")
        })
    }

    /// Checks that the own grid is far from the truth: the comparison notices planes in wrong
    /// places.
    pub(crate) fn check_own_grid_differs(&self, samples: &PsfSamples, name: &str) -> Result<(), Failed> {
        let error = self.own_grid_error(samples, name)?;
        ensure(error >= WRONG, || {
            format!("{name}: {error:e} of peak, at least {WRONG:e} is expected for planes in wrong places")
        })
    }

    /// Checks the largest relative L2 error on 21 x 21 detector pixels, at each position's own
    /// phase.
    pub(crate) fn check_native(&self, samples: &PsfSamples, name: &str) -> Result<(), Failed> {
        let truth = psf_io::read_cube::<f64>(file(&format!("{}/truth_{name}_native21.fits", self.folder)))?;
        let options = EvaluateOptions {
            grid: OutputGrid::Native,
            size: Some(21),
            sub_pixel: true,
        };
        let stamps = evaluate(&model(samples)?, self.positions.clone(), options)?;
        let planes = Comparison::by_plane(stamps.stamps(), truth.view())?;
        let errors: Result<Vec<f64>, _> = planes.iter().map(Comparison::relative_l2).collect();
        let error = errors?.into_iter().fold(0.0, f64::max);
        println!("{name}: detector pixels: largest relative L2 {error:.2e}");
        ensure(error <= NATIVE, || {
            format!("{name}: {error:e}, at most {NATIVE:e}")
        })
    }
}

/// The samples as photutils' `GriddedPSFModel` uses them: unscaled, bilinear, the nearest outside.
fn model(samples: &PsfSamples) -> Result<PsfModel, Failed> {
    let options = FitOptions {
        rank: RankSelection::Full,
        interpolation: Interpolation::Bilinear,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    Ok(fit(samples.clone(), &options)?.into_model()?)
}
