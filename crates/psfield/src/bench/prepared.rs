//! Contenders ready to run.

use std::time::Instant;

use conv_core::{
    BasisConvolution, ConvReal, ConvolutionMethod, Direct, PatchConvolution, Paths, Plan, PlanOptions,
};
use ndarray::Array2;
use psf_types::{NoProgress, Position, PsfModel, Scene};

use super::models::constant;
use super::{BenchCase, BenchOptions, Contender};
use crate::{Device, DeviceOptions, GpuSeconds, Gpus, PsfieldError, model_of};

/// A contender with all that does not depend on the light.
#[derive(Debug)]
pub(super) struct Prepared<T: ConvReal> {
    work: Work<T>,
    /// Seconds that the plan took.
    pub(super) seconds_plan: Option<f64>,
    /// Components that it convolves with.
    pub(super) rank: usize,
    pub(super) modes: Option<f64>,
    pub(super) tile: Option<[usize; 2]>,
    pub(super) transform: Option<[usize; 2]>,
    /// The GPU that it runs on.
    pub(super) gpu: Option<String>,
}

/// How long a run took.
#[derive(Debug, Clone, Copy)]
pub(super) struct RunTime {
    pub(super) seconds: f64,
    /// In parts, on a GPU.
    pub(super) gpu: Option<GpuSeconds>,
}

#[derive(Debug)]
enum Work<T: ConvReal> {
    Planned(Box<Plan<T>>),
    Whole(Box<dyn ConvolutionMethod<T>>, Box<PsfModel>),
}

impl<T: ConvReal> Prepared<T> {
    pub(super) fn new(
        contender: Contender,
        case: &BenchCase<T>,
        model: &PsfModel,
        options: &BenchOptions,
        (gpus, device): (&mut Gpus, &DeviceOptions),
    ) -> Result<Self, PsfieldError> {
        let anchor = options.anchor;
        match contender {
            Contender::Single => {
                let frame = case.scene().frame().shape();
                let middle = Position::new((frame.nx() - 1) as f64 / 2.0, (frame.ny() - 1) as f64 / 2.0)?;
                let one = constant(model, middle)?;
                let exact = PlanOptions::new(0.0)?.with_paths(Paths::Transforms);
                let cpu = DeviceOptions::new(Device::Cpu);
                Self::planned(&one, case.scene(), exact.with_anchor(anchor), (gpus, &cpu))
            }
            Contender::LowRank { tolerance } => {
                let options = PlanOptions::new(tolerance)?.with_paths(Paths::Transforms);
                Self::planned(model, case.scene(), options.with_anchor(anchor), (gpus, device))
            }
            Contender::Auto { tolerance } => {
                let options = PlanOptions::new(tolerance)?.with_anchor(anchor);
                Self::planned(model, case.scene(), options, (gpus, device))
            }
            Contender::Patch { size } => {
                let method = PatchConvolution::new(size, anchor)?;
                Ok(Self {
                    modes: Some(1.0),
                    tile: Some([size, size]),
                    ..Self::whole(Box::new(method), model.clone())
                })
            }
            Contender::Basis { rank } => {
                let model = model_of(case.record().truncated(rank)?)?;
                Ok(Self {
                    modes: Some(model.stamp_count() as f64),
                    ..Self::whole(Box::new(BasisConvolution::new(anchor)), model)
                })
            }
            Contender::Direct => Ok(Self::whole(Box::new(Direct::new(anchor)), model.clone())),
        }
    }

    fn planned(
        model: &PsfModel,
        scene: &Scene<T>,
        options: PlanOptions,
        (gpus, device): (&mut Gpus, &DeviceOptions),
    ) -> Result<Self, PsfieldError> {
        let clock = Instant::now();
        let mut plan = Plan::for_scene(model, scene, options)?;
        let placement = gpus.place_plan(&mut plan, device, rayon::current_num_threads())?;
        let seconds = clock.elapsed().as_secs_f64();
        let summary = plan.summary();
        Ok(Self {
            seconds_plan: Some(seconds),
            rank: model.rank(),
            modes: Some(summary.mean_modes()),
            tile: Some(summary.tile.into()),
            transform: Some(summary.transform.into()),
            gpu: placement.adapter().map(str::to_owned),
            work: Work::Planned(Box::new(plan)),
        })
    }

    fn whole(method: Box<dyn ConvolutionMethod<T>>, model: PsfModel) -> Self {
        Self {
            seconds_plan: None,
            rank: model.rank(),
            modes: None,
            tile: None,
            transform: None,
            gpu: None,
            work: Work::Whole(method, Box::new(model)),
        }
    }

    /// Makes the image and returns how long that took. A plan reuses the image's memory, which is cleared off the clock; other methods
    /// bring their own.
    pub(super) fn run(&self, scene: &Scene<T>, image: &mut Array2<T>) -> Result<RunTime, PsfieldError> {
        match &self.work {
            Work::Planned(plan) => {
                image.fill(T::zero());
                let clock = Instant::now();
                plan.add_to(scene, image, &NoProgress)?;
                Ok(RunTime {
                    seconds: clock.elapsed().as_secs_f64(),
                    gpu: GpuSeconds::of_last(plan),
                })
            }
            Work::Whole(method, model) => {
                let clock = Instant::now();
                let made = method.convolve(model, scene)?;
                let seconds = clock.elapsed().as_secs_f64();
                *image = made.into_pixels();
                Ok(RunTime { seconds, gpu: None })
            }
        }
    }
}
