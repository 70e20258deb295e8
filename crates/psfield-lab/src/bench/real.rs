//! A benchmark of real work: how the cost of the method auto grows with pixels, light, sources,
//! frames, spectra and exposures.

use std::sync::Arc;
use std::time::Instant;

use metrics::Summary;
use ndarray::Array2;
use psf_types::{FrameShape, NoProgress, Progress, PsfModelRecord};
use psfield::{Psf, PsfieldError, ShootBelow, SimulateOptions};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::bench::real_case::{RealCase, RealGroup, RealPsf};
use crate::bench::real_colours::black_bodies;
use crate::bench::real_scenes::{CaseSimulator, Scenes, mirrored, of_frame};
use crate::bench::real_series::{SeriesCase, psf_of_times};
use crate::bench::real_wings::with_wings;
use crate::bench::run::{relative_l2, runs_per_turn};
use crate::bench::{BenchOptions, Contender};
use crate::memory::PeakMemory;

/// The tolerance of all cases.
pub const REAL_TOLERANCE: f64 = 1e-3;
const AUTO: Contender = Contender::Auto {
    tolerance: REAL_TOLERANCE,
};
/// A case whose first run takes more seconds does not run again.
const LONG_SECONDS: f64 = 10.0;

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
    /// Seconds from the model to a simulator that is ready to run: the least of all repetitions. Series
    /// make their plans in each run, so this is next to nothing for them.
    pub seconds_plan: f64,
    /// Seconds of the first run, of all frames. For stars and galaxies, this run also makes the
    /// PSFs of all blocks of the frame. Later runs use them again. For [`RealGroup::Fields`] and series,
    /// all runs make their plans.
    pub seconds_first: f64,
    /// Seconds of the fastest run after the first one. Equals `seconds_first` if this takes more
    /// than 10 s, because the case then runs only once.
    pub seconds: f64,
    /// Median of the seconds of these runs.
    pub seconds_median: f64,
    /// Seconds of the fastest run with [`Contender::Single`]. None for stars, galaxies and series.
    pub seconds_single: Option<f64>,
    /// Seconds of the fastest run of simpler work. For [`RealGroup::Colours`]: the light and the PSF of
    /// the first spectrum alone. For [`RealGroup::Series`] and [`RealGroup::StarSeries`]: the series
    /// through the PSF of the first time, without drift, so that one plan serves all exposures. For
    /// [`RealGroup::StarPhotons`] and [`RealGroup::GalaxyPhotons`]: all sources drawn as light. None for other
    /// groups.
    pub seconds_simpler: Option<f64>,
    /// Seconds of the fastest run with all sources drawn photon by photon. None for groups without photons.
    pub seconds_photons: Option<f64>,
    /// Relative L2 difference of the last frame from the direct sum in double precision, at random
    /// pixels. For stars and galaxies, these are at most 3 pixels from a source along x and along
    /// y. None if the direct sum is 0 at all these pixels, and for photons.
    pub relative_l2: Option<f64>,
    /// The largest memory that the process held between the start of the model and the end of the
    /// first run. None if the system does not report it. It includes the scenes.
    pub peak_memory_bytes: Option<u64>,
}

