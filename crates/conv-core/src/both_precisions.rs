//! Makes the compiler compile the main functions in this crate, for both precisions.
//!
//! Rust compiles a generic function again in every crate that calls it, unless the function is
//! never inlined and its own crate has compiled it for the same types. Compiling these functions
//! for all instruction sets takes half a minute. So they are compiled once, here, for `f32` and
//! `f64`.

use std::hint::black_box;

use crate::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, Engine, PatchConvolution, Plan, SourcePlan,
    StarPainter,
};

/// Uses every function that carries `#[inline(never)]` for this reason, so that it is compiled
/// here.
fn of<T: ConvReal>() {
    black_box(Engine::<T>::run as fn(_, _, _) -> _);
    black_box(Engine::<T>::execute_many as fn(_, _, _, _, _) -> _);
    black_box(Plan::<T>::for_region as fn(_, _, _, _, _, _) -> _);
    black_box(Plan::<T>::of_whole as fn(_, _, _, _) -> _);
    black_box(Plan::<T>::arrays as fn(_) -> _);
    black_box(SourcePlan::<T>::of_layers as fn(_, _, _) -> _);
    black_box(SourcePlan::<T>::draw_stars_into as fn(_, _, _, _, _, _) -> _);
    black_box(SourcePlan::<T>::draw_extended_into as fn(_, _, _, _, _, _) -> _);
    black_box(SourcePlan::<T>::star_gradients as fn(_, _, _, _, _, _) -> _);
    black_box(SourcePlan::<T>::extended_gradients as fn(_, _, _, _, _, _) -> _);
    black_box(StarPainter::draw_into::<T> as fn(_, _, _, _, _) -> _);
    black_box(Direct::at_pixels::<T> as fn(_, _, _, _, _, _, _) -> _);
    black_box(<Direct as ConvolutionMethod<T>>::convolve as fn(_, _, _, _, _) -> _);
    black_box(<PatchConvolution as ConvolutionMethod<T>>::convolve as fn(_, _, _, _, _) -> _);
    black_box(<BasisConvolution as ConvolutionMethod<T>>::convolve as fn(_, _, _, _, _) -> _);
}

#[used]
static COMPILED: [fn(); 2] = [of::<f32>, of::<f64>];
