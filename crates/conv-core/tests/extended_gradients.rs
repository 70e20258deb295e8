//! Derivatives with respect to galaxies, compared with differences of images.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Waves, noise, region};
use conv_core::{ConvReal, ExtendedGradient, ExtendedSources, Light, PlanOptions, SourcePlan, Variation};
use ndarray::{Array2, Array3, Axis, s};
use psf_types::{
    Anchor, NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfBasis, PsfModel, SersicProfile,
    SersicSource, StampGrid,
};
use sersic::SersicLight;

/// The frame, in pixels of the scene.
fn frame() -> PixelRegion {
    region(13, 7, 150, 90)
}

/// Flux, x, y, re, n, q, angle.
type Parameters = [f64; 7];
const NAMES: [&str; 7] = ["flux", "x", "y", "re", "n", "q", "angle"];

/// The differences of the variations' parameters, half on either side.
const STEPS: [f64; 4] = [2e-4, 2e-4, 2e-4, 2e-2];

const GALAXIES: [Parameters; 6] = [
    [1.0, 60.3, 40.7, 1.3, 1.0, 0.6, 30.0],
    [2.0, 100.1, 60.2, 4.0, 0.7, 0.9, 100.0],
    [-1.0, 20.9, 88.4, 2.0, 2.5, 0.3, 70.0],
    // With light far outside the window.
    [3.0, 90.2, 30.6, 3.0, 4.0, 0.7, 160.0],
    // Beyond the frame, and without flux.
    [1.0, 3.0, 50.0, 6.0, 1.5, 0.8, 10.0],
    [0.0, 70.4, 70.1, 0.2, 1.0, 0.5, 45.0],
];

fn model(oversampling: f64) -> PsfModel {
    let side = (21.0 * oversampling) as usize;
    let grid = StampGrid::new(side, side)
        .and_then(|grid| grid.with_oversampling(oversampling))
        .unwrap();
    // Gaussians of four shapes. The mean is bright, so that the PSF is positive.
    let mut stamps = Array3::from_shape_fn((4, side, side), |(k, y, x)| {
        let at = |i: usize, centre: f64| (i as f64 - centre) / oversampling;
        let (x, y, k) = (at(x, grid.centre_x()), at(y, grid.centre_y()), k as f64);
        let (along, across) = (2.2 + 0.4 * k, 2.8 - 0.3 * k);
        (-(x + 0.1 * k * y).powi(2) / (2.0 * along) - y * y / (2.0 * across)).exp()
    });
    let mean = stamps.index_axis(Axis(0), 0).mapv(|v| 10.0 * v);
    for k in 1..4 {
        for j in 1..k {
            let other = stamps.index_axis(Axis(0), j).to_owned();
            let overlap = (&other * &stamps.index_axis(Axis(0), k)).sum();
            stamps.index_axis_mut(Axis(0), k).scaled_add(-overlap, &other);
        }
        let mut stamp = stamps.index_axis_mut(Axis(0), k);
        let norm = stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
        stamp.mapv_inplace(|v| v / norm);
    }
    let components = stamps.slice(s![1.., .., ..]).to_owned();
    let basis = PsfBasis::new(Some(mean), components, grid).unwrap();
    PsfModel::new(&basis, Arc::new(Waves), Normalisation::Unit, None).unwrap()
}

fn light(p: &Parameters) -> Light {
    let profile = SersicProfile::new(p[3], p[4], p[5], p[6]).unwrap();
    let source = SersicSource::new(Position::new(p[1], p[2]).unwrap(), 1.0, profile).unwrap();
    Arc::new(SersicLight::new(&source))
}

fn point(p: &Parameters) -> PointSource {
    PointSource::new(Position::new(p[1], p[2]).unwrap(), p[0]).unwrap()
}

fn moved(p: &Parameters, parameter: usize, step: f64) -> Parameters {
    let mut moved = *p;
    moved[parameter] += step;
    moved
}

fn variations(p: &Parameters) -> Vec<Variation> {
    let variation = |(i, step): (usize, f64)| Variation {
        before: light(&moved(p, 3 + i, -0.5 * step)),
        after: light(&moved(p, 3 + i, 0.5 * step)),
        step,
    };
    STEPS.into_iter().enumerate().map(variation).collect()
}

