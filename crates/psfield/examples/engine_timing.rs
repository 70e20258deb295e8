use conv_core::*;
use psf_types::*;
use std::time::Instant;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let n: usize = args[2].parse().unwrap();
    let tols: Vec<f64> = args[3].split(',').map(|t| t.parse().unwrap()).collect();
    let t = Instant::now();
    let psf = psfield::PsfInput::open(&args[1], psfield::FitOptions::default()).unwrap();
    let model = psf.into_model().unwrap();
    println!("fit {:.2} rank {}", t.elapsed().as_secs_f64(), model.rank());
    let mut x = 1u64;
    let light = ndarray::Array2::from_shape_simple_fn((n, n), || {
        x = x
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        ((x >> 40) as f32) / 16777216.0 + 0.01
    });
    let scene = Scene::from_image(Image::new(light).unwrap());
    for tol in tols {
        for paths in [Paths::Transforms] {
            let t = Instant::now();
            let plan =
                Plan::for_scene(&model, &scene, PlanOptions::new(tol).unwrap().with_paths(paths)).unwrap();
            let tp = t.elapsed().as_secs_f64();
            println!("{}", plan.summary());
            let mut best = f64::MAX;
            let mut image = ndarray::Array2::zeros((n, n));
            for _ in 0..4 {
                let t = Instant::now();
                plan.add_to(&scene, &mut image, &NoProgress).unwrap();
                best = best.min(t.elapsed().as_secs_f64());
            }
            for _ in 0..3 {
                let t = Instant::now();
                let full = plan.execute(&scene).unwrap();
                println!("fresh {:.4}", t.elapsed().as_secs_f64());
                drop(full);
            }
            let t = Instant::now();
            let full = plan.execute(&scene).unwrap();
            let fresh = t.elapsed().as_secs_f64();
            let pixels: Vec<_> = (0..100).map(|i| ((i * 7919) % n, (i * 104729) % n)).collect();
            let exact = Direct::default().at_pixels(&model, &scene, &pixels).unwrap();
            let (mut e2, mut s2) = (0.0, 0.0);
            for (&(x, y), v) in pixels.iter().zip(&exact) {
                e2 += (f64::from(full.pixels()[[y, x]]) - v).powi(2);
                s2 += v * v;
            }
            println!(
                "tol {tol:e}: plan {tp:.3} s, execute {best:.4} s (fresh {fresh:.4}), predicted/2 {:.4}, rel err {:.1e}",
                plan.summary().predicted_seconds / 2.0,
                (e2 / s2 as f64).sqrt()
            );
        }
    }
}
