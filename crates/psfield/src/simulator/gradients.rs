//! Derivatives of images: products of a vector with the Jacobian matrix.

use conv_core::{ConvReal, Correlations, Engine, LightAndImage, Operation, SampleWeights};
use ndarray::{Array1, Array2, Array3, ArrayView2, Axis};
use psf_types::{
    Anchor, Image, ImageView, Interpolation, Normalisation, Progress, PsfModelRecord, SampleCoefficients,
    StampGrid,
};

use super::Simulator;
use crate::error::{ErrorKind, PsfieldError};
use crate::fit::field_of;
use crate::psf::{PsfParameters, StampChange};

/// The start of the error message for derivatives with a method that makes no plan
/// ([`PsfieldError::needs_plan`]).
const DERIVATIVES: &str = "derivatives can be computed";
/// A component whose flux is below this fraction of a PSF's holds only rounding of its sum.
const NO_FLUX: f64 = 1e-14;

/// The derivatives to compute ([`Simulator::gradients`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WantedGradients {
    /// With respect to the light.
    pub light: bool,
    /// With respect to the coefficients of the PSF model.
    pub coefficients: bool,
    /// With respect to its mean and its components.
    pub stamps: bool,
}

/// Derivatives ([`Simulator::gradients`]).
#[derive(Debug, Clone)]
pub struct Gradients<T: ConvReal> {
    /// With respect to each light, `[light, y, x]`.
    pub light: Option<Array3<T>>,
    /// With respect to the parameters of the PSF, if any of them was wanted. The others are 0.
    pub psf: Option<PsfParameters>,
}

/// All that derivatives with respect to the PSF need and that does not depend on the values of its parameters.
#[derive(Debug)]
pub(super) struct PsfDerivative<T> {
    weights: SampleWeights<T>,
    /// The change from the model's stamps to those on the scene's pixels, along y and along x
    /// ([`StampChange::matrices`]). None if they are the same.
    change: Option<[Array2<f64>; 2]>,
    /// The grids of the model's stamps and of those on the scene's pixels.
    grids: [StampGrid; 2],
}

