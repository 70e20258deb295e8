//! The pipeline against truth that other software computed, on data that is not part of the
//! project.
//!
//! The tests look for the data in `../shared/data` next to the checkout, or in the folder that
//! `PSFIELD_DATA` names. Without the data, these tests show as ignored.

mod data;
mod doors;
mod dynamic_range;
mod evaluation;
mod flux;
mod frames;
mod gpu;
mod libraries;
mod linearity;
mod low_rank;
mod measurements;
mod psfex;
mod responses;
mod simulation;
mod stars;
mod stdpsf;
mod stpsf;
mod tolerance;
mod tolerance_checks;
mod tolerance_fields;

use libtest_mimic::{Arguments, Trial};

fn main() {
    let arguments = Arguments::from_args();
    let available = data::folder().is_some();
    if !available {
        assert!(
            !data::asked_for(),
            "PSFIELD_DATA is set, but {} does not hold the data",
            data::expected().display()
        );
        eprintln!(
            "outside data: not found ({}). Its tests are skipped and show as ignored",
            data::expected().display()
        );
    }
    let trials = [
        simulation::trials(),
        stars::trials(),
        evaluation::trials(),
        measurements::trials(),
        low_rank::trials(),
        flux::trials(),
        frames::trials(),
        gpu::trials(),
        linearity::trials(),
        dynamic_range::trials(),
        tolerance::trials(),
        tolerance_fields::trials(),
        tolerance_checks::trials(),
        psfex::trials(),
        doors::trials(),
        stdpsf::trials(),
        stpsf::trials(),
    ];
    let trials = trials
        .into_iter()
        .flatten()
        .map(|trial: Trial| {
            let on_demand = trial.has_ignored_flag();
            trial.with_ignored_flag(on_demand || !available)
        })
        .collect();
    libtest_mimic::run(&arguments, trials).exit();
}
