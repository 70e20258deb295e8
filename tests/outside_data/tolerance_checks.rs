//! Checks of the measurement that the tolerance tests use.

use libtest_mimic::{Failed, Trial};
use psfield::conv_core::{Paths, PlanOptions};

use crate::data::{STRONG, ensure, trial};
use crate::responses::Probes;
use crate::simulation::{ANCHORS, FULL};
use crate::tolerance::measured;
use crate::tolerance_fields::step;

/// Difference between a response measured by its own execution and in a batch.
const BATCHES: f64 = 1e-12;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial(
            "strong: responses of a batch equal those of single pixels".to_owned(),
            batches,
        ),
        trial("strong: a PSF beyond the tolerance is noticed".to_owned(), seen),
    ]
}

fn batches() -> Result<(), Failed> {
    let model = STRONG.model(FULL)?;
    let frame = STRONG.frame()?;
    for (anchor, name) in ANCHORS {
        let options = PlanOptions::new(1e-2)?
            .with_anchor(anchor)
            .with_paths(Paths::Transforms);
        let probes = |count| Probes::random(&model, (frame.nx(), frame.ny()), count, anchor);
        let together = measured::<f64>(&model, &probes(12)?, frame, options, 1.0)?;
        let alone = measured::<f64>(&model, &probes(12)?.one_by_one(12), frame, options, 1.0)?;
        println!("{name}: together {together:?}, alone {alone:?}");
        ensure(
            (together.largest - alone.largest).abs() <= BATCHES
                && (together.mean - alone.mean).abs() <= BATCHES
                && alone.largest > 1e-4,
            || format!("together {together:?}, alone {alone:?}"),
        )?;
    }
    Ok(())
}

/// The PSFs of a coarse tolerance violate a fine one, so the step is not small.
fn seen() -> Result<(), Failed> {
    let model = STRONG.model(FULL)?;
    let (stepped, cut) = step()?;
    for (anchor, _) in ANCHORS {
        for (model, frame) in [(&model, STRONG.frame()?), (&stepped, cut)] {
            let probes = Probes::random(model, (frame.nx(), frame.ny()), 60, anchor)?;
            let options = PlanOptions::new(1e-1)?.with_anchor(anchor);
            let found = measured::<f64>(model, &probes, frame, options, 1e-3)?;
            println!(
                "{anchor}: of 60 PSFs made to 1e-1, {} miss 1e-3",
                found.violations
            );
            ensure(found.violations > 50, || format!("{found:?}"))?;
        }
    }
    Ok(())
}
