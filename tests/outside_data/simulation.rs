//! Images of real PSFs and real galaxies against the two truths, one for each anchoring.

use libtest_mimic::{Failed, Trial};
use psfield::conv_core::{BasisConvolution, ConvReal};
use psfield::metrics::Comparison;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{Anchor, FrameShape, Image, NoProgress, Normalisation};
use psfield::{FitOptions, Method, Psf, Scene, Simulator};
use rand::SeedableRng;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;

use crate::data::{Field, ROMAN, STRONG, ensure, trial};

/// The truth is stored in single precision, which adds an error of 2e-8.
const DOUBLE: f64 = 1e-7;
/// In single precision, the transforms of a few hundred components round to a few 1e-7 in total.
const SINGLE: f64 = 1e-6;
/// Rounding of sums of a few thousand products in double precision, relative to the peak.
const EXACT: f64 = 1e-12;
/// The quoted errors of the uncentred truncations have two digits.
const QUOTED: f64 = 0.1;

/// The two anchorings and the names of their truths.
pub(crate) const ANCHORS: [(Anchor, &str); 2] = [(Anchor::Source, "source"), (Anchor::Output, "output")];
/// Every component, centred.
pub(crate) const FULL: FitOptions = FitOptions {
    shift_copies: 0,
    rank: RankSelection::Full,
    centring: Centring::Mean,
    noise: psfield::psf_basis::PixelNoise::Known(0.0),
    interpolation: psfield::psf_types::Interpolation::Bilinear,
    outside: psfield::psf_types::OutsidePolicy::Nearest,
    normalisation: Normalisation::Keep,
};

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    for field in [ROMAN, STRONG] {
        for (anchor, name) in ANCHORS {
            let label = |what: &str| format!("{}, {name}-anchored: {what}", field.name);
            trials.push(trial(label("basis f64"), move || {
                full_rank::<f64>(field, anchor, name, DOUBLE)
            }));
            trials.push(trial(label("basis f32"), move || {
                full_rank::<f32>(field, anchor, name, SINGLE)
            }));
            trials.push(trial(label("direct sum"), move || direct(field, anchor, name)));
        }
    }
    trials.push(trial(
        "strong: the wrong anchoring is noticed".to_owned(),
        wrong_anchoring,
    ));
    trials.push(trial("strong: these stamps have unit flux".to_owned(), unit_flux));
    for (field, rank, quoted) in [(ROMAN, 6, 4.6e-5), (STRONG, 20, 2.0e-4)] {
        let name = format!("{}: {rank} uncentred components", field.name);
        trials.push(trial(name, move || uncentred(field, rank, quoted)));
    }
    trials.push(trial("strong: total flux at every rank".to_owned(), total_flux));
    trials.push(trial("roman: adjoint".to_owned(), adjoint));
    trials
}

/// Convolves by whole-image transforms.
fn simulator<T: ConvReal>(psf: &Psf, shape: FrameShape, anchor: Anchor) -> Result<Simulator<T>, Failed> {
    let simulator = psf.simulator((shape.ny(), shape.nx()));
    Ok(simulator.method(Method::Basis).anchor(anchor).build()?)
}

fn relative_l2<T: ConvReal>(field: Field, psf: &Psf, anchor: Anchor, truth: &str) -> Result<f64, Failed> {
    let scene = field.scene::<T>()?;
    let image = simulator(psf, scene.shape(), anchor)?.simulate(&Scene::from(&scene))?;
    let comparison = Comparison::of(image.pixels(), field.truth(truth)?.pixels())?;
    Ok(comparison.relative_l2()?)
}

fn full_rank<T: ConvReal>(field: Field, anchor: Anchor, truth: &str, limit: f64) -> Result<(), Failed> {
    let error = relative_l2::<T>(field, &field.psf(FULL)?, anchor, truth)?;
    println!("{} {truth} {}: relative L2 {error:.3e}", field.name, T::NAME);
    ensure(error <= limit, || {
        format!("relative L2 {error:.3e} exceeds {limit:e}")
    })
}

