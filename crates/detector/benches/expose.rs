//! The time of an exposure, with different steps switched on.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ndarray::Array2;
use psf_detector::{Detector, DetectorParams, PhotonNoise};
use psf_types::Image;

const SIZE: usize = 1024;

fn exposures(criterion: &mut Criterion) {
    let light = Image::new(Array2::from_elem((SIZE, SIZE), 3.0_f32)).expect("finite");
    let off = DetectorParams::default();
    let mut group = criterion.benchmark_group("expose");
    group.sample_size(10);
    group.throughput(Throughput::Elements((SIZE * SIZE) as u64));
    for (name, params) in [
        (
            "read-noise",
            DetectorParams {
                read_noise_e: 5.0,
                ..off.clone()
            },
        ),
        (
            "sky+photons+read-noise",
            DetectorParams {
                photon_noise: true,
                sky_e: 100.0,
                read_noise_e: 5.0,
                ..off.clone()
            },
        ),
        (
            "everything",
            DetectorParams {
                photon_noise: true,
                sky_e: 100.0,
                response_rms: 0.01,
                full_well_e: Some(1e5),
                read_noise_e: 5.0,
                gain_e_per_adu: Some(1.5),
                bias_adu: Some(300.0),
                bits: Some(16),
                bad_pixels: psf_detector::BadPixelParams {
                    dead_fraction: 1e-3,
                    ..Default::default()
                },
                ..off
            },
        ),
    ] {
        let ccd = Detector::new(params).expect("valid");
        group.bench_function(BenchmarkId::new(name, SIZE), |b| {
            b.iter(|| ccd.expose(&light, 1).expect("exposed"));
        });
    }
    for mean in [0.1_f32, 3.0, 11.0, 13.0, 1e4] {
        let expected = Image::new(Array2::from_elem((SIZE, SIZE), mean)).expect("finite");
        group.bench_function(BenchmarkId::new("photons", mean), |b| {
            b.iter(|| PhotonNoise::new(1).apply(&expected).expect("exposed"));
        });
    }
    group.finish();
}

criterion_group!(benches, exposures);
criterion_main!(benches);
