use conv_core::*;
use psf_types::*;
use std::time::Instant;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let n: usize = args[2].parse().unwrap();
    let count: usize = args[3].parse().unwrap();
    let model = psfield::PsfInput::open(&args[1], psfield::FitOptions::default())
        .unwrap()
        .into_model()
        .unwrap();
    let mut light = ndarray::Array2::<f32>::zeros((n, n));
    let mut x = 1u64;
    let mut r = || {
        x = x
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (x >> 33) as usize
    };
    for _ in 0..count {
        let (i, j) = (r() % n, r() % n);
        light[[i, j]] = 1.0 + (r() % 1000) as f32;
    }
    let scene = Scene::from_image(Image::new(light).unwrap());
    for tol in [1e-3, 1e-4, 0.0] {
        let t = Instant::now();
        let plan = Plan::for_scene(&model, &scene, PlanOptions::new(tol).unwrap()).unwrap();
        let tp = t.elapsed().as_secs_f64();
        let mut best = f64::MAX;
        let mut image = plan.dark_image();
        let mut counts = TileCounts::default();
        for _ in 0..10 {
            let t = Instant::now();
            counts = plan.add_to(&scene, &mut image, &NoProgress).unwrap();
            best = best.min(t.elapsed().as_secs_f64());
        }
        let t = Instant::now();
        plan.execute(&scene).unwrap();
        let fresh = t.elapsed().as_secs_f64();
        println!(
            "tol {tol:e}: plan {tp:.3} s, execute {:.3} ms (fresh {:.3}) {counts:?} modes {:.2} up to {}",
            best * 1e3,
            fresh * 1e3,
            plan.summary().mean_modes(),
            plan.summary().drawn_up_to
        );
    }
}
