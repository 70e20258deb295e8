//! Derivatives with respect to sources, compared with differences of images.

use std::sync::Arc;

use ndarray::{Array2, Array3};
use psf_types::{ImageView, NoProgress, PointSource, Position, SersicProfile, SersicSource};
use psfield::prelude::*;
use psfield::{GalaxyGradient, ProfileSource};
use sersic::SersicLight;

/// Differences over a step, relative to the largest derivative with respect to the same parameter.
const DIFFERENCES: f64 = 1e-5;

fn simulator() -> Simulator<f64> {
    let corners = [(0.0, 0.0), (59.0, 0.0), (0.0, 49.0), (59.0, 49.0)];
    let stamps = Array3::from_shape_fn((4, 25, 25), |(j, y, x)| {
        let (x, y) = (x as f64 - 12.0, y as f64 - 12.0);
        (-(x * x + y * y) / (7.0 + j as f64) - 0.02 * j as f64 * x * y).exp()
    });
    let psf = Psf::from_samples(stamps.view(), &corners).unwrap();
    psf.simulator((50, 60)).tolerance(1e-9).build().unwrap()
}

/// An image of large features.
fn image() -> Array2<f64> {
    Array2::from_shape_fn((50, 60), |(y, x)| {
        (0.2 * x as f64).sin() * (0.13 * y as f64 + 0.5).cos()
    })
}

fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

/// Half-light radius, index, axis ratio and angle: in the middle of their ranges, and at the ends of some.
const PROFILES: [[f64; 4]; 3] = [
    [2.0, 1.2, 0.6, 30.0],
    [1.5, 0.5, 1.0, 0.0],
    [1.0, 2.5, 0.4, -400.0],
];

fn galaxy(number: usize, [re, n, q, angle]: [f64; 4]) -> SersicSource {
    let profile = SersicProfile::new(re, n, q, angle).unwrap();
    SersicSource::new(at(15.3 + 14.0 * number as f64, 24.6), 100.0, profile).unwrap()
}

#[test]
fn derivatives_with_respect_to_galaxies() {
    let (simulator, image) = (simulator(), image());
    let galaxies: Vec<SersicSource> = (0..3).map(|i| galaxy(i, PROFILES[i])).collect();
    let scene = Scene::dark().with_galaxies(galaxies);
    let view = ImageView::new(image.view()).unwrap();
    let found = simulator.source_gradients(&scene, &view, &NoProgress).unwrap();
    let derivatives = |g: &GalaxyGradient| [g.half_light_radius_px, g.index, g.axis_ratio, g.angle_deg];
    for parameter in 0..4 {
        let all: Vec<f64> = found.galaxies.iter().map(|g| derivatives(g)[parameter]).collect();
        let largest = all.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        for (number, derivative) in all.into_iter().enumerate() {
            let value = |step: f64| {
                let mut profile = PROFILES[number];
                profile[parameter] += step;
                if profile[2] > 1.0 {
                    // The longer axis of this ellipse lies across the angle.
                    profile = [
                        profile[0] * profile[2],
                        profile[1],
                        1.0 / profile[2],
                        profile[3] + 90.0,
                    ];
                }
                let scene = Scene::dark().with_galaxies(vec![galaxy(number, profile)]);
                (&simulator.simulate(&scene).unwrap().pixels() * &image).sum()
            };
            let step = if parameter == 3 { 0.3 } else { 3e-3 };
            let [near, far] = [1.0, 2.0].map(|n| value(n * step) - value(-n * step));
            let difference = (8.0 * near - far) / (12.0 * step);
            assert!(
                (derivative - difference).abs() < DIFFERENCES * largest,
                "galaxy {number}, parameter {parameter}: {derivative} {difference}"
            );
        }
    }
}

/// Sources of the caller's own, galaxies at the ends of ranges, and sources that do not reach the image.
#[test]
fn each_source_has_its_own_derivatives() {
    let (simulator, image) = (simulator(), image());
    let view = ImageView::new(image.view()).unwrap();
    let profile = SersicProfile::new(2.0, 1.0, 0.5, 10.0).unwrap();
    let (flux, near) = (100.0, at(30.2, 20.7));
    let own = ProfileSource {
        point: PointSource::new(near, flux).unwrap(),
        light: Arc::new(SersicLight::of_profile(profile)),
    };
    let narrow = SersicProfile::new(2.0, 8.0, 0.001, 1e18).unwrap();
    let galaxies = vec![
        SersicSource::new(
            at(-900.0, 0.0),
            flux,
            SersicProfile::new(1.0, 0.5, 1.0, 0.0).unwrap(),
        )
        .unwrap(),
        SersicSource::new(near, flux, profile).unwrap(),
        SersicSource::new(near, flux, narrow).unwrap(),
    ];
    let stars = [at(30.2, 20.7), at(1e9, 3.0)].map(|at| PointSource::new(at, flux).unwrap());
    let scene = Scene::dark()
        .with_stars(stars.to_vec())
        .with_galaxies(galaxies)
        .with_profiles(vec![own]);
    let found = simulator.source_gradients(&scene, &view, &NoProgress).unwrap();
    assert_eq!(found.galaxies[0], GalaxyGradient::default());
    assert_eq!(found.galaxies[1].point, found.profiles[0]);
    let of_narrow = found.galaxies[2];
    assert_eq!(
        of_narrow.angle_deg, 0.0,
        "a step of the angle is lost in rounding"
    );
    assert!(of_narrow.index.is_finite() && of_narrow.index != 0.0 && of_narrow.axis_ratio.is_finite());
    assert!(found.stars[0].x != 0.0);
    assert_eq!((found.stars[1].flux, found.stars[1].x), (0.0, 0.0));
    let empty = simulator
        .source_gradients(&Scene::dark(), &view, &NoProgress)
        .unwrap();
    assert_eq!(empty, psfield::SourceGradients::default());
}
