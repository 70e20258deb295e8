//! The scenes of a case of real work, and the PSFs of its frames.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use ndarray::{Array2, s};
use psf_types::{
    FrameShape, ImageView, NoProgress, PointSource, Position, PsfModelRecord, SersicProfile, SersicSource,
};
use psfield::detector::{Detector, DetectorParams};
use psfield::{ExposeOptions, Psf, PsfieldError, Scene, ShootBelow, Simulator};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, LogNormal};

use crate::bench::case::{lit_scene, placed, random_position};
use crate::bench::contender::timed_run;
use crate::bench::real_case::{RealCase, RealGroup};
use crate::bench::real_series::SeriesCase;
use crate::bench::run::BenchOptions;

/// A PSF and its mirror images about the middle of a frame: along x, along y, and along both.
pub(super) fn mirrored(record: &PsfModelRecord, frame: FrameShape) -> Result<Vec<Psf>, PsfieldError> {
    let last = [frame.nx(), frame.ny()].map(|pixels| (pixels - 1) as f64);
    let along = |turned: bool, at: f64, last: f64| if turned { last - at } else { at };
    let mirrored = |[x, y]: [bool; 2]| {
        let record = placed(record, frame, |p| {
            [along(x, p.x(), last[0]), along(y, p.y(), last[1])]
        })?;
        let psf = Psf::from(record);
        psf.model()?;
        Ok(psf)
    };
    [[false, false], [true, false], [false, true], [true, true]]
        .map(mirrored)
        .into_iter()
        .collect()
}

/// The PSF of frame `k`, if the frames have their own.
pub(super) fn of_frame(fields: &[Psf], k: usize) -> Option<Psf> {
    (!fields.is_empty()).then(|| fields[k % fields.len()].clone())
}

/// The number of frames that are simulated in one call.
const AT_ONCE: usize = 128;

/// Makes the images of a case.
pub(super) enum CaseSimulator {
    /// Images of one PSF, or of several spectra.
    Images(Box<Simulator<f32>>),
    /// Images with the noise of photons, and the sources that are drawn photon by photon.
    Exposed(Arc<Simulator<f32>>, ShootBelow),
    /// Exposures, each with its own plan.
    Series(Box<SeriesCase>),
}

/// The stars of a series.
const STARS_OF_SERIES: usize = 2000;

/// The most stars, and as many galaxies, of a case of [`RealGroup::Floor`], and the decades of their fluxes.
const SOURCES_OF_FLOOR: usize = 10_000;
const FLUXES_OF_FLOOR: Range<f64> = 0.0..6.0;
/// The most stars or galaxies of a case of [`RealGroup::StarPhotons`] or [`RealGroup::GalaxyPhotons`].
const SOURCES_OF_PHOTONS: usize = 100_000;
/// The fewest pixels of the frame for each of these sources.
const PIXELS_OF_SOURCE: usize = 100;
/// The pixels at which a case of [`RealGroup::Wings`] is compared: the direct sum of each has a million terms.
const PIXELS_OF_WINGS: usize = 10;
/// The decades of other fluxes.
const FLUXES: Range<f64> = 2.0..5.0;

/// The scenes of a case.
pub(super) struct Scenes {
    group: RealGroup,
    frame: FrameShape,
    /// The number of images.
    pub(super) count: usize,
    /// The number of layers of each scene, one for each spectrum.
    layers: usize,
    /// Scene `k` has the rows of this image from `k` on.
    image: Option<Array2<f32>>,
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
}

