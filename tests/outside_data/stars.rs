//! Stars between pixels, drawn from an oversampled ePSF, against GalSim's.

use std::time::Instant;

use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::metrics::Comparison;
use psfield::psf_types::{NoProgress, Normalisation, PointSource, Position};
use psfield::{Device, FitOptions, Method, Psf, Scene, SimulateOptions, Simulator, psf_io};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::data::{ensure, file, trial};

/// GalSim itself is accurate to 1e-3 of the peak here. photutils' bicubic spline, cut to the same
/// pixels, reaches 8.6e-4.
const STARS_L2: f64 = 1.0e-3;
/// Largest ratio of the time for a star between pixels to the time for a star on a pixel. The star
/// on a pixel uses an equal field sampled at the instrument's pixels (64 x 64).
const TIMES_ONE_PIXEL: f64 = 2.0;
/// The number of stars in a frame of the method's paper.
const STARS: usize = 2916;
/// The truth holds 25 x 25 pixels of each star.
const SIZE: usize = 25;
const FRAME: usize = 1024;
const OVERSAMPLED: &str = "roman/epsf4x_samples1024.fits";
const NATIVE: &str = "roman/samples1024.fits";

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("stars_as_galsim_draws_them".into(), as_galsim),
        // Timings need an idle machine: `-- --ignored stars_between_pixels_in_time --nocapture`.
        trial("stars_between_pixels_in_time".into(), in_time).with_ignored_flag(true),
    ]
}

fn psf(samples: &str) -> Result<Psf, Failed> {
    let options = FitOptions {
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    let samples = psf_io::read_samples(file(samples))?;
    Ok(Psf::new(samples, options))
}

fn simulator(psf: &Psf, method: Method, stamp_size: Option<usize>) -> Result<Simulator<f32>, Failed> {
    let options = SimulateOptions {
        method,
        stamp_size,
        device: Device::Cpu,
        ..SimulateOptions::default()
    };
    Ok(psf.simulator((FRAME, FRAME)).options(options).build()?)
}

fn as_galsim() -> Result<(), Failed> {
    let truth = psf_io::read_image::<f64>(file("roman/stars_truth.fits"))?
        .into_parts()
        .0;
    let stars = psf_io::read_catalog(file("roman/stars.csv"))?;
    let scene = Scene::<f32>::dark().with_stars(stars);
    let psf = psf(OVERSAMPLED)?;
    for method in [Method::Auto, Method::Direct] {
        let image = simulator(&psf, method, Some(SIZE))?.simulate(&scene)?;
        let image = image.pixels().mapv(f64::from);
        let error = Comparison::of(image.view(), truth.pixels())?.relative_l2();
        println!("roman stars, {method}: relative L2 {error:?}");
        ensure(error.as_ref().is_ok_and(|&e| e <= STARS_L2), || {
            format!("{method}: relative L2 {error:?}, at most {STARS_L2} expected")
        })?;
    }
    Ok(())
}

/// Compares the times of [`STARS`] stars on pixels and between pixels, with a ready plan and the
/// image in memory. Stars on pixels use the native stamps and the oversampled ePSF.
fn in_time() -> Result<(), Failed> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let last = FRAME as f64 - 1.0;
    let mut light = Array2::<f32>::zeros((FRAME, FRAME));
    let mut stars = Vec::new();
    for _ in 0..STARS {
        let (x, y): (f64, f64) = (rng.random_range(0.0..last), rng.random_range(0.0..last));
        light[[y as usize, x as usize]] += 100.0;
        stars.push(PointSource::new(Position::new(x, y)?, 100.0)?);
    }
    let pixels = Scene::new(light)?;
    let between = Scene::<f32>::dark().with_stars(stars);
    let seconds = |samples: &str, size: Option<usize>, scene: &Scene<'_, f32>| -> Result<f64, Failed> {
        let simulator = simulator(&psf(samples)?, Method::Auto, size)?;
        simulator.prepare(scene, &NoProgress)?;
        let mut fastest = f64::INFINITY;
        for _ in 0..15 {
            let mut image = Array2::zeros((FRAME, FRAME));
            image.fill(1.0);
            let clock = Instant::now();
            simulator.simulate_into(scene, image.view_mut(), &NoProgress)?;
            fastest = fastest.min(clock.elapsed().as_secs_f64());
        }
        Ok(fastest)
    };
    let on = seconds(NATIVE, None, &pixels)?;
    let small = seconds(OVERSAMPLED, Some(SIZE), &pixels)?;
    let between = seconds(OVERSAMPLED, Some(SIZE), &between)?;
    println!(
        "{STARS} stars between pixels {:.2} ms: {:.2} times those on pixels ({:.2} ms), {:.2} times those of {SIZE} x {SIZE} pixels \
         ({:.2} ms)",
        1e3 * between,
        between / on,
        1e3 * on,
        between / small,
        1e3 * small,
    );
    ensure(between <= TIMES_ONE_PIXEL * on, || {
        format!("{between} s between pixels, {on} s on them")
    })
}