fn direct(field: Field, anchor: Anchor, truth: &str) -> Result<(), Failed> {
    let scene = field.scene::<f64>()?;
    let simulator = simulator(&field.psf(FULL)?, scene.shape(), anchor)?;
    let exact = field.exact(truth)?;
    let peak = field
        .truth(truth)?
        .pixels()
        .iter()
        .fold(0.0f64, |m, v| m.max(v.abs()));
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let some: Vec<_> = exact.sample(&mut rng, 200).copied().collect();
    let pixels: Vec<_> = some.iter().map(|&(pixel, _)| pixel).collect();
    let values = simulator.exact_at(&Scene::from(&scene), &pixels, &NoProgress)?;
    let largest = values
        .iter()
        .zip(&some)
        .fold(0.0f64, |m, (v, (_, t))| m.max((v - t).abs()))
        / peak;
    // Most of these pixels are far fainter than the peak, so the norm of their values is a stricter
    // scale.
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let own = norm(&mut values.iter().zip(&some).map(|(v, (_, t))| v - t))
        / norm(&mut some.iter().map(|(_, t)| *t));
    println!(
        "{} {truth} direct: largest / peak {largest:.1e}, relative L2 {own:.1e}",
        field.name
    );
    ensure(largest <= EXACT && own <= EXACT, || {
        format!("largest difference over peak {largest:.3e}, relative L2 {own:.3e}; at most {EXACT:e}")
    })
}

fn wrong_anchoring() -> Result<(), Failed> {
    for (anchor, truth) in [(Anchor::Source, "output"), (Anchor::Output, "source")] {
        let error = relative_l2::<f64>(STRONG, &STRONG.psf(FULL)?, anchor, truth)?;
        println!("strong {anchor} against {truth}: relative L2 {error:.3e}");
        ensure(error > 1e-3, || {
            format!("the comparison does not tell {anchor} from {truth}: {error:.3e}")
        })?;
    }
    Ok(())
}

/// The default normalisation does not change stamps that already have unit flux.
fn unit_flux() -> Result<(), Failed> {
    let options = FitOptions {
        normalisation: Normalisation::Unit,
        ..FULL
    };
    let psf = Psf::new(STRONG.samples()?, options);
    let error = relative_l2::<f64>(STRONG, &psf, Anchor::Source, "source")?;
    ensure(error <= DOUBLE, || {
        format!("relative L2 {error:.3e} exceeds {DOUBLE:e}")
    })
}

fn uncentred(field: Field, rank: usize, quoted: f64) -> Result<(), Failed> {
    let options = FitOptions {
        rank: RankSelection::Fixed(rank),
        centring: Centring::None,
        ..FULL
    };
    let error = relative_l2::<f64>(field, &field.psf(options)?, Anchor::Source, "source")?;
    println!("{} K = {rank} uncentred: relative L2 {error:.3e}", field.name);
    ensure((error / quoted - 1.0).abs() <= QUOTED, || {
        format!("relative L2 {error:.3e}, expected {quoted:e}")
    })
}

fn total_flux() -> Result<(), Failed> {
    let mut scene = STRONG.scene::<f64>()?.into_pixels();
    // No light leaves the frame if a border wider than half a stamp is without light.
    let (ny, nx) = scene.dim();
    for ((y, x), value) in scene.indexed_iter_mut() {
        if y < 33 || x < 33 || y >= ny - 33 || x >= nx - 33 {
            *value = 0.0;
        }
    }
    let total = scene.sum();
    let scene = Image::new(scene)?;
    for rank in [0, 1, 5, 20, 100, 224] {
        let options = FitOptions {
            rank: RankSelection::Fixed(rank),
            normalisation: Normalisation::Unit,
            ..FULL
        };
        let psf = Psf::new(STRONG.samples()?, options);
        let image = simulator(&psf, scene.shape(), Anchor::Source)?.simulate(&Scene::from(&scene))?;
        let error = (image.pixels().sum() / total - 1.0).abs();
        println!("strong K = {rank}: flux off by {error:.1e}");
        ensure(error <= 1e-12, || {
            format!("K = {rank}: the flux is off by {error:.3e}")
        })?;
    }
    Ok(())
}

fn adjoint() -> Result<(), Failed> {
    let options = FitOptions {
        rank: RankSelection::Fixed(6),
        ..FULL
    };
    let scene = ROMAN.scene::<f64>()?;
    let psf = ROMAN.psf(options)?;
    let model = psf.model()?;
    let g = ROMAN.truth("output")?;
    for (anchor, _) in ANCHORS {
        let shape = scene.shape();
        let forward = simulator(&psf, shape, anchor)?.simulate(&Scene::from(&scene))?;
        let method = BasisConvolution::new(anchor);
        let back = method.adjoint(model, &g.view(), shape, shape.region())?;
        let dot = |a: ndarray::ArrayView2<'_, f64>, b: ndarray::ArrayView2<'_, f64>| (&a * &b).sum();
        let left = dot(forward.pixels(), g.pixels());
        let right = dot(scene.pixels(), back.pixels());
        let error = (left / right - 1.0).abs();
        println!("roman {anchor} adjoint: off by {error:.1e}");
        ensure(error <= 1e-12, || {
            format!("<A f, g> = {left:e}, <f, A^T g> = {right:e}")
        })?;
    }
    Ok(())
}
