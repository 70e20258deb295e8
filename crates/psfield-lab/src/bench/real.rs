//! A benchmark of real work: how the cost of the method auto grows with pixels, light, sources and
//! frames.

use std::fmt;
use std::time::Instant;

use ndarray::{Array2, s};
use psf_types::{
    FrameShape, ImageView, Interpolation, NoProgress, PointSource, Position, Progress, PsfModelRecord,
    SampleCoefficients, SamplePositions, SersicProfile, SersicSource, named,
};
use psfield::convert::to_psfex;
use psfield::psf_basis::RankSelection;
use psfield::{EvaluateOptions, FitOptions, Psf, PsfieldError, Scene, Simulator, record_of_psfex};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, LogNormal};
use serde::Serialize;

use crate::bench::contender::timed_run;
use crate::bench::run::{median, relative_l2, runs_per_turn};
use crate::bench::{BenchOptions, Contender, lit_scene, stretched};
use crate::memory::PeakMemory;

/// Cases that differ in one amount. Written as the name in lower case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum RealGroup {
    /// Frames of several sizes through every PSF. Every pixel is lit.
    Pixels,
    /// Frames in which a part of the pixels is lit, chosen at random one by one. No part of the
    /// frame is empty, unless the whole frame is.
    Light,
    /// Stars of a catalogue between pixels.
    Stars,
    /// Galaxies of a catalogue, with half-light radii that are log-normal about 1.5 pixels and
    /// Sersic indices of 0.5 to 4.
    Galaxies,
    /// Many small frames with one plan. Every pixel is lit.
    Frames,
    /// Small frames, each with a PSF field of its own on one basis. They are parts of larger frames, with
    /// four times their side. Every pixel is lit.
    Fields,
}

/// The side of the frames of which those of [`RealGroup::Fields`] are a part, in sides of the parts.
const FIELD: usize = 4;

named!(
    RealGroup, "group of cases", "pixels, light, stars, galaxies, frames or fields",
    "pixels" => Pixels, "light" => Light, "stars" => Stars, "galaxies" => Galaxies, "frames" => Frames,
    "fields" => Fields
);

/// A PSF over a frame, made from a model on a regular grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RealPsf {
    /// The model on its grid. It is interpolated bilinearly.
    Grid,
    /// The model on its grid, with bicubic interpolation.
    Bicubic,
    /// A PSFEx model of this degree, fitted to the PSFs on the grid.
    Psfex(usize),
    /// PSFs at 500 random positions (fewer if the grid has fewer), interpolated by natural
    /// neighbours.
    Scattered,
}

impl fmt::Display for RealPsf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Grid => f.write_str("grid"),
            Self::Bicubic => f.write_str("grid, bicubic"),
            Self::Psfex(degree) => write!(f, "psfex, degree {degree}"),
            Self::Scattered => f.write_str("scattered"),
        }
    }
}

/// The largest number of scattered samples.
const SCATTERED: usize = 500;
/// The tolerance of all cases.
pub const REAL_TOLERANCE: f64 = 1e-3;
/// A case whose first run takes more seconds does not run again.
const LONG_SECONDS: f64 = 10.0;

impl RealPsf {
    /// Makes the model of this PSF over a frame. `grid` is stretched to the frame.
    fn record(
        self,
        grid: &PsfModelRecord,
        frame: FrameShape,
        rng: &mut ChaCha8Rng,
    ) -> Result<PsfModelRecord, PsfieldError> {
        let grid = stretched(grid, frame)?;
        match self {
            Self::Grid => Ok(grid),
            Self::Bicubic => {
                let (basis, coefficients) = (grid.basis().clone(), grid.coefficients().clone());
                let (outside, normalisation) = (grid.outside(), grid.normalisation());
                let bicubic = Interpolation::Bicubic;
                Ok(PsfModelRecord::new(
                    basis,
                    coefficients,
                    bicubic,
                    outside,
                    normalisation,
                )?)
            }
            Self::Psfex(degree) => record_of_psfex(&to_psfex(&grid.into(), Some(degree))?.model),
            Self::Scattered => {
                let count = SCATTERED.min(grid.coefficients().positions().len());
                let positions = (0..count).map(|_| random_position(frame, rng));
                let positions = positions.collect::<Result<_, _>>()?;
                let rank = grid.basis().rank();
                let samples = Psf::from(grid).evaluate(positions, EvaluateOptions::default())?;
                let options = FitOptions {
                    rank: RankSelection::Full,
                    interpolation: Interpolation::NaturalNeighbour,
                    ..FitOptions::default()
                };
                Ok(Psf::new(samples, options).record()?.truncated(rank)?)
            }
        }
    }
}

