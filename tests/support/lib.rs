//! Shared parts of the integration tests: PSF sources with a known field, errors of PSFs, and the
//! cases of the stability suite.

pub mod circles;
pub mod stability;

use ndarray::{Array2, ArrayViewMut2};
use psfield::FitOptions;
use psfield::conv_core::{ConvError, ConvReal, ConvolutionMethod, Direct};
use psfield::fit::fit;
use psfield::metrics::{Comparison, Summary};
use psfield::psf_optics::{Telescope, TelescopeParams};
use psfield::psf_sample::{SamplingMethod, UniformSampling};
use psfield::psf_types::{
    Anchor, FrameShape, Image, NoProgress, Position, PsfModel, PsfSamples, PsfSource, SourceError, StampGrid,
};

/// A round Gaussian whose width changes in one corner of a 1000 x 1000 field and hardly elsewhere.
#[derive(Debug, Clone, Copy)]
pub struct CornerRise;

impl CornerRise {
    /// The standard deviation in pixels: 1.2 far from the corner (999, 999), 2.2 at it.
    pub fn sigma_px(position: Position) -> f64 {
        let distance = position.distance(Position::of_pixel(999, 999)) / 150.0;
        1.2 + (-distance * distance).exp()
    }
}

impl PsfSource for CornerRise {
    fn grid(&self) -> StampGrid {
        StampGrid::new(19, 19).expect("not empty")
    }

    fn field(&self) -> FrameShape {
        FrameShape::new(1000, 1000).expect("not empty")
    }

    fn draw_into(&self, position: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        let sigma2 = Self::sigma_px(position).powi(2);
        for ((y, x), value) in stamp.indexed_iter_mut() {
            let r2 = (y as f64 - 9.0).powi(2) + (x as f64 - 9.0).powi(2);
            *value = (-r2 / (2.0 * sigma2)).exp() / (std::f64::consts::TAU * sigma2);
        }
        Ok(())
    }
}

/// A telescope with clear aberrations over a frame of 160 x 120 pixels, with oversampled stamps.
///
/// # Panics
/// Never: the description is valid.
pub fn small_telescope(oversampling: usize) -> Telescope {
    let text = format!(
        r#"
        wavelength_nm = 600.0
        pixel_scale_arcsec = 0.1
        frame = {{ nx = 160, ny = 120 }}
        stamp = {{ nx = {side}, ny = {side}, oversampling = {oversampling} }}
        aperture = {{ diameter_m = 1.0, obscuration = 0.25 }}
        [wavefront]
        unit = "nm"
        modes = [
            {{ noll = 4, terms = [{{ value = 20.0 }}, {{ x = 2, value = 30.0 }}] }},
            {{ noll = 6, terms = [{{ y = 1, value = 40.0 }}] }},
            {{ noll = 8, terms = [{{ x = 1, value = 50.0 }}] }},
        ]
        [detector]
        blur_sigma_px = 0.8
        "#,
        side = 24 * oversampling,
    );
    Telescope::from_toml_str(&text).expect("a valid telescope")
}

/// The parameters of [`small_telescope`].
pub fn small_telescope_params() -> TelescopeParams {
    small_telescope(1).params().clone()
}

/// Samples on a regular grid.
///
/// # Panics
/// When the source fails.
pub fn uniform_samples(source: &dyn PsfSource, nx: usize, ny: usize) -> PsfSamples {
    let sampling = UniformSampling::new(nx, ny).and_then(|grid| grid.sample(source, &NoProgress));
    sampling.expect("the source can be sampled").samples
}

/// The model fitted to samples.
///
/// # Panics
/// When the fit fails.
pub fn fitted(samples: PsfSamples, options: &FitOptions) -> PsfModel {
    fit(samples, options)
        .and_then(psfield::fit::Fit::into_model)
        .expect("a model")
}

/// The image of a whole scene by a method.
///
/// # Errors
/// The errors of the method.
pub fn convolve<T: ConvReal>(
    method: &dyn ConvolutionMethod<T>,
    model: &PsfModel,
    light: &Image<T>,
) -> Result<Image<T>, ConvError> {
    method.convolve(model, &light.view(), light.shape().region(), &NoProgress)
}

/// Some pixels of the image of a whole scene, by the double sum.
///
/// # Errors
/// The errors of [`Direct::at_pixels`].
pub fn direct_at<T: ConvReal>(
    model: &PsfModel,
    light: &Image<T>,
    anchor: Anchor,
    pixels: &[(usize, usize)],
) -> Result<Vec<f64>, ConvError> {
    let (shape, whole) = (light.shape(), (light.pixels(), (0, 0)));
    Direct::new(anchor).at_pixels(model, whole, shape, shape.region(), pixels, &NoProgress)
}

/// Relative L2 errors of a model's PSFs on a grid of `per_axis` positions along each axis. No
/// position coincides with a sample.
///
/// # Panics
/// When a PSF cannot be evaluated or drawn.
pub fn model_errors(model: &PsfModel, source: &dyn PsfSource, per_axis: usize) -> Summary {
    let field = source.field();
    let at = |k: usize, n: usize| (k as f64 + 0.37) / per_axis as f64 * (n - 1) as f64;
    let errors = (0..per_axis * per_axis).map(|k| {
        let position =
            Position::new(at(k % per_axis, field.nx()), at(k / per_axis, field.ny())).expect("finite");
        let truth = source.draw(position).expect("drawn").into_values();
        let psf = model.psf_at(position).expect("evaluated");
        Comparison::of(psf.values(), truth.view())
            .and_then(|c| c.relative_l2())
            .expect("comparable")
    });
    Summary::of(errors).expect("some positions")
}

/// An image of blobs and points on a background of 0. `margin` pixels along each border stay 0.
///
/// # Panics
/// When the margins leave no light.
pub fn test_scene(nx: usize, ny: usize, margin: usize) -> Image<f64> {
    let inside = |v: usize, n: usize| v >= margin && v + margin < n;
    let light = Array2::from_shape_fn((ny, nx), |(y, x)| {
        if !inside(x, nx) || !inside(y, ny) {
            return 0.0;
        }
        let blob = |cx: f64, cy: f64, s: f64| {
            (-((x as f64 - cx * nx as f64).powi(2) + (y as f64 - cy * ny as f64).powi(2)) / (2.0 * s * s))
                .exp()
        };
        let point = if (x * 31 + y * 17) % 211 == 0 {
            5.0 + (x % 7) as f64
        } else {
            0.0
        };
        3.0 * blob(0.3, 0.6, 9.0) + blob(0.7, 0.3, 14.0) + point
    });
    assert!(light.sum() > 0.0, "the margins leave no light");
    Image::new(light).expect("finite")
}

/// `||a - b|| / ||b||`.
///
/// # Panics
/// When the shapes differ.
pub fn relative_l2(a: &Image<f64>, b: &Image<f64>) -> f64 {
    Comparison::of(a.pixels(), b.pixels())
        .and_then(|c| c.relative_l2())
        .expect("comparable")
}
