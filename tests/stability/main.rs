//! The stability suite as tests: one per row of `STABILITY.md`.

use integration_tests::stability::sections;
use libtest_mimic::{Arguments, Trial};

fn main() {
    let arguments = Arguments::from_args();
    let trials = sections()
        .into_iter()
        .flat_map(|section| {
            section.cases.into_iter().map(move |case| {
                let (columns, run) = (section.columns, case.run);
                Trial::test(format!("{}: {}", section.title, case.name), move || {
                    let failures: Vec<String> = run()
                        .iter()
                        .zip(columns)
                        .filter_map(|(cell, column)| Some(format!("{column}: {}", cell.failure()?)))
                        .collect();
                    if failures.is_empty() {
                        Ok(())
                    } else {
                        Err(failures.join("; ").into())
                    }
                })
            })
        })
        .collect();
    libtest_mimic::run(&arguments, trials).exit();
}