/// A case of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RealCase {
    /// The group.
    pub group: RealGroup,
    /// The PSF.
    pub psf: RealPsf,
    /// Columns and rows of a frame.
    pub side: usize,
    /// The amount in which the cases of the group differ, in the [`unit`](RealGroup::unit) of the
    /// group.
    pub amount: f64,
}

impl RealGroup {
    /// All groups.
    pub const ALL: [Self; 6] = [
        Self::Pixels,
        Self::Light,
        Self::Stars,
        Self::Galaxies,
        Self::Frames,
        Self::Fields,
    ];

    /// The unit of [`RealCase::amount`].
    pub fn unit(self) -> &'static str {
        match self {
            Self::Pixels => "pixels",
            Self::Light => "% lit",
            Self::Stars => "stars",
            Self::Galaxies => "galaxies",
            Self::Frames | Self::Fields => "frames",
        }
    }

    /// The cases of the group. `sizes` are the sides of the frames of [`Pixels`](Self::Pixels). The
    /// frames of the other groups are at most as large as the largest of them. `quick` chooses a
    /// few small amounts.
    pub fn cases(self, sizes: &[usize], quick: bool) -> Vec<RealCase> {
        const PSFS: [RealPsf; 5] = [
            RealPsf::Grid,
            RealPsf::Bicubic,
            RealPsf::Psfex(2),
            RealPsf::Psfex(3),
            RealPsf::Scattered,
        ];
        let largest = sizes.iter().copied().max();
        let case = |psf, side, amount| RealCase {
            group: self,
            psf,
            side,
            amount,
        };
        let (side, amounts, quick_amounts): (usize, &[f64], &[f64]) = match self {
            Self::Pixels => {
                let of_psf = |psf| {
                    let cases = sizes.iter();
                    cases.map(move |&side| case(psf, side, (side * side) as f64))
                };
                return PSFS.into_iter().flat_map(of_psf).collect();
            }
            Self::Fields => {
                let side = largest.map_or(256, |largest| largest.min(256));
                let amount = if quick { 4.0 } else { 100.0 };
                return PSFS.map(|psf| case(psf, side, amount)).to_vec();
            }
            Self::Light => (4096, &[0.0, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0], &[0.0, 3.0, 100.0]),
            Self::Stars => (9216, &[1e3, 1e4, 1e5, 1e6, 1e7], &[1e3]),
            Self::Galaxies => (4096, &[1e3, 1e4, 1e5], &[10.0]),
            Self::Frames => (256, &[1000.0], &[10.0]),
        };
        let amounts = if quick { quick_amounts } else { amounts };
        let side = side.min(largest.unwrap_or(side));
        let case = |&amount| case(RealPsf::Scattered, side, amount);
        amounts.iter().map(case).collect()
    }
}

impl RealCase {
    /// The frame to which the field of the telescope is stretched.
    fn field(&self) -> Result<FrameShape, PsfieldError> {
        let factor = if self.group == RealGroup::Fields { FIELD } else { 1 };
        Ok(FrameShape::new(factor * self.side, factor * self.side)?)
    }
}

