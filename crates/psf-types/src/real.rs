//! The two working precisions.

use ndarray::NdFloat;

/// A working precision: `f32` or `f64`. Sealed.
pub trait Real: NdFloat + Default + sealed::Sealed {
    /// `f32` or `f64`.
    const NAME: &'static str;
    /// The nearest value of this type.
    fn nearest(value: f64) -> Self;
    /// The same value in double precision.
    fn as_f64(self) -> f64;
}

impl Real for f32 {
    const NAME: &'static str = "f32";
    fn nearest(value: f64) -> Self {
        value as Self
    }
    fn as_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    const NAME: &'static str = "f64";
    fn nearest(value: f64) -> Self {
        value
    }
    fn as_f64(self) -> f64 {
        self
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}
