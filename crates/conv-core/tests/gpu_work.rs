//! The amount of data that an execution on a GPU moves, which needs no GPU to be known.

#![cfg(feature = "gpu")]

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use conv_core::{Paths, Plan};
use psf_types::{Anchor, FrameShape, Normalisation};

#[test]
fn a_gpu_moves_planes_once_a_pass_and_spectra_once() {
    let model = common::model_with(
        Arc::new(common::Constant),
        (5, 5),
        (2, 2),
        true,
        Normalisation::Unit,
    );
    let shape = FrameShape::new(40, 30).unwrap();
    // One tile and one kernel. The tile's light reaches 44 x 34 pixels, or comes from there. Half of
    // a plane has 32 rows.
    let (plane, tile, around) = (48 * 64, 40 * 30, 44 * 34);
    for (anchor, filled, light, result) in [
        (Anchor::Source, 48 * 2 * 30, tile, around),
        (Anchor::Output, 48 * 2 * 32, around, tile),
    ] {
        let options = common::options(1e-3, anchor, Paths::Transforms);
        let plan = Plan::<f32>::new(&model, shape, shape.region(), options).unwrap();
        let summary = plan.summary();
        assert_eq!(
            (summary.tiles, summary.most_modes(), summary.transform),
            (1, 1, (48, 64))
        );
        let work = plan.gpu_work();
        let planes = plane + 2 * filled + 2 * plane;
        assert_eq!(work.memory_bytes, 4 * (planes + light + 2 * result), "{anchor:?}");
        assert_eq!(work.bus_bytes, 4 * (light + tile), "{anchor:?}");
    }
}