/// The results of a case.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RealRow {
    /// [`RealCase::group`].
    pub group: RealGroup,
    /// [`RealCase::psf`] as text.
    pub psf: String,
    /// Columns and rows of a frame.
    pub size: [usize; 2],
    /// [`RealCase::amount`].
    pub amount: f64,
    /// [`RealGroup::unit`].
    pub unit: &'static str,
    /// Seconds from the coefficients of the samples to the model, with its interpolator: the least
    /// of all repetitions. A model serves any number of plans. The fit, which makes the
    /// coefficients, is not included.
    pub seconds_model: f64,
    /// Seconds from the model to a simulator that is ready to run: the least of all repetitions.
    pub seconds_plan: f64,
    /// Seconds of the first run, of all frames. For stars and galaxies, this run also makes the
    /// PSFs of all blocks of the frame. Later runs use them again.
    pub seconds_first: f64,
    /// Seconds of the fastest run after the first one. Equals `seconds_first` if this takes more
    /// than 10 s, because the case then runs only once.
    pub seconds: f64,
    /// Median of the seconds of these runs.
    pub seconds_median: f64,
    /// Seconds of the fastest run with [`Contender::Single`]. None for stars and galaxies.
    pub seconds_single: Option<f64>,
    /// Relative L2 difference of the last frame from the direct sum in double precision, at random
    /// pixels. For stars and galaxies, these are at most 3 pixels from a source along x and along
    /// y. None if the direct sum is 0 at all these pixels.
    pub relative_l2: Option<f64>,
    /// The largest memory that the process held between the start of the model and the end of the
    /// first run. None if the system does not report it. It includes the scenes.
    pub peak_memory_bytes: Option<u64>,
}

/// Measures cases one after the other, with tolerance [`REAL_TOLERANCE`] and the method auto in
/// f32. `grid` is a model on a regular grid of samples, interpolated bilinearly.
///
/// For cases with images, the method auto and the single PSF run in turn, as in
/// [`run`](crate::bench::run()).
///
/// # Errors
/// [`PsfieldError`] if a PSF cannot be made from `grid`, or if a simulation fails.
pub fn run_real_cases(
    cases: &[RealCase],
    grid: &PsfModelRecord,
    options: &BenchOptions,
    progress: &dyn Progress,
) -> Result<Vec<RealRow>, PsfieldError> {
    progress.start(cases.len() as u64);
    let mut rows = Vec::with_capacity(cases.len());
    // Cases of one PSF and field are neighbours in the list.
    for cases in cases.chunk_by(|a, b| (a.psf, a.field().ok()) == (b.psf, b.field().ok())) {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let record = cases[0].psf.record(grid, cases[0].field()?, &mut rng)?;
        for case in cases {
            let frame = FrameShape::new(case.side, case.side)?;
            rows.push(measured(case, &record, frame, options)?);
            progress.advance(1);
        }
    }
    Ok(rows)
}

/// A simulator with the seconds of its runs.
struct Timed<'a> {
    simulator: Simulator<f32>,
    /// The PSFs of the frames in turn. Empty if all frames have that of the simulator.
    fields: &'a [Psf],
    first: f64,
    later: Vec<f64>,
}