/// Measures cases one after the other, with tolerance [`REAL_TOLERANCE`] and the method auto in
/// f32. `grid` is a model on a regular grid of samples, interpolated bilinearly. Only the PSFs
/// [`RealPsf::Spectra`] and [`RealPsf::Times`] do not need it. `of_spectra` is the PSF
/// [`RealPsf::Spectra`] ([`of_black_bodies`](crate::bench::of_black_bodies)). None: that of the survey
/// telescope.
///
/// For cases with images, the method auto and the single PSF run in turn, as in
/// [`run`](crate::bench::run()), and so does simpler work ([`RealRow::seconds_simpler`]).
///
/// # Errors
/// [`PsfieldError`] if a PSF cannot be made from `grid`, or if a simulation fails.
///
/// # Panics
/// When a case needs `grid`, and it is None.
pub fn run_real_cases(
    cases: &[RealCase],
    (grid, mut of_spectra): (Option<&PsfModelRecord>, Option<PsfModelRecord>),
    options: &BenchOptions,
    progress: &dyn Progress,
) -> Result<Vec<RealRow>, PsfieldError> {
    progress.start(cases.len() as u64);
    let mut rows = Vec::with_capacity(cases.len());
    let mut of_times = None;
    // Cases of one PSF and field are neighbours in the list.
    for cases in cases.chunk_by(|a, b| (a.psf, a.field_side()) == (b.psf, b.field_side())) {
        let side = cases[0].field_side();
        let field = FrameShape::new(side, side)?;
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let record = match cases[0].psf {
            RealPsf::Spectra => {
                if of_spectra.is_none() {
                    of_spectra = Some(black_bodies()?);
                }
                of_spectra.as_ref().expect("made above")
            }
            RealPsf::Times => {
                if of_times.is_none() {
                    of_times = Some(psf_of_times(cases[0].amount as usize)?);
                }
                of_times.as_ref().expect("made above")
            }
            _ => grid.expect("a model on a grid"),
        };
        let record = cases[0].psf.record(record, field, &mut rng)?;
        for case in cases {
            let frame = FrameShape::new(case.side, case.side)?;
            // The PSFs of the frames in turn, if each has its own.
            let fields = match case.group {
                RealGroup::Fields => mirrored(&record, field)?,
                _ => Vec::new(),
            };
            let of_case = match case.group {
                RealGroup::Wings => Some(with_wings(record.clone(), frame, case.amount as usize)?),
                _ => None,
            };
            let record = of_case.as_ref().unwrap_or(&record);
            rows.push(measured(case, (record, &fields), frame, options)?);
            progress.advance(1);
        }
    }
    Ok(rows)
}

/// A simulator with the seconds of its runs.
struct Timed<'a> {
    simulator: CaseSimulator,
    /// The PSFs of the frames in turn. Empty if all frames have that of the simulator.
    fields: &'a [Psf],
    first: f64,
    later: Vec<f64>,
}

impl<'a> Timed<'a> {
    /// Runs a simulator for the first time.
    fn new(
        simulator: CaseSimulator,
        fields: &'a [Psf],
        scenes: &Scenes,
        image: &mut Array2<f32>,
    ) -> Result<Self, PsfieldError> {
        Ok(Self {
            first: scenes.seconds(&simulator, fields, image)?,
            simulator,
            fields,
            later: Vec::new(),
        })
    }

    /// The seconds of the later runs, or of the first run if it is the only one.
    fn summary(&self) -> Result<Summary, PsfieldError> {
        let only = self.later.is_empty().then_some(self.first);
        Ok(Summary::of(self.later.iter().copied().chain(only))?)
    }
}

/// Makes the simulator of a case and its plan. Series make their plans in each run.
fn planned(
    case: &RealCase,
    (record, psf): (&PsfModelRecord, &Psf),
    scenes: &Scenes,
    (frame, options): (FrameShape, &BenchOptions),
) -> Result<CaseSimulator, PsfieldError> {
    if matches!(case.group, RealGroup::Series | RealGroup::StarSeries) {
        let scene = (&scenes.get(0)?, (frame.ny(), frame.nx()));
        let series = SeriesCase::new(psf, scene, AUTO.settings(options), case.amount as usize)?;
        return Ok(CaseSimulator::Series(Box::new(series)));
    }
    let simulator = match case.group {
        RealGroup::Floor => {
            let settings = SimulateOptions {
                floor: case.amount,
                ..AUTO.settings(options)
            };
            psf.simulator((frame.ny(), frame.nx()))
                .options(settings)
                .build()?
        }
        _ => AUTO.simulator(record, psf, frame, options)?,
    };
    simulator.prepare(&scenes.get(scenes.count - 1)?, &NoProgress)?;
    Ok(match case.group {
        RealGroup::StarPhotons | RealGroup::GalaxyPhotons => {
            CaseSimulator::Exposed(Arc::new(simulator), ShootBelow::Auto)
        }
        _ => CaseSimulator::Images(Box::new(simulator)),
    })
}