fn gradients<T: ConvReal>(plan: &SourcePlan<T>, of: PixelRegion, image: &Array2<f64>) -> Vec<Parameters> {
    let points = GALAXIES.each_ref().map(point);
    let sources = ExtendedSources {
        points: &points,
        light: &|index| light(&GALAXIES[index]),
    };
    let image = image.mapv(T::nearest);
    let found = plan.extended_gradients(
        sources,
        &|index| variations(&GALAXIES[index]),
        (frame(), of),
        image.view(),
        &NoProgress,
    );
    let all = |g: ExtendedGradient| {
        let [re, n, q, angle] = g.variations.as_slice().try_into().unwrap_or([0.0; 4]);
        [g.point.flux, g.point.x, g.point.y, re, n, q, angle]
    };
    found.unwrap().into_iter().map(all).collect()
}

/// The scalar product of an image with a galaxy.
fn product(plan: &SourcePlan<f64>, p: &Parameters, of: PixelRegion, image: &Array2<f64>) -> f64 {
    let mut drawn = Array2::zeros(image.dim());
    let sources = ExtendedSources {
        points: &[point(p)],
        light: &|_| light(p),
    };
    plan.draw_extended_into(sources, frame(), of, drawn.view_mut(), &NoProgress)
        .unwrap();
    (&drawn * image).sum()
}

fn plan<T: ConvReal>(oversampling: f64, anchor: Anchor, tolerance: f64) -> SourcePlan<T> {
    let options = PlanOptions::new(tolerance).unwrap().with_anchor(anchor);
    SourcePlan::new(&model(oversampling), options, None).unwrap()
}

/// An image of features as large as a galaxy, and noise.
fn image(of: PixelRegion) -> Array2<f64> {
    let noise = noise(of.shape().ny(), of.shape().nx(), 9);
    let wave = |(y, x): (usize, usize)| (0.3 * x as f64).sin() * (0.21 * y as f64 + 0.4).cos();
    Array2::from_shape_fn(noise.dim(), |at| wave(at) + 0.3 * noise[at])
}

/// The largest error of each parameter's derivative, relative to the largest derivative.
fn errors(found: &[Parameters], expected: &[Parameters]) -> Parameters {
    std::array::from_fn(|parameter| {
        let all = || found.iter().zip(expected);
        let largest = all().map(|(_, e)| e[parameter].abs()).fold(0.0, f64::max);
        let error = all()
            .map(|(f, e)| (f[parameter] - e[parameter]).abs())
            .fold(0.0, f64::max);
        error / largest
    })
}

#[test]
fn derivatives_are_differences() {
    let part = region(40, 0, 70, 71);
    for (oversampling, anchor, of) in [
        (1.0, Anchor::Source, frame().shape().region()),
        (2.0, Anchor::Source, part),
        (1.7, Anchor::Source, part),
        (2.0, Anchor::Output, part),
    ] {
        let (plan, image) = (plan::<f64>(oversampling, anchor, 1e-9), image(of));
        let found = gradients(&plan, of, &image);
        let differences: Vec<Parameters> = GALAXIES
            .iter()
            .map(|p| {
                std::array::from_fn(|parameter| {
                    let step = if parameter == 6 { 0.5 } else { 5e-3 };
                    let value = |n: f64| product(&plan, &moved(p, parameter, n * step), of, &image);
                    let [near, far] = [1.0, 2.0].map(|n| value(n) - value(-n));
                    (8.0 * near - far) / (12.0 * step)
                })
            })
            .collect();
        for (name, error) in NAMES.iter().zip(errors(&found, &differences)) {
            assert!(error < 1e-5, "{oversampling} {anchor:?} {name}: {error:e}");
        }
    }
}

/// Single precision, and modes within a tolerance.
#[test]
fn derivatives_keep_the_tolerance() {
    let of = frame().shape().region();
    let image = image(of);
    let exact = gradients(&plan::<f64>(2.0, Anchor::Source, 1e-9), of, &image);
    for (tolerance, within) in [(1e-5, 1e-4), (1e-3, 1e-2)] {
        let found = gradients(&plan::<f32>(2.0, Anchor::Source, tolerance), of, &image);
        for (name, error) in NAMES.iter().zip(errors(&found, &exact)) {
            assert!(error < within, "{tolerance} {name}: {error:e}");
        }
    }
}