fn measured(
    case: &RealCase,
    record: &PsfModelRecord,
    frame: FrameShape,
    options: &BenchOptions,
) -> Result<RealRow, PsfieldError> {
    let scenes = Scenes::new(case, frame, options.seed)?;
    // The PSFs of the frames in turn, if each has its own.
    let fields = match case.group {
        RealGroup::Fields => mirrored(record, case.field()?)?,
        _ => Vec::new(),
    };
    let last = scenes.get(scenes.count - 1)?;
    let mut image = conv_core::zeros((frame.ny(), frame.nx()));
    let auto = Contender::Auto {
        tolerance: REAL_TOLERANCE,
    };
    // Makes the model and the plan. Returns the seconds of both.
    let made = || {
        let psf = Psf::from(record.clone());
        let clock = Instant::now();
        psf.model()?;
        let seconds_model = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let simulator = auto.simulator(record, &psf, frame, options)?;
        simulator.prepare(&last, false, &NoProgress)?;
        Ok::<_, PsfieldError>((psf, simulator, seconds_model, clock.elapsed().as_secs_f64()))
    };

    let memory = PeakMemory::start();
    let (psf, simulator, mut seconds_model, mut seconds_plan) = made()?;
    let first = scenes.seconds(&simulator, &fields, &mut image)?;
    let peak_memory_bytes = memory.bytes();

    let pixels = scenes.pixels(options);
    let exact = match of_frame(&fields, scenes.count - 1) {
        None => simulator.exact_at(&last, &pixels, &NoProgress)?,
        Some(psf) => {
            let simulator = simulator.for_other_field(psf, &NoProgress)?;
            simulator.exact_at(&last, &pixels, &NoProgress)?
        }
    };
    let relative_l2 = relative_l2(&image, &pixels, &exact);

    for _ in 1..options.repeat {
        let (_, _, of_model, of_plan) = made()?;
        seconds_model = seconds_model.min(of_model);
        seconds_plan = seconds_plan.min(of_plan);
    }
    let timed = |simulator, fields, first| Timed {
        simulator,
        fields,
        first,
        later: Vec::new(),
    };
    let mut all = vec![timed(simulator, &fields[..], first)];
    if last.image().is_some() {
        let simulator = Contender::Single.simulator(record, &psf, frame, options)?;
        let first = scenes.seconds(&simulator, &[], &mut image)?;
        all.push(timed(simulator, &[], first));
    }
    for _ in 0..options.repeat.max(1) {
        for timed in all.iter_mut().filter(|timed| timed.first <= LONG_SECONDS) {
            for _ in 0..runs_per_turn(timed.first) {
                let seconds = scenes.seconds(&timed.simulator, timed.fields, &mut image)?;
                timed.later.push(seconds);
            }
        }
    }
    for timed in &mut all {
        if timed.later.is_empty() {
            timed.later.push(timed.first);
        }
        timed.later.sort_by(f64::total_cmp);
    }
    Ok(RealRow {
        group: case.group,
        psf: case.psf.to_string(),
        size: [frame.nx(), frame.ny()],
        amount: case.amount,
        unit: case.group.unit(),
        seconds_model,
        seconds_plan,
        seconds_first: first,
        seconds: all[0].later[0],
        seconds_median: median(&all[0].later),
        seconds_single: all.get(1).map(|single| single.later[0]),
        relative_l2,
        peak_memory_bytes,
    })
}