/// The direct sum for the last image of a case, at some pixels.
fn exact(
    simulator: &CaseSimulator,
    scenes: &Scenes,
    fields: &[Psf],
    pixels: &[(usize, usize)],
) -> Result<Vec<f64>, PsfieldError> {
    match simulator {
        CaseSimulator::Exposed(..) => Ok(Vec::new()),
        CaseSimulator::Images(simulator) => {
            let last = scenes.get(scenes.count - 1)?;
            match of_frame(fields, scenes.count - 1) {
                None => simulator.exact_at(&last, pixels, &NoProgress),
                Some(psf) => {
                    let simulator = simulator.with_psf(psf, &NoProgress)?;
                    simulator.exact_at(&last, pixels, &NoProgress)
                }
            }
        }
        CaseSimulator::Series(series) => series.exact(pixels),
    }
}

fn measured(
    case: &RealCase,
    (record, fields): (&PsfModelRecord, &[Psf]),
    frame: FrameShape,
    options: &BenchOptions,
) -> Result<RealRow, PsfieldError> {
    let scenes = Scenes::new(case, frame, options.seed)?;
    let mut image = conv_core::zeros((frame.ny(), frame.nx()));
    // Makes the model and the plan. Returns the seconds of both.
    let made = || {
        let psf = Psf::from(record.clone());
        let clock = Instant::now();
        psf.models()?;
        let seconds_model = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let simulator = planned(case, (record, &psf), &scenes, (frame, options))?;
        Ok::<_, PsfieldError>((psf, simulator, seconds_model, clock.elapsed().as_secs_f64()))
    };

    let memory = PeakMemory::start();
    let (psf, simulator, mut seconds_model, mut seconds_plan) = made()?;
    let mut whole = Timed::new(simulator, fields, &scenes, &mut image)?;
    let peak_memory_bytes = memory.bytes();

    let pixels = scenes.pixels(options);
    let exact = exact(&whole.simulator, &scenes, fields, &pixels)?;
    let relative_l2 = relative_l2(&image, &pixels, &exact);

    for _ in 1..options.repeat {
        let (_, _, of_model, of_plan) = made()?;
        seconds_model = seconds_model.min(of_model);
        seconds_plan = seconds_plan.min(of_plan);
    }
    let (mut single, mut simpler, mut photons) = (None, None, None);
    let mut timed = |simulator| Timed::new(simulator, &[], &scenes, &mut image).map(Some);
    if let CaseSimulator::Series(series) = &whole.simulator {
        simpler = timed(CaseSimulator::Series(Box::new(series.at_rest()?)))?;
    } else if let CaseSimulator::Exposed(simulator, _) = &whole.simulator {
        let mut below = |most| {
            let below = ShootBelow::Photons(most);
            timed(CaseSimulator::Exposed(Arc::clone(simulator), below))
        };
        simpler = below(0.0)?;
        photons = below(f64::INFINITY)?;
    } else if scenes.get(0)?.has_image() {
        let in_colour = case.group == RealGroup::Colours;
        let psf = if in_colour { psf.at_state(0.0)? } else { psf };
        let made = |contender: Contender| -> Result<_, PsfieldError> {
            let simulator = contender.simulator(record, &psf, frame, options)?;
            Ok(CaseSimulator::Images(Box::new(simulator)))
        };
        single = timed(made(Contender::Single)?)?;
        if in_colour {
            simpler = timed(made(AUTO)?)?;
        }
    }
    for _ in 0..options.repeat.max(1) {
        let all = [
            Some(&mut whole),
            single.as_mut(),
            simpler.as_mut(),
            photons.as_mut(),
        ];
        for timed in all
            .into_iter()
            .flatten()
            .filter(|timed| timed.first <= LONG_SECONDS)
        {
            for _ in 0..runs_per_turn(timed.first) {
                let seconds = scenes.seconds(&timed.simulator, timed.fields, &mut image)?;
                timed.later.push(seconds);
            }
        }
    }
    let seconds = whole.summary()?;
    let fastest = |timed: Option<Timed<'_>>| -> Result<_, PsfieldError> {
        timed.map(|timed| Ok(timed.summary()?.min())).transpose()
    };
    Ok(RealRow {
        group: case.group,
        psf: case.psf.to_string(),
        size: [frame.nx(), frame.ny()],
        amount: case.amount,
        unit: case.group.unit(),
        seconds_model,
        seconds_plan,
        seconds_first: whole.first,
        seconds: seconds.min(),
        seconds_median: seconds.median(),
        seconds_single: fastest(single)?,
        seconds_simpler: fastest(simpler)?,
        seconds_photons: fastest(photons)?,
        relative_l2,
        peak_memory_bytes,
    })
}
