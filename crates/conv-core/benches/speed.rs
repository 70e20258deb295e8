//! The check of speed in `.ci/run`: fails if images, stars, galaxies or plans take much longer than they did.
//!
//! ```sh
//! cargo bench -p conv-core --bench speed              # compares with the ratios in speed.toml
//! cargo bench -p conv-core --bench speed -- --renew   # writes the measured ratios there
//! ```
//!
//! Each case is compared with two references, in the same run:
//!
//! - psfield's own convolution with one PSF, which shows work that has become more,
//! - a plain 2-D transform by realfft and rustfft, which also shows a transform of psfield that has become
//!   slower.
//!
//! The speed of the machine cancels in these ratios. Cases and references take turns on one thread. Their
//! times are times of the processor, where the system tells them, so other programs do not count. The
//! shortest time counts. A case above its limit is measured again, for longer, before the check fails. On
//! x86-64, psfield uses AVX2 here, because rustfft knows no wider vectors.

mod common;
#[path = "common/rows_then_columns.rs"]
mod rows_then_columns;

use std::error::Error;
use std::fmt::Write;
use std::process::{Command, ExitCode};
use std::slice::from_ref;
use std::sync::Arc;
use std::time::Duration;

use conv_core::{
    ConvReal, Engine, ExtendedSources, InstructionSet, Light, Operation, Paths, Plan, PlanOptions, SourcePlan,
};
use ndarray::{Array2, Array3};
use psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, Image, NoProgress, Normalisation, PointSource,
    Position, PsfBasis, PsfModel, SersicProfile, SersicSource, StampGrid,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rows_then_columns::RowsThenColumns;
use sersic::SersicLight;

/// Pixels along each side of the frame.
const FRAME: usize = 512;
/// A case may take this many times its ratio in `speed.toml`.
const MARGIN: f64 = 1.5;
/// The convolution with one PSF may take this many times its ratio to the transform: its tile is the whole frame,
/// which the second-level cache of some machines does not hold. There it takes 7 transforms.
const MARGIN_OF_LARGE_TILE: f64 = 3.0;
/// The time of a measurement, and the number of turns that it has at least.
const MEASUREMENT: (Duration, usize) = (Duration::from_secs(10), 5);
/// A second measurement, which decides.
const LONGER: (Duration, usize) = (Duration::from_secs(30), 10);
/// The least time of a turn. It has at least two calls, because the first one fills the caches.
const TURN: Duration = Duration::from_millis(6);
const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/speed.toml");
/// The keys in [`FILE`], which are also the names of the references.
const REFERENCES: [&str; 2] = ["transform", "one-psf"];

/// Work, and the shortest time that it took.
struct Case {
    name: &'static str,
    work: Box<dyn FnMut()>,
    shortest: Duration,
}

impl Case {
    fn new(name: &'static str, work: impl FnMut() + 'static) -> Self {
        Self {
            name,
            work: Box::new(work),
            shortest: Duration::MAX,
        }
    }

    fn turn(&mut self) {
        let (start, mut calls) = (now(), 0);
        while calls < 2 || since(start) < TURN {
            let before = now();
            (self.work)();
            self.shortest = self.shortest.min(since(before));
            calls += 1;
        }
    }
}

/// The time that the processor spent on this thread.
#[cfg(target_os = "linux")]
fn now() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec as u32)
}

/// The time since the first call.
#[cfg(not(target_os = "linux"))]
fn now() -> Duration {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed()
}

fn since(start: Duration) -> Duration {
    now().saturating_sub(start)
}

/// No component at all: the mean stamp everywhere.
#[derive(Debug)]
struct OnePsf;

impl CoefficientField for OnePsf {
    fn component_count(&self) -> usize {
        0
    }
    fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
        Ok(())
    }
}

/// The mean stamp of a model as its only PSF.
fn one_psf_of(model: &PsfModel) -> PsfModel {
    let (ny, nx) = model.grid().dim();
    let grid = StampGrid::new(nx, ny).expect("a valid grid");
    let basis = PsfBasis::new(Some(model.stamp(0).to_owned()), Array3::zeros((0, ny, nx)), grid);
    let basis = basis.expect("a valid basis");
    PsfModel::new(&basis, Arc::new(OnePsf), Normalisation::Keep, None).expect("a valid model")
}

fn shape() -> FrameShape {
    FrameShape::new(FRAME, FRAME).expect("a valid shape")
}

fn transforms() -> PlanOptions {
    PlanOptions::default().with_paths(Paths::Transforms)
}

