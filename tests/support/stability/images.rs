//! Images against the direct sum in double precision.

use ndarray::Array2;
use psfield::conv_core::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, LowRank, PatchConvolution, SourcePlan, StarPainter,
};
use psfield::psf_types::{Anchor, Image, NoProgress, PointSource, PsfModel};
use psfield::{Method, PsfieldError, SimulateOptions};

use crate::convolve;

/// Both precisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Precision {
    F32,
    F64,
}

pub(crate) const PRECISIONS: [Precision; 2] = [Precision::F64, Precision::F32];
pub(crate) const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];

impl Precision {
    /// Rounding of a few hundred transforms, products and additions to a pixel, relative to the
    /// peak.
    pub(crate) fn rounding(self) -> f64 {
        match self {
            Self::F32 => 2e-6,
            Self::F64 => 1e-12,
        }
    }

    /// The smallest positive number.
    pub(crate) fn quantum(self) -> f64 {
        match self {
            Self::F32 => f64::from(f32::from_bits(1)),
            Self::F64 => f64::from_bits(1),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// The nearest value of this precision.
    pub(crate) fn nearest(self, value: f64) -> f64 {
        match self {
            Self::F32 => f64::from(value as f32),
            Self::F64 => value,
        }
    }
}

/// `value 2^power`, exact unless the result is beyond the range of f64.
pub(crate) fn times_power(value: f64, power: i32) -> f64 {
    let half = power / 2;
    value * 2_f64.powi(half) * 2_f64.powi(power - half)
}

/// Light on pixels, and stars between pixels.
#[derive(Debug, Clone, Default)]
pub(crate) struct Light {
    pub(crate) pixels: Array2<f64>,
    pub(crate) stars: Vec<PointSource>,
}

impl Light {
    pub(crate) fn of(pixels: Array2<f64>) -> Self {
        Self {
            pixels,
            stars: Vec::new(),
        }
    }

    /// All light times a factor, rounded to the nearest values of a precision.
    pub(crate) fn scaled(&self, factor: f64, precision: Precision) -> Self {
        let star =
            |s: &PointSource| PointSource::new(s.position(), s.flux() * factor).expect("a finite flux");
        Self {
            pixels: self.pixels.mapv(|v| precision.nearest(v * factor)),
            stars: self.stars.iter().map(star).collect(),
        }
    }

    /// The power of two that scales the light to about 1.
    fn power(&self) -> i32 {
        let stars = self.stars.iter().map(|s| s.flux());
        let all = self.pixels.iter().copied().chain(stars);
        let largest = all.fold(0.0_f64, |m, v| m.max(v.abs()));
        if largest > 0.0 {
            -(largest.log2().floor() as i32)
        } else {
            0
        }
    }
}

fn image_of<T: ConvReal>(
    model: &PsfModel,
    light: &Light,
    method: Method,
    anchor: Anchor,
) -> Result<Array2<f64>, PsfieldError> {
    let options = SimulateOptions {
        method,
        tolerance: 0.0,
        anchor,
        ..SimulateOptions::default()
    };
    let plan = options.plan_options()?;
    let method: Box<dyn ConvolutionMethod<T>> = match (method, plan) {
        (_, Some(plan)) => Box::new(LowRank::new(plan)),
        (Method::Basis, _) => Box::new(BasisConvolution::new(anchor)),
        (Method::Patch(size), _) => Box::new(PatchConvolution::new(size, anchor)?),
        _ => Box::new(Direct::new(anchor)),
    };
    let pixels = Image::new(light.pixels.mapv(T::nearest))?;
    let whole = pixels.shape().region();
    let mut image = convolve(method.as_ref(), model, &pixels)?.into_pixels();
    if let Some(plan) = plan {
        let stars = SourcePlan::new(model, plan, None)?;
        stars.draw_stars_into(&light.stars, whole, whole, image.view_mut(), &NoProgress)?;
    } else {
        let stars = StarPainter::new(model, whole, anchor, None)?;
        stars.draw_into(&light.stars, whole, image.view_mut(), &NoProgress)?;
    }
    Ok(image.mapv(T::as_f64))
}

/// The image of light by a method, in a precision.
pub(crate) fn image(
    model: &PsfModel,
    light: &Light,
    (method, precision, anchor): (Method, Precision, Anchor),
) -> Result<Array2<f64>, PsfieldError> {
    match precision {
        Precision::F32 => image_of::<f32>(model, light, method, anchor),
        Precision::F64 => image_of::<f64>(model, light, method, anchor),
    }
}

/// The direct sum in double precision of light scaled to near 1, and the power of two of the
/// scaling. The sum stays accurate for light that is as small or as large as numbers can be.
pub(crate) fn truth(
    model: &PsfModel,
    light: &Light,
    anchor: Anchor,
) -> Result<(Array2<f64>, i32), PsfieldError> {
    let power = light.power();
    let star = |s: &PointSource| PointSource::new(s.position(), times_power(s.flux(), power));
    let near_one = Light {
        pixels: light.pixels.mapv(|v| times_power(v, power)),
        stars: light.stars.iter().map(star).collect::<Result<_, _>>()?,
    };
    Ok((image_of::<f64>(model, &near_one, Method::Direct, anchor)?, power))
}

/// The largest difference of an image from the direct sum, divided by the sum's peak, for the worse
/// of the two anchorings. Both are taken only over pixels that `counts` selects. NaN if any
/// difference is NaN.
pub(crate) fn error_where(
    model: &PsfModel,
    light: &Light,
    (method, precision): (Method, Precision),
    counts: impl Fn(usize, usize) -> bool,
) -> Result<f64, PsfieldError> {
    let mut worst = 0.0_f64;
    for anchor in ANCHORS {
        let (truth, power) = truth(model, light, anchor)?;
        let image = image(model, light, (method, precision, anchor))?;
        let (mut off, mut peak) = (0.0_f64, 0.0_f64);
        for (((y, x), &value), &exact) in image.indexed_iter().zip(&truth) {
            if counts(x, y) {
                let difference = (times_power(value, power) - exact).abs();
                // `max` would lose a NaN.
                off = if difference > off || difference.is_nan() {
                    difference
                } else {
                    off
                };
                peak = peak.max(exact.abs());
            }
        }
        let error = if off == 0.0 { 0.0 } else { off / peak };
        worst = if error > worst || error.is_nan() {
            error
        } else {
            worst
        };
    }
    Ok(worst)
}

/// [`error_where`] over all pixels.
pub(crate) fn error(
    model: &PsfModel,
    light: &Light,
    method: (Method, Precision),
) -> Result<f64, PsfieldError> {
    error_where(model, light, method, |_, _| true)
}
