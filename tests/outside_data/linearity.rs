//! The fast engine is a linear operator, and its adjoint is the transpose of that operator.

use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::conv_core::{Engine, Operation, Paths, Plan, PlanOptions};
use psfield::psf_types::{Anchor, ImageView, NoProgress};
use std::slice::from_ref;

use crate::data::{Field, ROMAN, STRONG, ensure, trial};
use crate::responses::{lit_everywhere, norm};
use crate::simulation::{ANCHORS, FULL};

/// Rounding of the transforms, relative to the norms of the summands.
const LINEAR: f64 = 1e-12;
/// Rounding of two scalar products of a million terms, relative to their value.
const TRANSPOSE: f64 = 1e-12;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    for field in [STRONG, ROMAN] {
        for (anchor, name) in ANCHORS {
            trials.push(trial(
                format!("{}, {name}-anchored: linear, with its transpose", field.name),
                move || linear(field, anchor),
            ));
        }
    }
    trials
}

fn linear(field: Field, anchor: Anchor) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    let frame = field.frame()?;
    // Light everywhere, and stars and galaxies on a dark sky. The cheapest path differs for the two
    // scenes and for their sum.
    let f: Array2<f64> = lit_everywhere(frame.nx(), frame.ny(), 5);
    let g = field.scene::<f64>()?.into_pixels();
    let (a, b) = (2.5, -0.75);
    for paths in [Paths::Transforms, Paths::Cheapest] {
        for tolerance in [0.0, 1e-3] {
            let options = PlanOptions::new(tolerance)?.with_anchor(anchor).with_paths(paths);
            let engine = Engine::<f64>::new(Plan::new(&model, frame, frame.region(), options)?);
            let image = |light: &Array2<f64>| -> Result<Array2<f64>, Failed> {
                let mut image = engine.plan().zeros();
                engine.execute(
                    Operation::Convolve,
                    from_ref(&ImageView::new(light.view())?),
                    vec![image.view_mut()],
                    &NoProgress,
                )?;
                Ok(image)
            };
            let (of_f, of_g) = (image(&f)?, image(&g)?);
            let of_sum = image(&(a * &f + b * &g))?;
            let difference = norm((&of_sum - &(a * &of_f + b * &of_g)).view());
            let off = difference / (a.abs() * norm(of_f.view()) + b.abs() * norm(of_g.view()));
            let weights: Array2<f64> = lit_everywhere(frame.nx(), frame.ny(), 6);
            let mut back = engine.plan().zeros();
            engine.execute(
                Operation::Adjoint,
                from_ref(&ImageView::new(weights.view())?),
                vec![back.view_mut()],
                &NoProgress,
            )?;
            let (left, right) = ((&of_g * &weights).sum(), (&back * &g).sum());
            let transposed = (left / right - 1.0).abs();
            println!(
                "{} {anchor} {paths:?} at {tolerance:e}: linear to {off:.1e}, transpose to {transposed:.1e}",
                field.name
            );
            ensure(off <= LINEAR && transposed <= TRANSPOSE, || {
                format!("{paths:?} at {tolerance:e}: linear to {off:.3e}, transpose to {transposed:.3e}")
            })?;
        }
    }
    Ok(())
}