impl<T: ConvReal> Simulator<T> {
    /// Computes derivatives of `sum_n <g_n, A f_n>` for light `f_n` and images `g_n`. `A` is
    /// [`simulate`](Self::simulate) for scenes of one image. So if `g_n` is the derivative of a number, such as
    /// a sum of squares, with respect to the image of `f_n`, these are the derivatives of this number:
    ///
    /// - with respect to each light: `A^T g_n` ([`adjoint`](Self::adjoint));
    /// - with respect to the parameters of the PSF ([`Psf::parameters`](crate::Psf::parameters)), with the
    ///   scaling to unit flux, and the interpolation with its parameters, as they are.
    ///
    /// The derivatives with respect to the PSF are those of the model, not of the plan's modes: the weights of
    /// the samples have modes of their own ([`SampleWeights`]), whose error is at most the plan's tolerance.
    /// Where an interpolation has kinks, the derivative with respect to light and to parameters exists
    /// nevertheless.
    ///
    /// Light and images have the shapes of [`adjoint`](Self::adjoint).
    ///
    /// ```
    /// use ndarray::{Array2, Array3};
    /// use psfield::prelude::*;
    /// use psfield::{PsfParameters, WantedGradients};
    /// use psfield::psf_types::{ImageView, NoProgress};
    /// let corners = [(0.0, 0.0), (29.0, 0.0), (0.0, 19.0), (29.0, 19.0)];
    /// let stamps = Array3::from_shape_fn((4, 9, 9), |(j, y, x)| {
    ///     let square = (y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2);
    ///     (-square / (2.0 + j as f64)).exp()
    /// });
    /// // A model with the parameters of the samples' fit.
    /// let psf = Psf::from_samples(stamps.view(), &corners)?;
    /// let psf = psf.with_parameters(psf.parameters()?.clone())?;
    /// let simulator = psf.simulator((20, 30)).tolerance(0.0).build::<f64>()?;
    ///
    /// // The derivative of pixel (column 12, row 8) of the image.
    /// let light = Array2::from_shape_fn((20, 30), |(y, x)| ((3 * x + 5 * y) % 7) as f64);
    /// let mut pixel = Array2::zeros((20, 30));
    /// pixel[[8, 12]] = 1.0;
    /// let (lights, images) = ([ImageView::new(light.view())?], [ImageView::new(pixel.view())?]);
    /// let wanted = WantedGradients { light: false, coefficients: true, stamps: false };
    /// let found = simulator.gradients(&lights, &images, wanted, &NoProgress)?.psf.expect("wanted");
    ///
    /// // The difference for other coefficients.
    /// let value = |step: f64| -> Result<f64, PsfieldError> {
    ///     let mut other = psf.parameters()?.clone();
    ///     other.coefficients[[2, 0]] += step;
    ///     let simulator = simulator.with_psf(psf.with_parameters(other)?, &NoProgress)?;
    ///     Ok(simulator.simulate(&Scene::new(light.clone())?)?.pixels()[[8, 12]])
    /// };
    /// let difference = (value(1e-4)? - value(-1e-4)?) / 2e-4;
    /// assert!((found.coefficients[[2, 0]] - difference).abs() < 1e-8);
    /// # Ok::<(), psfield::PsfieldError>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for the parameters of a PSF of samples (make a model by
    /// [`Psf::with_parameters`](crate::Psf::with_parameters)), with wings or with an interpolation of the
    /// caller's own, and for a PSF of several states. [`ErrorKind::Data`] for another number of images than of
    /// lights, and the errors of [`adjoint`](Self::adjoint).
    #[inline(never)]
    pub fn gradients(
        &self,
        lights: &[ImageView<'_, T>],
        images: &[ImageView<'_, T>],
        wanted: WantedGradients,
        progress: &dyn Progress,
    ) -> Result<Gradients<T>, PsfieldError> {
        if self.layer_count() > 1 {
            const SEVERAL: &str = "a PSF of several states has no derivatives: choose one state";
            return Err(PsfieldError::new(ErrorKind::Setting, SEVERAL));
        }
        if lights.len() != images.len() {
            let message = format!(
                "{} images for {} lights: give one each",
                images.len(),
                lights.len()
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let of_psf = wanted.coefficients || wanted.stamps;
        let sums = of_psf.then(|| self.psf_sums(progress)).transpose()?;
        let changes_flux = sums.as_ref().is_some_and(|sums| sums.change_flux(wanted));
        let is_source_anchored = self.options().anchor != Anchor::Output;
        let light = (wanted.light || changes_flux && is_source_anchored)
            .then(|| self.adjoint_many(images, progress))
            .transpose()?;
        let psf = sums.map(|sums| {
            let adjoints = light.as_ref().filter(|_| changes_flux && is_source_anchored);
            let results = (changes_flux, adjoints);
            self.psf_gradient(sums, (lights, images), wanted, results, progress)
        });
        Ok(Gradients {
            psf: psf.transpose()?,
            light: light.filter(|_| wanted.light),
        })
    }

    /// Sums for the derivative with respect to the PSF, without any pixels yet.
    fn psf_sums(&self, progress: &dyn Progress) -> Result<Sums<'_, T>, PsfieldError> {
        let normalisation = self.record_for_derivatives()?.normalisation();
        let convolver = self.convolver(&[0], progress)?;
        let derivative = self.psf_derivative(convolver.engine_for(DERIVATIVES)?, progress)?;
        Ok(derivative.sums(self.psf().parameters()?, normalisation))
    }

    /// The record of the PSF, if its parameters have derivatives.
    fn record_for_derivatives(&self) -> Result<&PsfModelRecord, PsfieldError> {
        let refused = |why: &str| {
            let message = format!("derivatives with respect to the PSF: {why}");
            Err(PsfieldError::new(ErrorKind::Setting, message))
        };
        let Some(record) = self.psf().stored().filter(|_| self.shared.images.is_none()) else {
            return refused("the PSF is not a model with parameters, make one with Psf::with_parameters");
        };
        if record.wings().is_some() {
            return refused("a PSF with wings has none");
        }
        if matches!(record.interpolation(), Interpolation::Table { .. }) {
            return refused(
                "the interpolation is a table of your own one, whose coefficients are not those of samples",
            );
        }
        Ok(record)
    }

    /// The derivative with respect to the parameters of the PSF. `adjoints` are those of the images, if PSFs
    /// are scaled to unit flux and source-anchored.
    fn psf_gradient(
        &self,
        mut sums: Sums<'_, T>,
        (lights, images): (&[ImageView<'_, T>], &[ImageView<'_, T>]),
        wanted: WantedGradients,
        (changes_flux, adjoints): (bool, Option<&Array3<T>>),
        progress: &dyn Progress,
    ) -> Result<PsfParameters, PsfieldError> {
        let convolver = self.convolver(&[0], progress)?;
        let engine = convolver.engine_for(DERIVATIVES)?;
        let geometry = &self.setup.geometry;
        let mut fine = Vec::new();
        if geometry.oversample > 1 {
            for image in images {
                fine.push(geometry.spread(image)?);
            }
        }
        let mut convolved = Vec::new();
        if changes_flux && adjoints.is_none() {
            for light in lights {
                let mut image = engine.plan().zeros();
                engine.execute(
                    Operation::Convolve,
                    &[light.view()],
                    vec![image.view_mut()],
                    progress,
                )?;
                convolved.push(Image::new(image)?);
            }
        }
        let result = |n: usize| {
            let adjoint = adjoints.map(|adjoints| ImageView::new(adjoints.index_axis(Axis(0), n)));
            let adjoint = adjoint.transpose()?;
            Ok::<_, PsfieldError>(adjoint.or_else(|| convolved.get(n).map(Image::view)))
        };
        let pair = |n: usize| {
            Ok(LightAndImage {
                light: lights[n].view(),
                image: fine.get(n).map_or_else(|| images[n].view(), Image::view),
                result: result(n)?,
            })
        };
        let pairs: Vec<LightAndImage<'_, T>> =
            (0..lights.len()).map(pair).collect::<Result<_, PsfieldError>>()?;
        let needs_fluxes = engine.plan().model().needs_flux_scaling();
        let fluxes = needs_fluxes.then(|| sums.fluxes.clone());
        let fluxes = fluxes.as_ref().map(|fluxes| fluxes.view());
        let weights = &sums.derivative.weights;
        let mut take = |part: Correlations| sums.add(&part, wanted);
        engine.correlate(weights, &pairs, fluxes, progress, &mut take)?;
        Ok(sums.finish())
    }

    /// Returns whether derivatives with respect to the PSF of another simulator with the same tiles need the
    /// same data.
    pub(super) fn shares_derivative_with(&self, other: &Self) -> Result<bool, PsfieldError> {
        let (Some(own), Some(of_other)) = (self.psf().stored(), other.psf().stored()) else {
            return Ok(false);
        };
        let grid_on_pixels = |simulator: &Self| Ok::<_, PsfieldError>(simulator.image_models()?.0[0].grid());
        Ok(own.interpolation() == of_other.interpolation()
            && own.outside() == of_other.outside()
            && own.coefficients().positions() == of_other.coefficients().positions()
            && own.basis().grid() == of_other.basis().grid()
            && grid_on_pixels(self)? == grid_on_pixels(other)?)
    }

    /// The data that derivatives with respect to the PSF need. They are made once, and kept for other parameters of
    /// the PSF ([`with_psf`](Self::with_psf)).
    fn psf_derivative(
        &self,
        engine: &Engine<T>,
        progress: &dyn Progress,
    ) -> Result<&PsfDerivative<T>, PsfieldError> {
        crate::psf::get_or_make(&self.psf_derivative, || {
            let changes = self.setup.stamp_changes(self.psf())?;
            let on_pixels = self.setup.on_scene_pixels(self.psf())?;
            let samples = on_pixels.record()?;
            let positions = samples.coefficients().positions().clone();
            let unit = SampleCoefficients::new(Array2::eye(positions.len()), positions)?;
            let weights = SampleWeights::new(engine.plan(), field_of(samples, &unit)?, progress)?;
            let joined = changes.iter().map(StampChange::matrices);
            let change = joined.reduce(|first, then| {
                let [y, x] = [0, 1].map(|axis| then[axis].dot(&first[axis]));
                [y, x]
            });
            let grids = [self.psf().grid(), samples.basis().grid()];
            Ok(PsfDerivative {
                weights,
                change,
                grids,
            })
        })
    }
}

impl<T: ConvReal> PsfDerivative<T> {
    /// A stamp of the model on the scene's pixels, `[pixel]`.
    fn on_pixels(&self, stamp: ArrayView2<'_, f64>) -> Array1<f64> {
        let changed = match &self.change {
            Some([along_y, along_x]) => along_y.dot(&stamp).dot(&along_x.t()),
            None => stamp.to_owned(),
        };
        changed.into_iter().collect()
    }

    /// The transpose of [`on_pixels`](Self::on_pixels).
    fn to_model(&self, stamp: Array1<f64>) -> Array2<f64> {
        let stamp = stamp
            .into_shape_with_order(self.grids[1].dim())
            .expect("the grid's pixels");
        match &self.change {
            Some([along_y, along_x]) => along_y.t().dot(&stamp).dot(along_x),
            None => stamp,
        }
    }

    fn sums<'p>(&'p self, parameters: &'p PsfParameters, normalisation: Normalisation) -> Sums<'p, T> {
        let stamps = parameters
            .components
            .outer_iter()
            .map(|stamp| self.on_pixels(stamp));
        let pixels = self.grids[1].pixel_count();
        let mut components = Array2::zeros((parameters.components.dim().0, pixels));
        for (mut row, stamp) in components.outer_iter_mut().zip(stamps) {
            row.assign(&stamp);
        }
        let flux = |sum: f64| self.grids[1].flux_of_sum(sum);
        let component_fluxes = components.sum_axis(Axis(1)).mapv(flux);
        let mean = parameters.mean.as_ref();
        let of_mean = mean.map_or(0.0, |mean| flux(self.on_pixels(mean.view()).sum()));
        Sums {
            derivative: self,
            parameters,
            is_scaled: normalisation == Normalisation::Unit,
            flux_of_pixel: flux(1.0),
            fluxes: parameters.coefficients.dot(&component_fluxes) + of_mean,
            of_components: Array2::zeros(components.dim()),
            of_mean: Array1::zeros(pixels),
            of_coefficients: Array2::zeros(parameters.coefficients.dim()),
            components,
            component_fluxes,
        }
    }
}

/// The sums of the derivatives over parts of the scene.
struct Sums<'p, T> {
    derivative: &'p PsfDerivative<T>,
    parameters: &'p PsfParameters,
    /// Whether PSFs are scaled to unit flux.
    is_scaled: bool,
    /// The components on the scene's pixels, `[component, pixel]`, and their fluxes.
    components: Array2<f64>,
    component_fluxes: Array1<f64>,
    /// The flux of a stamp with the value 1 in one pixel.
    flux_of_pixel: f64,
    /// The fluxes of the samples' PSFs.
    fluxes: Array1<f64>,
    /// The derivatives with respect to stamps on the scene's pixels.
    of_components: Array2<f64>,
    of_mean: Array1<f64>,
    of_coefficients: Array2<f64>,
}

impl<T: ConvReal> Sums<'_, T> {
    /// Returns whether wanted parameters change the flux by which PSFs are divided.
    fn change_flux(&self, wanted: WantedGradients) -> bool {
        let has_flux = |flux: &f64| flux.abs() > NO_FLUX;
        self.is_scaled && (wanted.stamps || self.component_fluxes.iter().any(has_flux))
    }

    fn add(&mut self, part: &Correlations, wanted: WantedGradients) {
        let Correlations {
            shares,
            correlations,
            products,
        } = part;
        // The derivative with respect to each pixel of the unscaled PSF, with the change of its flux.
        let of_pixels = correlations - &(products * self.flux_of_pixel).insert_axis(Axis(1));
        if wanted.coefficients {
            let of_functions = of_pixels.dot(&self.components.t());
            self.of_coefficients += &shares.t().dot(&of_functions);
        }
        if !wanted.stamps {
            return;
        }
        self.of_components += &shares.dot(&self.parameters.coefficients).t().dot(&of_pixels);
        self.of_mean += &shares.sum_axis(Axis(1)).dot(&of_pixels);
    }

    fn finish(self) -> PsfParameters {
        let derivative = self.derivative;
        let (ny, nx) = derivative.grids[0].dim();
        let mut components = Array3::zeros((self.of_components.nrows(), ny, nx));
        for (mut stamp, row) in components.outer_iter_mut().zip(self.of_components.outer_iter()) {
            stamp.assign(&derivative.to_model(row.to_owned()));
        }
        let mean = self.parameters.mean.as_ref();
        PsfParameters {
            mean: mean.map(|_| derivative.to_model(self.of_mean)),
            components,
            coefficients: self.of_coefficients,
        }
    }
}
