//! Properties of every method for any light: it is linear, its image follows a shift of the light
//! if the PSF is constant, it keeps the flux of sources inside the frame, it makes no negative
//! values from positive ones, and its adjoint is its transpose.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Constant, Execute, Scene, Waves, largest_difference, model_with, peak};
use conv_core::{BasisConvolution, ConvolutionMethod, Direct, LowRank, PatchConvolution, PlanOptions};
use ndarray::{Array2, Array3, s};
use proptest::prelude::*;
use psf_types::{
    Anchor, CoefficientField, FieldError, Image, Normalisation, Position, PsfBasis, PsfModel, StampGrid,
};

/// Rounding of transforms and sums of a few thousand values in f64, relative to the peak.
const ROUNDING: f64 = 1e-12;

const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];
/// Width and height of the stamps, and their centre.
const STAMP: (usize, usize) = (6, 5);
const CENTRE: (usize, usize) = (3, 1);

/// Every method, and the fast engine with two tolerances.
fn methods(anchor: Anchor) -> Vec<(&'static str, Box<dyn ConvolutionMethod<f64>>)> {
    let options = PlanOptions::new(0.0).unwrap().with_anchor(anchor);
    let rough = PlanOptions::new(1e-3).unwrap().with_anchor(anchor);
    vec![
        ("direct", Box::new(Direct::new(anchor))),
        ("basis", Box::new(BasisConvolution::new(anchor))),
        ("patch", Box::new(PatchConvolution::new(5, anchor).unwrap())),
        ("low rank", Box::new(LowRank::new(options))),
        ("rough low rank", Box::new(LowRank::new(rough))),
    ]
}

fn convolved(method: &dyn ConvolutionMethod<f64>, model: &PsfModel, light: &Array2<f64>) -> Array2<f64> {
    let scene = Scene::new(light.clone());
    scene.through(model, method).unwrap().into_pixels()
}

/// Light of up to 29 x 29 pixels. Some pixels are dark, some are bright.
fn light(least: f64) -> impl Strategy<Value = Array2<f64>> {
    let value = prop_oneof![3 => Just(0.0), 3 => least..1.0, 1 => least * 1e6..1e6];
    (1_usize..30, 1_usize..30).prop_flat_map(move |(nx, ny)| {
        prop::collection::vec(value.clone(), nx * ny)
            .prop_map(move |values| Array2::from_shape_vec((ny, nx), values).unwrap())
    })
}

/// The light in a dark image that has `2 * margin` more columns and rows. The light begins at
/// column `x` and row `y`.
fn framed(light: &Array2<f64>, x: usize, y: usize, margin: usize) -> Array2<f64> {
    let (ny, nx) = light.dim();
    let mut wide = Array2::zeros((ny + 2 * margin, nx + 2 * margin));
    wide.slice_mut(s![y..y + ny, x..x + nx]).assign(light);
    wide
}

/// Weights of two positive stamps, which stay between 0 and 1.
#[derive(Debug)]
struct Shares;

impl CoefficientField for Shares {
    fn component_count(&self) -> usize {
        2
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        a[0] = 0.5 + 0.5 * (p.x() / 9.0).sin();
        a[1] = 1.0 - a[0];
        Ok(())
    }
}

