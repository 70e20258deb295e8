//! The tolerance on apertures: the flux in every circle about every source is within the tolerance.

use integration_tests::circles::{CircleErrors, Halo, circle_errors};
use integration_tests::{fitted, uniform_samples};
use psfield::FitOptions;
use psfield::conv_core::PlanOptions;
use psfield::psf_io::CardValue;
use psfield::psf_types::{Anchor, PsfModel, PsfSource, ToleranceOn};

/// Rounding of an image of single sources in double precision, and of the sum over a stamp.
const ROUNDING: f64 = 1e-12;
const TOLERANCES: [f64; 4] = [1e-2, 1e-3, 1e-4, 1e-5];
/// With a bound on the L2 error only, the flux in circles of the halo's PSFs misses the tolerance
/// by at least this factor.
const MISSED_WITHOUT: f64 = 2.0;

fn halo_model(halo: Halo) -> PsfModel {
    fitted(uniform_samples(&halo, 5, 5), &FitOptions::default())
}

fn errors_of(model: &PsfModel, halo: Halo, tolerance: f64, on: ToleranceOn, count: usize) -> CircleErrors {
    let options = PlanOptions::new(tolerance).unwrap().with_tolerance_on(on);
    let found = circle_errors(model, halo.field(), options, count).unwrap();
    println!("{} pixels, {on} {tolerance:e}: {found:?}", halo.side);
    found
}

/// Tests a number of positions at each tolerance, and that the halo needs a bound on apertures.
fn circles_of(halo: Halo, count: usize) {
    let model = halo_model(halo);
    for tolerance in TOLERANCES {
        let found = errors_of(&model, halo, tolerance, ToleranceOn::Aperture, count);
        assert_eq!(found.count, count);
        assert!(found.l2 <= tolerance + ROUNDING, "{tolerance:e}: {found:?}");
        assert!(found.circle <= tolerance + ROUNDING, "{tolerance:e}: {found:?}");
    }
    let found = errors_of(&model, halo, 1e-3, ToleranceOn::L2, count.min(100));
    assert!(found.circle > MISSED_WITHOUT * 1e-3, "{found:?}");
    assert!(found.l2 <= 1e-3 + ROUNDING, "{found:?}");
}

#[test]
fn flux_in_circles_of_a_halo_is_within_the_tolerance() {
    circles_of(
        Halo {
            side: 128,
            field: 384,
        },
        60,
    );
}

#[test]
#[ignore = "takes minutes: .ci/extra runs it"]
fn flux_in_circles_of_a_large_halo_is_within_the_tolerance() {
    circles_of(
        Halo {
            side: 512,
            field: 1536,
        },
        1000,
    );
}

/// A plan says what it guarantees.
#[test]
fn plans_say_which_errors_the_tolerance_bounds() {
    let halo = Halo { side: 16, field: 64 };
    let psf = psfield::Psf::from(halo_model(halo));
    for (on, says) in [
        (ToleranceOn::L2, "relative L2 error within the tolerance"),
        (
            ToleranceOn::Aperture,
            "flux error in every circle within the tolerance",
        ),
    ] {
        let simulator = psf
            .simulator((64, 64))
            .tolerance_on(on)
            .anchor(Anchor::Output)
            .build::<f32>()
            .unwrap();
        let any_image = psfield::Scene::streamed();
        let made = simulator
            .prepare(&any_image, &psfield::psf_types::NoProgress)
            .unwrap();
        let plan = made.plan.as_ref().unwrap();
        assert_eq!(plan.tolerance_on, on);
        assert!(plan.to_string().contains(says), "{plan}");
        let cards = simulator.cards(&made).unwrap();
        let card = cards.iter().find(|card| card.keyword() == "PSFTOLON").unwrap();
        assert_eq!(card.value(), Some(CardValue::Text(on.to_string())));
    }
}