impl Scenes {
    pub(super) fn new(case: &RealCase, frame: FrameShape, seed: u64) -> Result<Self, PsfieldError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let amount = case.amount as usize;
        let (count, layers) = match case.group {
            RealGroup::Frames | RealGroup::Fields => (amount, 1),
            RealGroup::Colours => (1, amount),
            _ => (1, 1),
        };
        let at_most = |count: usize| count.min(frame.pixel_count() / PIXELS_OF_SOURCE);
        let (of_floor, of_photons) = (at_most(SOURCES_OF_FLOOR), at_most(SOURCES_OF_PHOTONS));
        let (stars, galaxies) = match case.group {
            RealGroup::Stars => (amount, 0),
            RealGroup::StarSeries => (STARS_OF_SERIES, 0),
            RealGroup::Galaxies => (0, amount),
            RealGroup::Floor => (of_floor, of_floor),
            RealGroup::StarPhotons => (of_photons, 0),
            RealGroup::GalaxyPhotons => (0, of_photons),
            _ => (0, 0),
        };
        let image = if stars + galaxies == 0 {
            let rows = FrameShape::new(frame.nx(), frame.ny() + count + layers - 2)?;
            let mut image = lit_scene(rows, seed)?.into_pixels();
            if case.group == RealGroup::Light {
                let lit = case.amount / 100.0;
                image.mapv_inplace(|v| if rng.random_bool(lit) { v } else { 0.0 });
            }
            Some(image)
        } else {
            None
        };
        let fluxes = match case.group {
            RealGroup::Floor => Some(FLUXES_OF_FLOOR),
            // All fluxes are equal.
            RealGroup::StarPhotons | RealGroup::GalaxyPhotons => None,
            _ => Some(FLUXES),
        };
        let flux = |rng: &mut ChaCha8Rng| match &fluxes {
            // Each power of ten has equal probability.
            Some(decades) => 10f64.powf(rng.random_range(decades.clone())),
            None => case.amount,
        };
        let stars = (0..stars).map(|_| star(frame, flux, &mut rng));
        let stars = stars.collect::<Result<_, _>>()?;
        let galaxies = (0..galaxies).map(|_| galaxy(frame, flux, &mut rng));
        Ok(Self {
            group: case.group,
            frame,
            count,
            layers,
            image,
            stars,
            galaxies: galaxies.collect::<Result<_, _>>()?,
        })
    }

    /// Scene `k`.
    pub(super) fn get(&self, k: usize) -> Result<Scene<'_, f32>, PsfieldError> {
        let layers = (k..k + self.layers).map(|k| self.layer(k));
        Ok(Scene::of_layers(layers.collect::<Result<Vec<_>, _>>()?))
    }

    /// A scene of one layer, with the rows of the image from `k` on.
    pub(super) fn layer(&self, k: usize) -> Result<Scene<'_, f32>, PsfieldError> {
        let scene = match &self.image {
            Some(image) => ImageView::new(image.slice(s![k..k + self.frame.ny(), ..]))?.into(),
            None => Scene::dark(),
        };
        Ok(scene
            .with_stars(&self.stars[..])
            .with_galaxies(&self.galaxies[..]))
    }

    /// Chooses the pixels `(column, row)` at which the image of a scene is compared.
    pub(super) fn pixels(&self, options: &BenchOptions) -> Vec<(usize, usize)> {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let stars = self.stars.iter().map(|star| star.position());
        let galaxies = self.galaxies.iter().map(|galaxy| galaxy.position());
        let sources: Vec<Position> = stars.chain(galaxies).collect();
        let pixel = |rng: &mut ChaCha8Rng, near: Option<f64>, pixels: usize| match near {
            Some(at) => (at.round() as usize + rng.random_range(0..=6))
                .saturating_sub(3)
                .min(pixels - 1),
            None => rng.random_range(0..pixels),
        };
        let count = match self.group {
            // Photons are random.
            RealGroup::StarPhotons | RealGroup::GalaxyPhotons => 0,
            RealGroup::Wings => options.pixels.clamp(1, PIXELS_OF_WINGS),
            _ => options.pixels.max(1),
        };
        let pixels = (0..count).map(|_| {
            let source = sources.choose(&mut rng);
            let x = pixel(&mut rng, source.map(|at| at.x()), self.frame.nx());
            (x, pixel(&mut rng, source.map(|at| at.y()), self.frame.ny()))
        });
        pixels.collect()
    }

    /// Makes the images of all scenes, the last in the array `image`. Scenes have the PSFs of `fields` in
    /// turn, if there are any. Returns the seconds of all simulations, with those of the plans for
    /// these PSFs.
    pub(super) fn seconds(
        &self,
        simulator: &CaseSimulator,
        fields: &[Psf],
        image: &mut Array2<f32>,
    ) -> Result<f64, PsfieldError> {
        let simulator = match simulator {
            CaseSimulator::Images(simulator) => simulator,
            CaseSimulator::Exposed(simulator, below) => return exposed(simulator, &self.get(0)?, *below),
            CaseSimulator::Series(series) => return series.seconds(image),
        };
        if self.count == 1 {
            let scene = match simulator.layer_count() {
                1 => self.layer(0)?,
                _ => self.get(0)?,
            };
            return Ok(timed_run(simulator, &scene, image)?.seconds);
        }
        let mut seconds = 0.0;
        if !fields.is_empty() {
            for k in 0..self.count {
                let (scene, psf) = (self.get(k)?, of_frame(fields, k).expect("a PSF"));
                let clock = Instant::now();
                image.fill(0.0);
                let simulator = simulator.with_psf(psf, &NoProgress)?;
                simulator.simulate_into(&scene, image.view_mut(), &NoProgress)?;
                seconds += clock.elapsed().as_secs_f64();
            }
            return Ok(seconds);
        }
        let mut images = vec![image.clone(); AT_ONCE.min(self.count)];
        for first in (0..self.count).step_by(AT_ONCE) {
            let some = (first..self.count).take(AT_ONCE);
            let scenes = some.map(|k| self.get(k)).collect::<Result<Vec<_>, _>>()?;
            let clock = Instant::now();
            for image in &mut images {
                image.fill(0.0);
            }
            let views = images[..scenes.len()].iter_mut().map(|image| image.view_mut());
            simulator.simulate_many_into(&scenes, views.collect(), &NoProgress)?;
            seconds += clock.elapsed().as_secs_f64();
            image.assign(&images[scenes.len() - 1]);
        }
        Ok(seconds)
    }
}

