//! Images of the fast engine against the two truths, at every tolerance.

use integration_tests::convolve;
use libtest_mimic::{Failed, Trial};
use psfield::conv_core::{ConvReal, LowRank, PlanOptions};
use psfield::metrics::Comparison;
use psfield::psf_types::{Anchor, Image, PsfModel};

use crate::data::{Field, ROMAN, STRONG, ensure, trial};
use crate::simulation::{ANCHORS, FULL};

const TOLERANCES: [f64; 6] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];
/// The truth is stored in single precision, which adds an error of 2e-8.
const STORED: f64 = 1e-7;
/// Rounding in single precision: transforms of a few thousand values, and sums over the modes of a
/// tile.
const SINGLE: f64 = 1e-6;
/// Rounding in double precision, relative to the norm of the compared pixels and to the peak. The
/// documentation states this number.
const EXACT: f64 = 1e-14;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    for field in [STRONG, ROMAN] {
        for (anchor, name) in ANCHORS {
            let label = |what: &str| format!("{}, {name}-anchored: low rank {what}", field.name);
            trials.push(trial(label("f64"), move || {
                at_tolerances::<f64>(field, anchor, name, STORED)
            }));
            trials.push(trial(label("f32"), move || {
                at_tolerances::<f32>(field, anchor, name, SINGLE)
            }));
            trials.push(trial(label("f64 at tolerance 0"), move || {
                exact(field, anchor, name)
            }));
        }
    }
    trials
}

fn image<T: ConvReal>(
    field: Field,
    model: &PsfModel,
    anchor: Anchor,
    tolerance: f64,
) -> Result<Image<T>, Failed> {
    let engine = LowRank::new(PlanOptions::new(tolerance)?.with_anchor(anchor));
    Ok(convolve(&engine, model, &field.scene::<T>()?)?)
}

fn at_tolerances<T: ConvReal>(
    field: Field,
    anchor: Anchor,
    truth: &str,
    rounding: f64,
) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    let exact = field.truth(truth)?;
    for tolerance in TOLERANCES.into_iter().chain([0.0]) {
        let image = image::<T>(field, &model, anchor, tolerance)?;
        let error = Comparison::of(image.pixels(), exact.pixels())?.relative_l2()?;
        println!(
            "{} {truth} {} at {tolerance:.0e}: relative L2 {error:.3e}",
            field.name,
            T::NAME
        );
        ensure(error <= tolerance + rounding, || {
            format!("at {tolerance:e}: relative L2 {error:.3e}")
        })?;
    }
    Ok(())
}

fn exact(field: Field, anchor: Anchor, truth: &str) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    let image = image::<f64>(field, &model, anchor, 0.0)?;
    let image = image.pixels();
    let peak = image.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let (mut largest, mut difference, mut whole) = (0.0_f64, 0.0, 0.0);
    let exact = field.exact(truth)?;
    for &((x, y), value) in &exact {
        let off = image[[y, x]] - value;
        largest = largest.max(off.abs() / peak);
        difference += off * off;
        whole += value * value;
    }
    let own = (difference / whole).sqrt();
    println!(
        "{} {truth} at 0: over {} exact pixels, largest / peak {largest:.1e}, relative L2 {own:.1e}",
        field.name,
        exact.len()
    );
    ensure(largest <= EXACT && own <= EXACT, || {
        format!("largest difference over peak {largest:.3e}, relative L2 {own:.3e}; at most {EXACT:e}")
    })
}
