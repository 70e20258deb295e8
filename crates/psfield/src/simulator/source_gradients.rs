//! Derivatives of images with respect to sources.

use std::sync::Arc;

use conv_core::{ConvReal, ExtendedSources, Light, PointGradient, Variation};
use psf_types::{DataError, ImageView, Progress, SersicProfile, SersicSource};
use sersic::SersicLight;

use super::Simulator;
use super::sources::with_extended;
use crate::error::PsfieldError;
use crate::scene::Scene;

/// Derivatives with respect to the sources of a scene ([`Simulator::source_gradients`]): those of all layers, in their
/// order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SourceGradients {
    /// With respect to each star.
    pub stars: Vec<PointGradient>,
    /// With respect to each galaxy.
    pub galaxies: Vec<GalaxyGradient>,
    /// With respect to flux and position of each source with a profile of the caller's own.
    pub profiles: Vec<PointGradient>,
}

/// Derivatives of a number with respect to a galaxy ([`SersicProfile`]).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GalaxyGradient {
    /// With respect to flux and position.
    pub point: PointGradient,
    /// With respect to the half-light radius along the major axis, in pixels.
    pub half_light_radius_px: f64,
    /// With respect to the Sersic index.
    pub index: f64,
    /// With respect to the axis ratio.
    pub axis_ratio: f64,
    /// With respect to the angle of the major axis, in degrees.
    pub angle_deg: f64,
}

/// Radius, index and axis ratio are varied by this part of them, to either side, and the angle by this number of
/// radians.
const STEP: f64 = 1e-3;

impl<T: ConvReal> Simulator<T> {
    /// Computes derivatives of `<g, A s>` with respect to the sources `s` of a scene, for an image `g`. `A` is
    /// [`simulate`](Self::simulate) for scenes without images. So if `g` is the derivative of a number, such as a sum
    /// of squares, with respect to the image of a scene, these are the derivatives of this number.
    ///
    /// They include the change of the PSF with the position, and keep the tolerance. They leave out the floor: sources
    /// without flux have a derivative with respect to it, too. Where the interpolation of the PSF over the field has a
    /// kink, those with respect to the position are one-sided.
    ///
    /// `image` is `[y, x]` of the frame or, if the simulator has a region, of this region. Images in the scene do not
    /// matter.
    ///
    /// ```
    /// use ndarray::{Array2, Array3};
    /// use psfield::prelude::*;
    /// use psfield::psf_types::{ImageView, NoProgress, PointSource, Position};
    /// let corners = [(0.0, 0.0), (49.0, 0.0), (0.0, 39.0), (49.0, 39.0)];
    /// let stamps = Array3::from_shape_fn((4, 15, 15), |(j, y, x)| {
    ///     let square = (y as f64 - 7.0).powi(2) + (x as f64 - 7.0).powi(2);
    ///     (-square / (3.0 + j as f64)).exp()
    /// });
    /// let psf = Psf::from_samples(stamps.view(), &corners)?;
    /// let simulator = psf.simulator((40, 50)).tolerance(0.0).build::<f64>()?;
    ///
    /// // The derivative of pixel (column 12, row 8) with respect to the position of a star.
    /// let scene = |x: f64| -> Result<Scene<'static>, PsfieldError> {
    ///     let star = PointSource::new(Position::new(x, 7.1)?, 100.0)?;
    ///     Ok(Scene::dark().with_stars(vec![star]))
    /// };
    /// let mut pixel = Array2::zeros((40, 50));
    /// pixel[[8, 12]] = 1.0;
    /// let image = ImageView::new(pixel.view())?;
    /// let found = simulator.source_gradients(&scene(12.4)?, &image, &NoProgress)?;
    ///
    /// let value = |x| Ok::<f64, PsfieldError>(simulator.simulate(&scene(x)?)?.pixels()[[8, 12]]);
    /// let difference = (value(12.401)? - value(12.399)?) / 0.002;
    /// assert!((found.stars[0].x - difference).abs() < 1e-4);
    /// # Ok::<(), PsfieldError>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Convolution`](crate::ErrorKind::Convolution) for an image of another shape and for a PSF with
    /// wings, and the errors of [`simulate_into`](Self::simulate_into).
    #[inline(never)]
    pub fn source_gradients(
        &self,
        scene: &Scene<'_, T>,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<SourceGradients, PsfieldError> {
        self.check_scene(scene)?;
        self.check_image(image.pixels().dim())?;
        let (frame, region) = (self.frame(), self.setup.geometry.region);
        let mut found = SourceGradients::default();
        let layers = scene.layers().iter().enumerate();
        for (number, layer) in layers.filter(|(_, layer)| layer.has_sources()) {
            let (plan, image) = (self.sources(number)?, image.pixels());
            let stars = plan.star_gradients(layer.stars(), frame, region, image, progress)?;
            found.stars.extend(stars);
            let galaxies = layer.galaxies();
            let variations = |index: usize| galaxies.get(index).map(variations).unwrap_or_default();
            let of_extended = with_extended(layer, |sources: ExtendedSources<'_>| {
                plan.extended_gradients(sources, &variations, (frame, region), image, progress)
            })?;
            let (of_galaxies, of_profiles) = of_extended.split_at(galaxies.len());
            for gradient in of_galaxies {
                // Empty if the galaxy does not reach the image.
                let varied = gradient.variations.as_slice().try_into();
                let [half_light_radius_px, index, axis_ratio, angle_deg] = varied.unwrap_or([0.0; 4]);
                found.galaxies.push(GalaxyGradient {
                    point: gradient.point,
                    half_light_radius_px,
                    index,
                    axis_ratio,
                    angle_deg,
                });
            }
            found
                .profiles
                .extend(of_profiles.iter().map(|gradient| gradient.point));
        }
        Ok(found)
    }
}

/// The light of a galaxy with a smaller and a larger radius, index, axis ratio and angle. At the end of a parameter's
/// range, it is varied to one side.
fn variations(galaxy: &SersicSource) -> Vec<Variation> {
    let profile = galaxy.profile();
    let parameters = [
        profile.half_light_radius_px(),
        profile.index(),
        profile.axis_ratio(),
        profile.angle_deg(),
    ];
    let vary = |parameter: usize| {
        let step = match parameter {
            3 => STEP.to_degrees(),
            _ => STEP * parameters[parameter],
        };
        let side = |step: f64| {
            let mut varied = parameters;
            varied[parameter] += step;
            let varied_profile = profile_of(varied);
            let (profile, varied) = varied_profile.map_or((profile, parameters), |profile| (profile, varied));
            let light: Light = Arc::new(SersicLight::of_profile(profile));
            (light, varied[parameter])
        };
        let ((before, from), (after, to)) = (side(-step), side(step));
        Variation {
            before,
            after,
            // A number so large that it does not change has no derivative.
            step: if to > from { to - from } else { 1.0 },
        }
    };
    (0..parameters.len()).map(vary).collect()
}

/// A profile whose axis ratio may be above 1: then the major axis lies across.
fn profile_of([re, n, q, angle]: [f64; 4]) -> Result<SersicProfile, DataError> {
    if q > 1.0 {
        SersicProfile::new(re * q, n, 1.0 / q, angle + 90.0)
    } else {
        SersicProfile::new(re, n, q, angle)
    }
}