/// Two positive stamps with no common pixels, so that they are orthogonal.
fn positive_model() -> PsfModel {
    let mut stamps = Array3::zeros((2, STAMP.1, STAMP.0));
    for ((k, y, x), value) in stamps.indexed_iter_mut() {
        if (x + y) % 2 == k {
            *value = 1.0 / (1.0 + (x as f64 - 3.0).powi(2) + (y as f64 - 1.0).powi(2));
        }
    }
    for mut stamp in stamps.outer_iter_mut() {
        let norm = stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
        stamp.mapv_inplace(|v| v / norm);
    }
    let grid = StampGrid::new(STAMP.0, STAMP.1).unwrap();
    let grid = grid.with_centre(CENTRE.0 as f64, CENTRE.1 as f64).unwrap();
    let basis = PsfBasis::new(None, stamps, grid).unwrap();
    PsfModel::new(&basis, Arc::new(Shares), Normalisation::Unit, None).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn methods_are_linear(first in light(-1.0), factor in -1e3..1e3_f64, seed in 0_u64..1000) {
        let model = model_with(Arc::new(Waves), STAMP, CENTRE, true, Normalisation::Unit);
        let (ny, nx) = first.dim();
        let second = common::noise(ny, nx, seed);
        let sum = &first + &(&second * factor);
        for anchor in ANCHORS {
            for (name, method) in methods(anchor) {
                let apart = convolved(&*method, &model, &first) + convolved(&*method, &model, &second) * factor;
                let together = convolved(&*method, &model, &sum);
                let scale = peak(&first).max(factor.abs() * peak(&second)).max(peak(&together));
                let difference = largest_difference(&apart, &together);
                prop_assert!(difference <= ROUNDING * scale, "{} {}: {:e} of {:e}", name, anchor, difference, scale);
            }
        }
    }

    #[test]
    fn the_image_of_a_constant_psf_follows_a_shift(light in light(-1.0), dx in 0_usize..9, dy in 0_usize..9) {
        let model = model_with(Arc::new(Constant), STAMP, CENTRE, true, Normalisation::Keep);
        // Wide enough for the stamp on all sides of both images.
        let margin = 16;
        let (ny, nx) = light.dim();
        for anchor in ANCHORS {
            for (name, method) in methods(anchor) {
                let here = convolved(&*method, &model, &framed(&light, 7, 7, margin));
                let there = convolved(&*method, &model, &framed(&light, 7 + dx, 7 + dy, margin));
                let part = |image: &Array2<f64>, x: usize, y: usize| {
                    image.slice(s![y..y + ny + 14, x..x + nx + 14]).to_owned()
                };
                let difference = largest_difference(&part(&here, 0, 0), &part(&there, dx, dy));
                prop_assert!(difference <= ROUNDING * peak(&here), "{} {}: {:e}", name, anchor, difference);
            }
        }
    }

    #[test]
    fn the_flux_of_sources_within_the_frame_is_kept(light in light(0.0)) {
        let model = positive_model();
        let wide = framed(&light, 8, 8, 8);
        for (name, method) in methods(Anchor::Source) {
            let image = convolved(&*method, &model, &wide);
            let difference = (image.sum() - light.sum()).abs();
            prop_assert!(difference <= ROUNDING * light.sum(), "{}: {:e}", name, difference);
        }
    }

    #[test]
    fn scalar_products_are_the_same_on_both_sides(light in light(-1.0), seed in 0_u64..1000) {
        let model = model_with(Arc::new(Waves), STAMP, CENTRE, true, Normalisation::Unit);
        let (ny, nx) = light.dim();
        let scene = Scene::new(light.clone());
        let seen = Image::new(common::noise(ny, nx, seed)).unwrap();
        for anchor in ANCHORS {
            let mut pairs = Vec::new();
            for tolerance in [0.0, 1e-3] {
                let options = PlanOptions::new(tolerance).unwrap().with_anchor(anchor);
                let engine = scene.engine(&model, options);
                pairs.push((engine.image_of(&scene).unwrap(), engine.adjoint(&seen).unwrap()));
            }
            let basis = BasisConvolution::new(anchor);
            pairs.push((scene.through(&model, &basis).unwrap(), basis.adjoint(&model, &seen.view(), scene.shape(), scene.frame).unwrap()));
            for (image, back) in pairs {
                let forward = (&image.pixels() * &seen.pixels()).sum();
                let backward = (&light * &back.pixels()).sum();
                let terms = (&image.pixels() * &seen.pixels()).mapv(f64::abs).sum();
                let scale = terms + peak(&light) * (nx * ny) as f64;
                prop_assert!((forward - backward).abs() <= ROUNDING * scale, "{}: {:e}", anchor, forward - backward);
            }
        }
    }

    #[test]
    fn light_without_negative_values_gives_none(light in light(0.0)) {
        let model = positive_model();
        for anchor in ANCHORS {
            // At a tolerance above 0, the error of a PSF may make it negative.
            for (name, method) in methods(anchor).into_iter().filter(|(name, _)| *name != "rough low rank") {
                let image = convolved(&*method, &model, &light);
                let least = image.iter().copied().fold(0.0, f64::min);
                prop_assert!(least >= -ROUNDING * peak(&light), "{} {}: {:e}", name, anchor, least);
                // No term of the direct sum is negative.
                prop_assert!(name != "direct" || least >= 0.0, "{:e}", least);
            }
        }
    }
}