fn plan<T: ConvReal>(model: &PsfModel, options: PlanOptions) -> Plan<T> {
    Plan::new(model, shape(), shape().region(), options).expect("a plan")
}

/// Convolves an image of which one of `every` pixels is lit.
fn image<T: ConvReal>(model: &PsfModel, options: PlanOptions, every: usize) -> impl FnMut() + use<T> {
    let engine = Engine::new(plan::<T>(model, options));
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let light = Array2::from_shape_simple_fn((FRAME, FRAME), || {
        let shines = rng.random_range(0..every) == 0;
        T::nearest(if shines { rng.random_range(1.0..2.0) } else { 0.0 })
    });
    let light = Image::new(light).expect("finite light");
    let mut image = engine.plan().zeros();
    move || {
        let (light, image) = (light.view(), vec![image.view_mut()]);
        engine
            .execute(Operation::Convolve, from_ref(&light), image, &NoProgress)
            .expect("an image");
    }
}

/// Sources of flux 1 at random positions.
fn points(count: usize) -> Vec<PointSource> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut coordinate = || rng.random_range(0.0..(FRAME - 1) as f64);
    let mut point = || PointSource::new(Position::new(coordinate(), coordinate())?, 1.0);
    (0..count).map(|_| point().expect("a source")).collect()
}

fn source_plan(model: &PsfModel) -> SourcePlan<f32> {
    SourcePlan::new(model, PlanOptions::default(), None).expect("a plan")
}

fn draw_stars(plan: &SourcePlan<f32>, stars: &[PointSource], image: &mut Array2<f32>) {
    image.fill(0.0);
    let region = shape().region();
    plan.draw_stars_into(stars, region, region, image.view_mut(), &NoProgress)
        .expect("an image");
}

fn stars(model: &PsfModel, count: usize) -> impl FnMut() + use<> {
    let (plan, stars, mut image) = (source_plan(model), points(count), Array2::zeros((FRAME, FRAME)));
    move || draw_stars(&plan, &stars, &mut image)
}

fn galaxies(model: &PsfModel, count: usize) -> impl FnMut() + use<> {
    let (plan, points, mut image) = (source_plan(model), points(count), Array2::zeros((FRAME, FRAME)));
    let mut lights: Vec<Light> = Vec::new();
    for (i, point) in points.iter().enumerate() {
        let index = if i % 3 == 0 { 4.0 } else { 1.0 };
        let (axis_ratio, angle) = (0.4 + 0.1 * (i % 6) as f64, 10.0 * (i % 18) as f64);
        let profile = SersicProfile::new(1.0 + 0.5 * (i % 5) as f64, index, axis_ratio, angle);
        let galaxy = SersicSource::new(point.position(), 1.0, profile.expect("a profile"));
        lights.push(Arc::new(SersicLight::new(&galaxy.expect("a galaxy"))));
    }
    move || {
        image.fill(0.0);
        let region = shape().region();
        let sources = ExtendedSources {
            points: &points,
            light: &|i| lights[i].clone(),
        };
        plan.draw_extended_into(sources, region, region, image.view_mut(), &NoProgress)
            .expect("an image");
    }
}

/// Plans and draws few stars, one of them in nearly every block of the frame.
fn plan_for_sources(model: &PsfModel) -> impl FnMut() + use<> {
    let (model, stars, mut image) = (model.clone(), points(50), Array2::zeros((FRAME, FRAME)));
    move || draw_stars(&source_plan(&model), &stars, &mut image)
}

/// All cases. The first are the [`REFERENCES`].
fn cases() -> Vec<Case> {
    let model = common::model(FRAME);
    let mut plain = RowsThenColumns::<f32>::new(FRAME, FRAME);
    let output = transforms().with_anchor(Anchor::Output);
    let planned = model.clone();
    vec![
        Case::new(REFERENCES[0], move || plain.forward()),
        Case::new(REFERENCES[1], image::<f32>(&one_psf_of(&model), transforms(), 1)),
        Case::new("image", image::<f32>(&model, transforms(), 1)),
        Case::new("image-f64", image::<f64>(&model, transforms(), 1)),
        Case::new("image-output-anchored", image::<f32>(&model, output, 1)),
        Case::new(
            "image-few-lit-pixels",
            image::<f32>(&model, PlanOptions::default(), 1000),
        ),
        Case::new("stars", stars(&model, 300)),
        Case::new("stars-crowded", stars(&model, 30_000)),
        Case::new("galaxies", galaxies(&model, 100)),
        Case::new("plan", move || drop(plan::<f32>(&planned, transforms()))),
        Case::new("plan-for-sources", plan_for_sources(&model)),
    ]
}

