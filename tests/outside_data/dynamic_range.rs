//! Faint light next to bright light, in single precision.

use integration_tests::{convolve, direct_at};
use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::conv_core::{LowRank, Paths, PlanOptions};
use psfield::psf_types::{Anchor, Image, PsfModel};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::data::{ExactPixel, STRONG, ensure, trial};
use crate::simulation::{ANCHORS, FULL};

/// Largest relative L2 error of the faint pixels.
const FAINT: f64 = 1e-5;
/// Only pixels above this fraction of the faint light's peak are compared.
const DOWN_TO: f64 = 1e-3;
/// Error of the engine in double precision against the double sum, relative to the peak of the
/// faint light.
const EXACT: f64 = 1e-12;
/// Rounding of the transforms in single precision, relative to the peak of the whole image.
const NOISE: f64 = 1e-6;
/// Smallest relative error with only transforms: next to a star of 1e8 they lose the faint light.
const DROWNED: f64 = 1e-2;
/// Number of galaxies, each of flux 1.
const GALAXIES: usize = 60;
const SPOT_CHECKS: usize = 200;

/// Pixels of bright light, `(x, y, flux)`.
type Bright = Vec<(usize, usize, f32)>;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("strong: galaxies next to a star of 1e8".to_owned(), || {
            let star = vec![(301, 222, 1e8)];
            beside("a star", &star, Some(FAINT))
        }),
        trial("strong: galaxies next to 20 stars up to 1e8".to_owned(), || {
            beside("20 stars", &stars(), Some(FAINT))
        }),
        trial("strong: galaxies next to a bright galaxy".to_owned(), || {
            beside("a bright galaxy", &bright_galaxy(), None)
        }),
    ]
}

fn stars() -> Bright {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    (0..20)
        .map(|n| {
            let flux = 10_f32.powf(4.0 + 4.0 * n as f32 / 19.0);
            (rng.random_range(0..512), rng.random_range(0..512), flux)
        })
        .collect()
}

/// 200 pixels of 1e7: a disc around a pixel.
fn bright_galaxy() -> Bright {
    let mut pixels: Vec<(usize, usize)> = (0..41 * 41).map(|n| (n % 41, n / 41)).collect();
    pixels.sort_by_key(|&(x, y)| x.abs_diff(20).pow(2) + y.abs_diff(20).pow(2));
    pixels.truncate(200);
    pixels.into_iter().map(|(x, y)| (280 + x, 200 + y, 1e7)).collect()
}

/// Exponential discs of flux 1, out to eight scale lengths.
fn galaxies() -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut light = Array2::<f32>::zeros((512, 512));
    for _ in 0..GALAXIES {
        let (cx, cy) = (rng.random_range(0.0..512.0), rng.random_range(0.0..512.0));
        let length: f64 = rng.random_range(1.5..5.0);
        for ((y, x), value) in light.indexed_iter_mut() {
            let r = f64::hypot(x as f64 - cx, y as f64 - cy) / length;
            if r < 8.0 {
                *value += ((-r).exp() / (std::f64::consts::TAU * length * length)) as f32;
            }
        }
    }
    light
}

fn options(anchor: Anchor, paths: Paths) -> Result<PlanOptions, Failed> {
    Ok(PlanOptions::new(0.0)?.with_anchor(anchor).with_paths(paths))
}

