//! Convolution with the model of a telescope.

use integration_tests::{relative_l2, small_telescope, test_scene, uniform_samples};
use psfield::conv_core::{BasisConvolution, ConvolutionMethod, Direct, PatchConvolution};
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{Anchor, Image, PsfModel};
use psfield::{FitOptions, PsfInput, SpotCheck};

/// A few hundred transforms and products in double precision.
const ROUNDING: f64 = 1e-13;

fn model(rank: RankSelection, centring: Centring) -> PsfModel {
    let options = FitOptions {
        rank,
        centring,
        ..FitOptions::default()
    };
    PsfInput::Samples(uniform_samples(&small_telescope(1), 9, 7), options)
        .into_model()
        .unwrap()
}

#[test]
fn the_methods_agree_and_patches_converge_to_them() {
    let scene = test_scene(160, 120, 0);
    for centring in [Centring::Mean, Centring::None] {
        let model = model(RankSelection::Auto, centring);
        for anchor in [Anchor::Source, Anchor::Output] {
            let direct = Direct::new(anchor).convolve(&model, &scene).unwrap();
            let basis = BasisConvolution::new(anchor).convolve(&model, &scene).unwrap();
            assert!(relative_l2(&basis, &direct) < ROUNDING);
            let patches = |size| {
                let image = PatchConvolution::new(size, anchor)
                    .unwrap()
                    .convolve(&model, &scene)
                    .unwrap();
                relative_l2(&image, &direct)
            };
            let (coarse, fine) = (patches(32), patches(8));
            println!("{anchor}: patches of 32 pixels are off by {coarse:.1e}, of 8 by {fine:.1e}");
            assert!(fine < 0.5 * coarse && coarse < 0.1);
            assert!(patches(1) < ROUNDING);
        }
    }
}

#[test]
fn centred_models_of_unit_flux_keep_the_flux_at_every_rank() {
    let scene = test_scene(160, 120, 13);
    let total = scene.pixels().unwrap().sum();
    for rank in [0, 1, 2, 5, 20, 62] {
        let model = model(RankSelection::Fixed(rank), Centring::Mean);
        let image = BasisConvolution::default().convolve(&model, &scene).unwrap();
        assert!(
            (image.pixels().sum() / total - 1.0).abs() < 1e-12,
            "{rank} components"
        );
    }
    // Uncentred truncations keep it because every PSF is scaled.
    let model = model(RankSelection::Fixed(3), Centring::None);
    let image = BasisConvolution::default().convolve(&model, &scene).unwrap();
    assert!((image.pixels().sum() / total - 1.0).abs() < 1e-12);
}

#[test]
fn the_adjoint_belongs_to_the_operator() {
    let scene = test_scene(160, 120, 0);
    let model = model(RankSelection::Fixed(8), Centring::None);
    let g = Image::new(scene.pixels().unwrap().mapv(|v| (v * 7.0).sin())).unwrap();
    for anchor in [Anchor::Source, Anchor::Output] {
        let method = BasisConvolution::new(anchor);
        let forward = method.convolve(&model, &scene).unwrap();
        let back = method.adjoint(&model, &g, &scene).unwrap();
        let left = (&forward.pixels() * &g.pixels()).sum();
        let right = (&scene.pixels().unwrap() * &back.pixels()).sum();
        assert!((left / right - 1.0).abs() < 1e-12, "{left} {right}");
    }
}

#[test]
fn the_spot_check_sees_a_wrong_image() {
    let scene = test_scene(160, 120, 0);
    let model = model(RankSelection::Auto, Centring::Mean);
    let check = |image: &Image<f64>| {
        SpotCheck::run(image, 100, 3, |pixels| {
            Ok(Direct::default().at_pixels(&model, &scene, pixels)?)
        })
        .unwrap()
    };
    let good = BasisConvolution::default().convolve(&model, &scene).unwrap();
    assert!(check(&good).max_over_peak.unwrap() < ROUNDING);
    let patched = PatchConvolution::new(32, Anchor::Source)
        .unwrap()
        .convolve(&model, &scene)
        .unwrap();
    assert!(check(&patched).max_over_peak.unwrap() > 1e-4);
}
