//! Compiles simulators of both precisions in this crate, as conv-core does for its engine. Other
//! crates then need not compile them again.

use std::hint::black_box;

use conv_core::ConvReal;

use super::Simulator;

/// Uses every function that is marked `#[inline(never)]`, so that this crate compiles it.
fn of<T: ConvReal>() {
    black_box(Simulator::<T>::new as fn(_, _, _, _) -> _);
    black_box(Simulator::<T>::simulate_into as fn(_, _, _, _) -> _);
    black_box(Simulator::<T>::simulate_many_into as fn(_, _, _, _) -> _);
    black_box(Simulator::<T>::adjoint as fn(_, _, _) -> _);
    black_box(Simulator::<T>::gradients as fn(_, _, _, _, _) -> _);
    black_box(Simulator::<T>::source_gradients as fn(_, _, _, _) -> _);
    black_box(Simulator::<T>::for_region as fn(_, _, _) -> _);
    black_box(Simulator::<T>::with_psf as fn(_, _, _) -> _);
    black_box(Simulator::<T>::prepare as fn(_, _, _) -> _);
    black_box(Simulator::<T>::exact_at as fn(_, _, _, _) -> _);
    black_box(Simulator::<T>::convolver as fn(_, _, _) -> _);
    black_box(Simulator::<T>::draw_sources_into as fn(_, _, _, _, _) -> _);
}

#[used]
static COMPILED: [fn(); 2] = [of::<f32>, of::<f64>];
