//! Faint sources, drawn photon by photon.

use conv_core::{ConvReal, ExpectedPhotons, PhotonReport, PhotonSources, zeros};
use detector::{BadPixelMask, Detector, Exposure};
use ndarray::Array2;
use psf_types::{Image, Progress};

use super::Simulator;
use super::sources::with_extended;
use crate::error::PsfieldError;
use crate::scene::{Layer, Scene};

/// Which sources are drawn photon by photon.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ShootBelow {
    /// Sources of fewer expected photons, both stars and galaxies.
    Photons(f64),
    /// Sources for which it is predicted to be faster than drawing.
    Auto,
}

impl<T: ConvReal> Simulator<T> {
    /// Divides a scene in two: the images and the sources that are drawn as light, and the faint sources that
    /// are drawn photon by photon ([`shoot`](Self::shoot)), for an exposure by a detector.
    ///
    /// # Errors
    /// [`PsfieldError`] if the scene does not fit the simulator, and the errors of [`prepare`](Self::prepare).
    pub fn split_faint<'a>(
        &self,
        scene: &Scene<'a, T>,
        below: ShootBelow,
        detector: &Detector,
    ) -> Result<(Scene<'a, T>, Scene<'a, T>), PsfieldError> {
        self.check_scene(scene)?;
        let photons_of = |flux: f64| flux.abs() * detector.params().electrons_per_flux;
        let below = match below {
            ShootBelow::Photons(below) => [below; 2],
            ShootBelow::Auto => match scene.layers().iter().position(Layer::has_sources) {
                Some(layer) => {
                    let stars: Vec<f64> = scene.stars().map(|star| photons_of(star.flux())).collect();
                    let extended = scene.points().skip(stars.len());
                    let extended: Vec<f64> = extended.map(|(_, flux)| photons_of(flux)).collect();
                    let photons = ExpectedPhotons {
                        stars: &stars,
                        extended: &extended,
                        has_background: detector.has_background() || scene.has_image(),
                    };
                    self.sources(layer)?.photons_to_shoot_below(photons, self.frame())
                }
                None => [0.0; 2],
            },
        };
        Ok(scene.split(|point, is_star| photons_of(point.flux()) < below[usize::from(!is_star)]))
    }

    /// Draws the sources of a scene photon by photon, and returns the counts `[y, x]` of the image. They are
    /// independent Poisson deviates, whose means are `photons_per_flux` times the image of the scene
    /// ([`SourcePlan::shoot_into`](conv_core::SourcePlan::shoot_into)). `seed` chooses them: neither threads nor
    /// regions nor the order of sources matter.
    ///
    /// # Errors
    /// [`PsfieldError`] if the scene does not fit the simulator or the image is output-anchored, and the errors
    /// of [`prepare`](Self::prepare).
    pub fn shoot(
        &self,
        scene: &Scene<'_, T>,
        (photons_per_flux, seed): (f64, u64),
        progress: &dyn Progress,
    ) -> Result<(Array2<i32>, PhotonReport), PsfieldError> {
        self.check_scene(scene)?;
        let (frame, region) = (self.frame(), self.setup.geometry.region);
        let shape = region.shape();
        let mut counts = zeros((shape.ny(), shape.nx()));
        let mut sum = PhotonReport::default();
        let layers = scene.layers().iter().enumerate();
        for (number, layer) in layers.filter(|(_, layer)| layer.has_sources()) {
            let plan = self.sources(number)?;
            let report = with_extended(layer, |extended| {
                let sources = PhotonSources {
                    stars: layer.stars(),
                    extended,
                    photons_per_flux,
                    // Equal sources of several layers get different photons.
                    seed: seed.wrapping_add((number as u64).wrapping_mul(OF_LAYER)),
                };
                plan.shoot_into(&sources, frame, region, counts.view_mut(), progress)
            })?;
            sum.sources += report.sources;
            sum.mean += report.mean;
            sum.photons += report.photons;
            sum.counted += report.counted;
        }
        Ok((counts, sum))
    }
}

/// The settings of an exposure ([`Simulator::expose`]).
#[derive(Debug, Clone, Copy)]
pub struct ExposeOptions<'a> {
    /// The detector.
    pub detector: &'a Detector,
    /// The seed of its noise and of the photons.
    pub seed: u64,
    /// The sources that are drawn photon by photon. None: no source.
    pub shoot_below: Option<ShootBelow>,
    /// Bad pixels beside those that the detector draws.
    pub bad_pixels: Option<&'a BadPixelMask>,
}

impl<T: ConvReal> Simulator<T> {
    /// Simulates a scene and exposes its image. Faint sources may be drawn photon by photon: their photons have
    /// the statistics of those of light in the image.
    ///
    /// # Errors
    /// The errors of [`simulate`](Self::simulate), of [`shoot`](Self::shoot), and of the detector.
    pub fn expose(
        &self,
        scene: &Scene<'_, T>,
        options: ExposeOptions<'_>,
        progress: &dyn Progress,
    ) -> Result<Exposure<T>, PsfieldError> {
        let ExposeOptions { detector, seed, .. } = options;
        let mut exposer = detector.exposer(self.image_shape(), seed)?;
        if let Some(mask) = options.bad_pixels {
            exposer = exposer.with_mask(mask)?;
        }
        let image_of = |scene: &Scene<'_, T>| -> Result<_, PsfieldError> {
            let mut image = self.zeros();
            self.simulate_into(scene, image.view_mut(), progress)?;
            Ok(Image::new(image)?)
        };
        let Some(below) = options.shoot_below else {
            return Ok(exposer.expose(&image_of(scene)?)?);
        };
        detector.check_photon_noise()?;
        let (light, faint) = self.split_faint(scene, below, detector)?;
        if !faint.has_sources() {
            return Ok(exposer.expose(&image_of(scene)?)?);
        }
        let (photons, _) = self.shoot(&faint, (detector.photons_per_flux(), seed), progress)?;
        let exposer = exposer.with_photons(photons.view())?;
        if !light.has_image() && !light.has_sources() {
            return Ok(exposer.expose_photons()?);
        }
        Ok(exposer.expose(&image_of(&light)?)?)
    }
}

/// An odd number whose multiples differ in many bits.
const OF_LAYER: u64 = 0x9E37_79B9_7F4A_7C15;
