//! The data that an execution on a GPU moves, as the plan predicts it. No GPU is needed.

#![cfg(feature = "gpu")]

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use conv_core::{Paths, Plan};
use psf_types::{Anchor, FrameShape, Normalisation};

#[test]
fn a_gpu_moves_planes_once_a_pass_and_spectra_once() {
    let model = common::model_with(Arc::new(common::Waves), (5, 5), (2, 2), true, Normalisation::Unit);
    let shape = FrameShape::new(40, 30).unwrap();
    for anchor in [Anchor::Source, Anchor::Output] {
        let options = common::options(1e-6, anchor, Paths::Transforms);
        let plan = Plan::<f32>::new(&model, shape, shape.region(), options).unwrap();
        let summary = plan.summary();
        // One tile with several kernels.
        let (nx, ny) = summary.transform;
        let kernels = summary.most_modes();
        assert_eq!((summary.tiles, summary.tile), (1, (40, 30)));
        assert!(kernels > 2 && ny / 2 >= 30, "{summary:?}");
        let (plane, tile, around) = (nx * ny, 40 * 30, 44 * 34);
        // Light that scatters reaches more pixels. Light that is gathered comes from more pixels.
        let (light_rows, light, result, planes) = if anchor == Anchor::Source {
            (30, tile, around, (kernels, 1))
        } else {
            (34, around, tile, (1, kernels))
        };
        let filled = 2 * nx * light_rows.min(ny / 2);
        let memory = kernels * plane + 2 * planes.0 * filled + 2 * planes.1 * plane + light + 2 * result;
        let work = plan.gpu_work();
        assert_eq!(work.memory_bytes, 4 * memory as u64, "{anchor:?}");
        assert_eq!(work.bus_bytes, 4 * (light + tile) as u64, "{anchor:?}");
    }
}