/// The image of only the faint light, in double precision. This is the truth wherever no stamp of a
/// bright pixel reaches. The double sum of all light checks it at some pixels.
fn truth(
    model: &PsfModel,
    all: &Array2<f32>,
    bright: &Bright,
    anchor: Anchor,
) -> Result<Vec<ExactPixel>, Failed> {
    let mut faint = all.mapv(f64::from);
    for &(x, y, _) in bright {
        faint[[y, x]] = 0.0;
    }
    let engine = LowRank::new(options(anchor, Paths::Cheapest)?);
    let image = convolve(&engine, model, &Image::new(faint)?)?;
    let image = image.into_pixels();
    let peak = image.iter().fold(0.0_f64, |m, v| m.max(*v));
    let (cx, cy) = model
        .grid()
        .whole_centre()
        .ok_or("the stamps have no central pixel")?;
    let reached = |x: usize, y: usize| {
        bright.iter().any(|&(star_x, star_y, _)| {
            (x + cx).wrapping_sub(star_x) < model.grid().nx()
                && (y + cy).wrapping_sub(star_y) < model.grid().ny()
        })
    };
    let pixels: Vec<ExactPixel> = image
        .indexed_iter()
        .filter(|&((y, x), &value)| value > DOWN_TO * peak && !reached(x, y))
        .map(|((y, x), &value)| ((x, y), value))
        .collect();
    let some: Vec<_> = pixels
        .iter()
        .step_by((pixels.len() / SPOT_CHECKS).max(1))
        .collect();
    let at: Vec<(usize, usize)> = some.iter().map(|(pixel, _)| *pixel).collect();
    let whole = Image::new(all.mapv(f64::from))?;
    let sums = direct_at(model, &whole, anchor, &at)?;
    let off = sums
        .iter()
        .zip(&some)
        .fold(0.0_f64, |m, (sum, (_, value))| m.max((sum - value).abs()));
    ensure(off <= EXACT * peak, || {
        format!("the error of the truth is {:.3e} of the faint peak", off / peak)
    })?;
    Ok(pixels)
}

/// Errors of the faint pixels in an image in single precision.
struct FaintPixels {
    /// Relative L2 error.
    error: f64,
    /// The largest difference over the peak of the whole image.
    noise: f64,
    /// The fraction of faint pixels with a relative error above one thousandth.
    spoilt: f64,
}

fn faint_pixels(image: &Image<f32>, truth: &[ExactPixel]) -> FaintPixels {
    let peak = image.pixels().iter().fold(0.0_f64, |m, &v| m.max(f64::from(v)));
    let (mut difference, mut whole, mut noise, mut spoilt) = (0.0, 0.0, 0.0_f64, 0_usize);
    for &((x, y), value) in truth {
        let off = f64::from(image.pixels()[[y, x]]) - value;
        difference += off * off;
        whole += value * value;
        noise = noise.max(off.abs() / peak);
        spoilt += usize::from(off.abs() > 1e-3 * value);
    }
    FaintPixels {
        error: (difference / whole).sqrt(),
        noise,
        spoilt: spoilt as f64 / truth.len() as f64,
    }
}

fn beside(name: &str, bright: &Bright, limit: Option<f64>) -> Result<(), Failed> {
    let model = STRONG.model(FULL)?;
    let mut all = galaxies();
    for &(x, y, flux) in bright {
        all[[y, x]] += flux;
    }
    let light = Image::new(all.clone())?;
    for (anchor, anchored) in ANCHORS {
        let truth = truth(&model, &all, bright, anchor)?;
        let by = |paths| -> Result<FaintPixels, Failed> {
            let image = convolve(&LowRank::new(options(anchor, paths)?), &model, &light)?;
            Ok(faint_pixels(&image, &truth))
        };
        let (cheapest, transforms) = (by(Paths::Cheapest)?, by(Paths::Transforms)?);
        println!(
            "strong, {anchored}-anchored, next to {name}: {} faint pixels, relative L2 {:.1e}, largest difference over the \
             image's peak {:.1e}, {:.1}% wrong by 1e-3 or more. With transforms only: {:.1e}, {:.1e}, {:.1}%",
            truth.len(),
            cheapest.error,
            cheapest.noise,
            100.0 * cheapest.spoilt,
            transforms.error,
            transforms.noise,
            100.0 * transforms.spoilt
        );
        ensure(cheapest.noise <= NOISE && transforms.noise <= NOISE, || {
            format!(
                "{anchored}: differences of {:.3e} and {:.3e} of the peak",
                cheapest.noise, transforms.noise
            )
        })?;
        if let Some(limit) = limit {
            ensure(cheapest.error <= limit, || {
                format!("{anchored}: relative L2 {:.3e}", cheapest.error)
            })?;
            ensure(transforms.error > DROWNED, || {
                format!(
                    "{anchored}: the relative error of transforms is only {:.3e}, so this test proves nothing",
                    transforms.error
                )
            })?;
        }
    }
    Ok(())
}