/// Seconds of an image that is simulated and exposed without sky.
fn exposed(
    simulator: &Simulator<f32>,
    scene: &Scene<'_, f32>,
    shoot_below: ShootBelow,
) -> Result<f64, PsfieldError> {
    let detector = Detector::new(DetectorParams {
        photon_noise: true,
        ..DetectorParams::default()
    })?;
    let options = ExposeOptions {
        detector: &detector,
        seed: 1,
        shoot_below: Some(shoot_below),
        bad_pixels: None,
    };
    let clock = Instant::now();
    simulator.expose(scene, options, &NoProgress)?;
    Ok(clock.elapsed().as_secs_f64())
}

fn star(
    frame: FrameShape,
    flux: impl Fn(&mut ChaCha8Rng) -> f64,
    rng: &mut ChaCha8Rng,
) -> Result<PointSource, PsfieldError> {
    Ok(PointSource::new(random_position(frame, rng)?, flux(rng))?)
}

fn galaxy(
    frame: FrameShape,
    flux: impl Fn(&mut ChaCha8Rng) -> f64,
    rng: &mut ChaCha8Rng,
) -> Result<SersicSource, PsfieldError> {
    let radius = LogNormal::new(1.5f64.ln(), 0.5).expect("a finite width");
    let profile = SersicProfile::new(
        radius.sample(rng).clamp(0.3, 8.0),
        rng.random_range(0.5..4.0),
        rng.random_range(0.2..1.0),
        rng.random_range(0.0..180.0),
    )?;
    Ok(SersicSource::new(
        random_position(frame, rng)?,
        flux(rng),
        profile,
    )?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::real_case::RealPsf;
    use ndarray::Array3;

    fn scenes(group: RealGroup, amount: f64) -> Scenes {
        let case = RealCase {
            group,
            psf: RealPsf::Grid,
            side: 60,
            amount,
        };
        Scenes::new(&case, FrameShape::new(60, 60).unwrap(), 1).unwrap()
    }

    #[test]
    fn scenes_have_the_amounts_of_their_cases() {
        let lit = |percent| {
            let scenes = scenes(RealGroup::Light, percent);
            scenes.image.unwrap().iter().filter(|v| **v != 0.0).count()
        };
        assert_eq!((lit(0.0), lit(100.0)), (0, 3600));
        // 360 pixels on average, with a standard deviation of 18.
        assert!((270..450).contains(&lit(10.0)));
        assert_eq!(scenes(RealGroup::Stars, 7.0).stars.len(), 7);
        assert_eq!(scenes(RealGroup::Galaxies, 5.0).galaxies.len(), 5);
        let frames = scenes(RealGroup::Frames, 3.0);
        let pixels = |k| {
            frames.get(k).unwrap().layers()[0]
                .image()
                .unwrap()
                .pixels()
                .to_owned()
        };
        assert_eq!((frames.count, pixels(2).dim()), (3, (60, 60)));
        assert_ne!(pixels(0), pixels(2));
        let colours = scenes(RealGroup::Colours, 5.0);
        assert_eq!((colours.count, colours.get(0).unwrap().layers().len()), (1, 5));
    }

    #[test]
    fn fields_are_mirror_images() {
        let frame = FrameShape::new(30, 20).unwrap();
        let corners = [(0.0, 0.0), (29.0, 0.0), (0.0, 19.0), (29.0, 19.0)];
        let stamps = Array3::from_shape_fn((4, 3, 3), |(i, y, x)| {
            let middle = if (y, x) == (1, 1) { 10.0 } else { 1.0 };
            middle + (i * x) as f64 + (i * i * y) as f64
        });
        let psf = Psf::from_samples(stamps.view(), &corners).unwrap();
        let fields = mirrored(psf.record().unwrap(), frame).unwrap();
        let at = |k: usize, x: f64, y: f64| {
            let psf = of_frame(&fields, k).unwrap();
            let stamp = psf.model().unwrap().psf_at(Position::new(x, y).unwrap());
            stamp.unwrap().values().to_owned()
        };
        for (k, (x, y)) in [(4.0, 6.0), (25.0, 6.0), (4.0, 13.0), (25.0, 13.0), (4.0, 6.0)]
            .into_iter()
            .enumerate()
        {
            let difference = at(k, x, y) - at(0, 4.0, 6.0);
            assert!(difference.iter().all(|v| v.abs() < 1e-12), "{k}");
        }
        assert_ne!(at(1, 4.0, 6.0), at(0, 4.0, 6.0));
        assert!(of_frame(&[], 3).is_none());
    }
}
