//! Plans and executions, on all threads of rayon's pool.

mod common;

use std::hint::black_box;
use std::slice::from_ref;

use conv_core::{ConvReal, Engine, Operation, Paths, Plan, PlanOptions, SourcePlan};
use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use ndarray::Array2;
use psf_types::{FrameShape, Image, NoProgress, PointSource, Position, PsfModel, Real};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIZES: [usize; 3] = [256, 512, 1024];
const TOLERANCES: [f64; 3] = [1e-2, 1e-4, 0.0];
/// One of this many pixels is lit in the benches that draw stamps. That makes a few tens per tile.
const SPARSE: usize = 1000;

/// Square light of which about one in `every` pixels is lit.
fn lit<T: Real>(frame: usize, every: usize) -> Image<T> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let light = Array2::from_shape_simple_fn((frame, frame), || {
        let shines = every == 1 || rng.random_range(0..every) == 0;
        T::nearest(if shines { rng.random_range(1.0..2.0) } else { 0.0 })
    });
    Image::new(light).expect("finite light")
}

fn planned<T: ConvReal>(model: &PsfModel, size: usize, options: PlanOptions) -> Plan<T> {
    let shape = FrameShape::new(size, size).expect("a valid shape");
    Plan::new(model, shape, shape.region(), options).expect("a plan")
}

fn options(tolerance: f64) -> PlanOptions {
    PlanOptions::new(tolerance)
        .expect("a tolerance")
        .with_paths(Paths::Transforms)
}

fn name(tolerance: f64) -> String {
    if tolerance == 0.0 {
        "tolerance-0".to_owned()
    } else {
        format!("tolerance-{tolerance:e}")
    }
}

fn plan(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("plan-f32");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    for size in SIZES {
        let model = common::model(size);
        group.throughput(Throughput::Elements((size * size) as u64));
        for tolerance in TOLERANCES {
            group.bench_function(BenchmarkId::new(name(tolerance), size), |bencher| {
                bencher.iter(|| black_box(planned::<f32>(&model, size, options(tolerance))));
            });
        }
    }
    group.finish();
}

fn execute<T: ConvReal>(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group(format!("execute-{}", T::NAME));
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    for size in SIZES {
        let (model, light) = (common::model(size), lit::<T>(size, 1));
        group.throughput(Throughput::Elements((size * size) as u64));
        for tolerance in TOLERANCES {
            let engine = Engine::new(planned::<T>(&model, size, options(tolerance)));
            let mut image = Array2::zeros((size, size));
            group.bench_function(BenchmarkId::new(name(tolerance), size), |bencher| {
                bencher.iter(|| {
                    engine
                        .execute(
                            Operation::Convolve,
                            from_ref(&light.view()),
                            vec![image.view_mut()],
                            &NoProgress,
                        )
                        .expect("an image")
                });
            });
        }
    }
    group.finish();
}

fn draw(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("draw-f32");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    for size in SIZES {
        let model = common::model(size);
        let mut image = Array2::zeros((size, size));
        // Pixels at integer positions, from the local modes' stamps.
        let pixels = lit::<f32>(size, SPARSE);
        let count = pixels.pixels().iter().filter(|v| **v > 0.0).count();
        group.throughput(Throughput::Elements(count as u64));
        let engine = Engine::new(planned::<f32>(&model, size, PlanOptions::default()));
        group.bench_function(BenchmarkId::new("lit-pixels", size), |bencher| {
            bencher.iter(|| {
                engine
                    .execute(
                        Operation::Convolve,
                        from_ref(&pixels.view()),
                        vec![image.view_mut()],
                        &NoProgress,
                    )
                    .expect("an image")
            });
        });
        // An equal number of sources between pixels, by splines.
        let place = |i: usize, factor: usize| ((i * factor) % (size - 1)) as f64 + 0.3;
        let sources = (0..count).map(|i| {
            let position = Position::new(place(i, 7919), place(i, 104_729)).expect("a position");
            PointSource::new(position, 1.0).expect("a flux")
        });
        let sources: Vec<PointSource> = sources.collect();
        let stars = SourcePlan::new(&model, PlanOptions::default(), None).expect("a plan");
        let frame = pixels.shape().region();
        group.bench_function(BenchmarkId::new("point-sources", size), |bencher| {
            bencher.iter(|| {
                stars
                    .draw_stars_into(&sources, frame, frame, image.view_mut(), &NoProgress)
                    .expect("an image");
            });
        });
    }
    group.finish();
}

criterion_group!(benches, plan, execute::<f32>, execute::<f64>, draw);
criterion_main!(benches);