/// A PSF and its mirror images about the middle of a frame: along x, along y, and along both.
fn mirrored(record: &PsfModelRecord, frame: FrameShape) -> Result<Vec<Psf>, PsfieldError> {
    let last = [frame.nx(), frame.ny()].map(|pixels| (pixels - 1) as f64);
    let along = |turned: bool, at: f64, last: f64| if turned { last - at } else { at };
    let mirrored = |[x, y]: [bool; 2]| {
        let positions = record.coefficients().positions().as_slice().iter();
        let positions = positions.map(|p| Position::new(along(x, p.x(), last[0]), along(y, p.y(), last[1])));
        let positions = SamplePositions::new(positions.collect::<Result<_, _>>()?, Some(frame))?;
        let values = record.coefficients().values().to_owned();
        let record = PsfModelRecord::new(
            record.basis().clone(),
            SampleCoefficients::new(values, positions)?,
            record.interpolation(),
            record.outside(),
            record.normalisation(),
        )?;
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
fn of_frame(fields: &[Psf], k: usize) -> Option<Psf> {
    (!fields.is_empty()).then(|| fields[k % fields.len()].clone())
}

/// The number of frames that are simulated in one call.
const AT_ONCE: usize = 128;

/// The scenes of a case.
struct Scenes {
    frame: FrameShape,
    count: usize,
    /// Scene `k` has the rows of this image from `k` on. The image has `count - 1` rows more than a
    /// frame.
    image: Option<Array2<f32>>,
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
}

impl Scenes {
    fn new(case: &RealCase, frame: FrameShape, seed: u64) -> Result<Self, PsfieldError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut scenes = Self {
            frame,
            count: 1,
            image: None,
            stars: Vec::new(),
            galaxies: Vec::new(),
        };
        let sources = 0..case.amount as usize;
        match case.group {
            RealGroup::Pixels => scenes.image = Some(lit_scene(frame, seed)?.into_pixels()),
            RealGroup::Light => {
                let mut image = lit_scene(frame, seed)?.into_pixels();
                let lit = case.amount / 100.0;
                image.mapv_inplace(|v| if rng.random_bool(lit) { v } else { 0.0 });
                scenes.image = Some(image);
            }
            RealGroup::Stars => {
                scenes.stars = sources.map(|_| star(frame, &mut rng)).collect::<Result<_, _>>()?;
            }
            RealGroup::Galaxies => {
                scenes.galaxies = sources
                    .map(|_| galaxy(frame, &mut rng))
                    .collect::<Result<_, _>>()?;
            }
            RealGroup::Frames | RealGroup::Fields => {
                scenes.count = sources.len();
                let rows = FrameShape::new(frame.nx(), frame.ny() + scenes.count - 1)?;
                scenes.image = Some(lit_scene(rows, seed)?.into_pixels());
            }
        }
        Ok(scenes)
    }

    fn get(&self, k: usize) -> Result<Scene<'_, f32>, PsfieldError> {
        let scene = match &self.image {
            Some(image) => ImageView::new(image.slice(s![k..k + self.frame.ny(), ..]))?.into(),
            None => Scene::dark(),
        };
        Ok(scene
            .with_stars(&self.stars[..])
            .with_galaxies(&self.galaxies[..]))
    }

    /// Chooses the pixels `(column, row)` at which the image of a scene is compared.
    fn pixels(&self, options: &BenchOptions) -> Vec<(usize, usize)> {
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
        let count = options.pixels.max(1);
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
    fn seconds(
        &self,
        simulator: &Simulator<f32>,
        fields: &[Psf],
        image: &mut Array2<f32>,
    ) -> Result<f64, PsfieldError> {
        if self.count == 1 {
            return Ok(timed_run(simulator, &self.get(0)?, image)?.seconds);
        }
        let mut seconds = 0.0;
        if !fields.is_empty() {
            for k in 0..self.count {
                let (scene, psf) = (self.get(k)?, of_frame(fields, k).expect("a PSF"));
                let clock = Instant::now();
                image.fill(0.0);
                let simulator = simulator.for_other_field(psf, &NoProgress)?;
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

/// Returns a random position on the frame.
fn random_position(frame: FrameShape, rng: &mut ChaCha8Rng) -> Result<Position, PsfieldError> {
    let mut along = |pixels: usize| rng.random::<f64>() * (pixels - 1) as f64;
    Ok(Position::new(along(frame.nx()), along(frame.ny()))?)
}

/// Returns a random flux between 10^2 and 10^5, each power of ten with equal probability.
fn flux(rng: &mut ChaCha8Rng) -> f64 {
    10f64.powf(rng.random_range(2.0..5.0))
}

fn star(frame: FrameShape, rng: &mut ChaCha8Rng) -> Result<PointSource, PsfieldError> {
    Ok(PointSource::new(random_position(frame, rng)?, flux(rng))?)
}

fn galaxy(frame: FrameShape, rng: &mut ChaCha8Rng) -> Result<SersicSource, PsfieldError> {
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
        let pixels = |k| frames.get(k).unwrap().image().unwrap().pixels().to_owned();
        assert_eq!((frames.count, pixels(2).dim()), (3, (60, 60)));
        assert_ne!(pixels(0), pixels(2));
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

    #[test]
    fn frames_are_no_larger_than_the_largest_size() {
        let sides = |sizes: &[usize]| {
            let cases = RealGroup::ALL.map(|group| group.cases(sizes, false));
            cases.map(|cases| cases.iter().map(|case| case.side).max().unwrap())
        };
        assert_eq!(sides(&[1024, 9216]), [9216, 4096, 9216, 4096, 256, 256]);
        assert_eq!(sides(&[200, 100]), [200; 6]);
        let names = RealGroup::ALL.map(|group| group.to_string().parse::<RealGroup>());
        assert_eq!(names.map(Result::unwrap), RealGroup::ALL);
    }
}
