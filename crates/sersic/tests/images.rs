//! Properties of whole images.

mod common;

use std::sync::atomic::{AtomicU64, Ordering};

use common::galaxy;
use ndarray::{Array2, s};
use psf_types::{Cancelled, Progress, SersicProfile, SersicSource};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sersic::{add_galaxies, add_galaxies_with_progress};

fn field(count: usize, size: f64) -> Vec<SersicSource> {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    (0..count)
        .map(|_| {
            let profile = SersicProfile::new(
                uniform(1.0, 5.0),
                uniform(0.5, 4.0),
                uniform(0.2, 1.0),
                uniform(0.0, 180.0),
            );
            let at = (uniform(-20.0, size + 20.0), uniform(-20.0, size + 20.0));
            galaxy(at, uniform(1.0, 1e4), profile.unwrap())
        })
        .collect()
}

#[test]
fn an_image_drawn_in_parts_equals_the_image_drawn_at_once() {
    let galaxies = field(30, 300.0);
    let mut whole = Array2::<f64>::zeros((300, 280));
    add_galaxies(whole.view_mut(), (-10, 5), &galaxies);
    for (y, x, ny, nx) in [(0, 0, 100, 280), (37, 101, 150, 7), (299, 0, 1, 1)] {
        let mut part = Array2::<f64>::zeros((ny, nx));
        add_galaxies(part.view_mut(), (-10 + x as i64, 5 + y as i64), &galaxies);
        assert_eq!(part, whole.slice(s![y..y + ny, x..x + nx]));
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let galaxies = field(40, 400.0);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut image = Array2::<f32>::zeros((400, 400));
        pool.install(|| add_galaxies(image.view_mut(), (0, 0), &galaxies));
        image
    };
    assert_eq!(with(1), with(7));
}

/// Cancels after some tiles.
#[derive(Default)]
struct Enough {
    tiles: u64,
    total: AtomicU64,
    done: AtomicU64,
}

impl Progress for Enough {
    fn start(&self, total: u64) {
        self.total.fetch_add(total, Ordering::Relaxed);
    }
    fn advance(&self, steps: u64) {
        self.done.fetch_add(steps, Ordering::Relaxed);
    }
    fn cancelled(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.tiles
    }
}

#[test]
fn drawing_stops_when_it_is_cancelled() {
    let galaxies = field(20, 600.0);
    let draw = |tiles: u64| {
        let enough = Enough {
            tiles,
            ..Enough::default()
        };
        let mut image = Array2::<f64>::zeros((600, 600));
        let ended = add_galaxies_with_progress(image.view_mut(), (0, 0), &galaxies, &enough);
        let (total, done) = (enough.total.into_inner(), enough.done.into_inner());
        (ended, total, done, image)
    };
    // 5 x 5 tiles of 128 pixels.
    let (ended, total, done, image) = draw(u64::MAX);
    assert_eq!((ended, total, done), (Ok(()), 25, 25));
    let mut plain = Array2::<f64>::zeros((600, 600));
    add_galaxies(plain.view_mut(), (0, 0), &galaxies);
    assert_eq!(image, plain);
    let (ended, total, done, _) = draw(0);
    assert_eq!((ended, total, done), (Err(Cancelled), 0, 0));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let (ended, total, done, _) = pool.install(|| draw(3));
    assert_eq!((ended, total), (Err(Cancelled), 25));
    // The other thread may have been at a tile with no check for cancellation left.
    assert!((3..=4).contains(&done), "{done}");
}

#[test]
fn light_is_added_and_scales_with_flux() {
    let galaxies = field(5, 100.0);
    let mut single = Array2::<f64>::zeros((100, 100));
    add_galaxies(single.view_mut(), (0, 0), &galaxies);
    let mut twice = single.clone();
    add_galaxies(twice.view_mut(), (0, 0), &galaxies);
    assert_eq!(twice, 2.0 * &single);
    let negative: Vec<_> = galaxies
        .iter()
        .map(|g| SersicSource::new(g.position(), -g.flux(), g.profile()).unwrap())
        .collect();
    add_galaxies(single.view_mut(), (0, 0), &negative);
    assert!(single.iter().all(|&v| v == 0.0));
}

#[test]
fn every_pixel_gets_positive_flux() {
    let mut image = Array2::<f64>::zeros((500, 500));
    let profile = SersicProfile::new(4.0, 8.0, 0.05, 20.0).unwrap();
    add_galaxies(image.view_mut(), (0, 0), &[galaxy((100.0, 120.0), 1.0, profile)]);
    assert!(image.iter().all(|&v| v > 0.0));
}

#[test]
fn extreme_galaxies_give_finite_images() {
    for (at, re) in [
        ((1e300, -1e300), 3.0),
        ((5.0, 5.0), 1e300),
        ((5.0, 5.0), 1e-300),
        ((1e17, 5.0), 1e18),
    ] {
        for n in [0.3, 1.0, 8.0] {
            let mut image = Array2::<f64>::zeros((11, 11));
            let profile = SersicProfile::new(re, n, 1e-3, 7.0).unwrap();
            add_galaxies(image.view_mut(), (0, 0), &[galaxy(at, 1.0, profile)]);
            assert!(
                image.iter().all(|v| v.is_finite() && *v >= 0.0),
                "{at:?} {re} {n}"
            );
            if re < 1.0 {
                assert!(
                    (image[[5, 5]] - 1.0).abs() < 1e-6,
                    "a tiny galaxy stays in its pixel: {}",
                    image[[5, 5]]
                );
            }
        }
    }
    add_galaxies(Array2::<f32>::zeros((0, 4)).view_mut(), (0, 0), &field(2, 10.0));
}

/// `cargo test --release -p sersic --test images -- --ignored --nocapture`
#[test]
#[ignore = "a measurement of time, not a check"]
fn time_of_a_thousand_galaxies() {
    for n in [1.0, 2.0, 4.0] {
        let galaxies: Vec<_> = field(1000, 1024.0)
            .iter()
            .map(|g| {
                let shape = SersicProfile::new(3.0, n, g.profile().axis_ratio(), g.profile().angle_deg());
                SersicSource::new(g.position(), g.flux(), shape.unwrap()).unwrap()
            })
            .collect();
        let mut image = Array2::<f32>::zeros((1024, 1024));
        let start = std::time::Instant::now();
        add_galaxies(image.view_mut(), (0, 0), &galaxies);
        println!("n = {n}: {:.3} s", start.elapsed().as_secs_f64());
    }
}
