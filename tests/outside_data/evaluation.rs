//! Interpolated PSFs against PSFs that were drawn at the same positions.

use libtest_mimic::{Failed, Trial};
use psfield::FitOptions;
use psfield::evaluate::{EvaluateOptions, evaluate};
use psfield::fit::fit;
use psfield::metrics::{Comparison, Summary};
use psfield::psf_basis::RankSelection;
use psfield::psf_types::Interpolation;

use crate::data::{Field, ROMAN, STRONG, ensure, trial};

pub(crate) fn trials() -> Vec<Trial> {
    [(ROMAN, 1.1e-5, 2e-5), (STRONG, 2.1e-3, 3.8e-3)]
        .map(|(field, median, max)| {
            trial(format!("{}: off-grid PSFs", field.name), move || {
                off_grid(field, median, max)
            })
        })
        .into()
}

fn off_grid(field: Field, median: f64, max: f64) -> Result<(), Failed> {
    let truth = field.off_grid()?;
    let options = FitOptions {
        interpolation: Interpolation::Bilinear,
        rank: RankSelection::Full,
        ..FitOptions::default()
    };
    let model = fit(field.samples()?, &options)?.into_model()?;
    let stamps = evaluate(
        &model,
        truth.positions().as_slice().to_vec(),
        EvaluateOptions::default(),
    )?;
    let errors: Result<Vec<f64>, _> = Comparison::by_plane(stamps.stamps(), truth.stamps())?
        .iter()
        .map(Comparison::relative_l2)
        .collect();
    let errors = Summary::of(errors?)?;
    println!(
        "{}: relative L2 median {:.3e}, largest {:.3e}",
        field.name,
        errors.median(),
        errors.max()
    );
    ensure(errors.median() <= median && errors.max() <= max, || {
        format!(
            "median {:.3e} (at most {median:e}), largest {:.3e} (at most {max:e})",
            errors.median(),
            errors.max()
        )
    })
}