fn measure(cases: &mut [Case], (time, least_turns): (Duration, usize)) {
    let (start, mut turns) = (now(), 0);
    while turns < least_turns || since(start) < time {
        cases.iter_mut().for_each(Case::turn);
        turns += 1;
    }
}

/// The ratios of each case to the references. The first reference is not a case.
fn ratios(cases: &[Case]) -> impl Iterator<Item = (&Case, [f64; 2])> {
    let references = [cases[0].shortest, cases[1].shortest];
    let ratios = move |case: &Case| references.map(|reference| case.shortest.div_duration_f64(reference));
    cases.iter().skip(1).map(move |case| (case, ratios(case)))
}

/// The text of [`FILE`].
fn file_of(cases: &[Case]) -> String {
    let mut text = String::from(
        "# Times relative to a plain 2-D transform and to a convolution with one PSF, on one thread with AVX2.\n\
         # This command writes them: cargo bench -p conv-core --bench speed -- --renew\n",
    );
    for (case, [plain, own]) in ratios(cases) {
        let [first, second] = REFERENCES;
        writeln!(
            text,
            "{} = {{ {first} = {plain:.2}, {second} = {own:.2} }}",
            case.name
        )
        .expect("a String takes text");
    }
    text
}

/// Prints all ratios, with the committed ones in parentheses, and describes those above their limits.
fn compare(cases: &[Case]) -> Result<Vec<String>, Box<dyn Error>> {
    let committed: toml::Table = std::fs::read_to_string(FILE)?.parse()?;
    let mut slow = Vec::new();
    println!(
        "{:24}{:>10}{:>20}{:>20}",
        "case", "ms", REFERENCES[0], REFERENCES[1]
    );
    for (case, ratios) in ratios(cases) {
        let name = case.name;
        print!("{name:24}{:>10.3}", case.shortest.as_secs_f64() * 1e3);
        for (reference, measured) in REFERENCES.into_iter().zip(ratios) {
            let entry = committed.get(name).and_then(|entry| entry.get(reference));
            let committed = entry
                .and_then(toml::Value::as_float)
                .ok_or_else(|| format!("{FILE} has no number {name}.{reference}: renew it"))?;
            print!("{:>20}", format!("{measured:.2} ({committed:.2})"));
            let is_of_large_tile = [name, reference] == [REFERENCES[1], REFERENCES[0]];
            let margin = if is_of_large_tile {
                MARGIN_OF_LARGE_TILE
            } else {
                MARGIN
            };
            let limit = margin * committed;
            if measured > limit {
                slow.push(format!(
                    "{name}: {measured:.2} times {reference}, committed {committed:.2}, limit {limit:.2}"
                ));
            }
        }
        println!();
    }
    Ok(slow)
}

fn check() -> Result<bool, Box<dyn Error>> {
    let mut cases = cases();
    measure(&mut cases, MEASUREMENT);
    if std::env::args().any(|argument| argument == "--renew") {
        measure(&mut cases, LONGER);
        std::fs::write(FILE, file_of(&cases))?;
        return Ok(true);
    }
    let mut slow = compare(&cases)?;
    if !slow.is_empty() {
        println!("Above their limits, measured again:\n{}", slow.join("\n"));
        measure(&mut cases, LONGER);
        slow = compare(&cases)?;
    }
    if !slow.is_empty() {
        eprintln!(
            "Too slow:\n{}\nA hot loop may no longer be inlined (CONTRIBUTING.md, \"Fast code\"). If the change is \
             meant, renew {FILE}:\ncargo bench -p conv-core --bench speed -- --renew",
            slow.join("\n")
        );
    }
    Ok(slow.is_empty())
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    if InstructionSet::used() != InstructionSet::Avx2 {
        if std::env::var_os(InstructionSet::VARIABLE).is_some() || !cfg!(target_arch = "x86_64") {
            println!("NOT CHECKED: the ratios in speed.toml are for AVX2");
            return Ok(ExitCode::SUCCESS);
        }
        // The variable is read once per process.
        let mut again = Command::new(std::env::current_exe()?);
        again
            .args(std::env::args_os().skip(1))
            .env(InstructionSet::VARIABLE, "avx2");
        return Ok(if again.status()?.success() {
            ExitCode::SUCCESS
        } else {
            ExitCode::FAILURE
        });
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let fast = pool.install(|| check().map_err(|error| error.to_string()))?;
    Ok(if fast {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
