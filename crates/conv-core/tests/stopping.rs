//! Tests of work that is cancelled before its end.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::slice::from_ref;
use std::sync::Arc;

use common::{ANCHORS, Execute, Patience, Scene, Waves, model_with, noise};
use conv_core::{
    BasisConvolution, ConvError, ConvolutionMethod, Direct, LowRank, Operation, PatchConvolution, Paths,
    PlanOptions, SourcePlan,
};
use ndarray::Array2;
use psf_types::{Normalisation, PointSource, Position, PsfBasis, PsfModel, StampGrid};
use rayon::ThreadPoolBuilder;

const FRAME: (usize, usize) = (230, 190);

fn model() -> PsfModel {
    model_with(Arc::new(Waves), (9, 7), (4, 3), true, Normalisation::Unit)
}

fn scene() -> Scene<f64> {
    Scene::new(noise(FRAME.1, FRAME.0, 3))
}

fn sources(count: usize) -> Vec<PointSource> {
    let place = |i: usize, factor: usize, limit: usize| ((i * factor) % limit) as f64 + 0.3;
    (0..count)
        .map(|i| {
            let position = Position::new(place(i, 7919, FRAME.0), place(i, 104_729, FRAME.1)).unwrap();
            PointSource::new(position, 2.0).unwrap()
        })
        .collect()
}

/// Runs work that is cancelled after none, some and nearly all of its polls, on one thread and on
/// several. The work must poll at least `at_least` times, return the error, and poll at most
/// `most_after` times after the cancellation.
fn stops<R: std::fmt::Debug + Send>(
    name: &str,
    (at_least, most_after): (usize, usize),
    work: impl Fn(&Patience) -> Result<R, ConvError> + Sync,
) {
    for threads in [1, 4] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let patience = Patience::endless();
        pool.install(|| work(&patience)).unwrap();
        let all = patience.asked();
        assert!(all >= at_least, "{name}: polled {all} times");
        for enough in [0, 1, all / 2, all - 1] {
            let patience = Patience::of(enough);
            match pool.install(|| work(&patience)) {
                Err(ConvError::Cancelled(_)) => {}
                other => panic!("{name}, {threads} threads, cancelled at {enough} of {all}: {other:?}"),
            }
            let after = patience.asked() - enough;
            assert!(
                (1..=most_after).contains(&after),
                "{name}, {threads} threads: polled {after} times after cancellation at {enough} of {all}"
            );
        }
    }
}

/// The most polls after the cancellation. Each block that is about to be executed polls once more,
/// and some tens of blocks run at the same time.
const BLOCKS: usize = 100;

#[test]
fn a_plan_stops_soon_and_serves_again() {
    let scene = scene();
    for anchor in ANCHORS {
        for paths in [Paths::Cheapest, Paths::Transforms] {
            let options = PlanOptions::new(1e-3)
                .unwrap()
                .with_anchor(anchor)
                .with_paths(paths);
            let engine = scene.engine(&model(), options);
            let tiles = engine.plan().summary().tiles;
            let before = engine.image_of(&scene).unwrap();
            let back = engine.adjoint(&before).unwrap();
            stops("forward", (tiles, BLOCKS), |patience| {
                let mut image = engine.plan().zeros();
                engine.execute(
                    Operation::Convolve,
                    from_ref(&scene.light.view()),
                    vec![image.view_mut()],
                    patience,
                )
            });
            stops("adjoint", (tiles, BLOCKS), |patience| {
                engine.adjoint_of(&before.view(), patience)
            });
            assert_eq!(engine.image_of(&scene).unwrap(), before);
            assert_eq!(engine.adjoint(&before).unwrap(), back);
        }
    }
}

#[test]
fn stars_stop_soon_and_are_drawn_again() {
    let fine = {
        let model = model_with(Arc::new(Waves), (9, 7), (4, 3), false, Normalisation::Keep);
        let grid = StampGrid::new(9, 7)
            .and_then(|grid| grid.with_oversampling(2.0))
            .unwrap();
        let basis = PsfBasis::new(None, model.stamps().to_owned(), grid).unwrap();
        PsfModel::new(&basis, Arc::new(Waves), Normalisation::Keep, None).unwrap()
    };
    let (frame, stars) = (scene().frame, sources(5000));
    for (name, model) in [("fine", fine), ("exactly", model())] {
        for anchor in ANCHORS {
            let plan =
                SourcePlan::<f64>::new(&model, PlanOptions::new(1e-3).unwrap().with_anchor(anchor), None)
                    .unwrap();
            let drawn = || common::drawn(&plan, &stars, frame);
            let before = drawn();
            stops(name, (5, 40), |patience| {
                let mut image = Array2::zeros((FRAME.1, FRAME.0));
                plan.draw_stars_into(&stars, frame, frame, image.view_mut(), patience)
            });
            assert_eq!(drawn(), before);
        }
    }
}

#[test]
fn every_method_stops() {
    let scene = scene();
    let model = model();
    for anchor in ANCHORS {
        let options = PlanOptions::new(1e-3).unwrap().with_anchor(anchor);
        let methods: [(&str, Box<dyn ConvolutionMethod<f64> + Sync>); 4] = [
            ("direct", Box::new(Direct::new(anchor))),
            ("basis", Box::new(BasisConvolution::new(anchor))),
            ("patch", Box::new(PatchConvolution::new(20, anchor).unwrap())),
            ("low rank", Box::new(LowRank::new(options))),
        ];
        for (name, method) in methods {
            // After a cancellation, the columns of a plane are skipped one by one, with a poll for
            // each.
            stops(name, (4, 600), |patience| {
                method.convolve(&model, &scene.light.view(), scene.frame, patience)
            });
        }
        let pixels: Vec<(usize, usize)> = (0..90).map(|i| (2 * i, i)).collect();
        stops("single pixels", (90, 90), |patience| {
            let light = (scene.pixels(), (0, 0));
            Direct::new(anchor).at_pixels(&model, light, scene.shape(), scene.frame, &pixels, patience)
        });
    }
}
