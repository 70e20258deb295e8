//! The methods that a benchmark measures, and a method that is planned and ready to run.

use std::time::Instant;

use conv_core::{ConvReal, PlanSummary};
use ndarray::Array2;
use psf_types::{FrameShape, NoProgress, Position, PsfModelRecord};
use psfield::device::GpuSeconds;
use psfield::fit::model_of;
use psfield::{Device, Method, Psf, PsfieldError, Scene, SimulateOptions, Simulator};

use crate::bench::case::constant;
use crate::bench::{BenchCase, BenchOptions, BenchRow};

/// A method with its setting.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Contender {
    /// One PSF for the whole frame: the PSF at the middle of the frame. The convolution is a
    /// [`Plan`](conv_core::Plan) of a model that has this PSF everywhere. This is the fastest
    /// convolution with one PSF in psfield.
    Single,
    /// The fast engine ([`Engine`](conv_core::Engine)) with Fourier transforms for all tiles that
    /// have light ([`Paths::Transforms`](conv_core::Paths::Transforms)).
    LowRank {
        /// The tolerance ([`PlanOptions::new`](conv_core::PlanOptions::new)).
        tolerance: f64,
    },
    /// The fast engine with the cheapest computation for each tile
    /// ([`Paths::Cheapest`](conv_core::Paths::Cheapest)).
    Auto {
        /// The tolerance ([`PlanOptions::new`](conv_core::PlanOptions::new)).
        tolerance: f64,
    },
    /// One PSF for each square patch ([`PatchConvolution`](conv_core::PatchConvolution)).
    Patch {
        /// Pixels along each side of a patch.
        size: usize,
    },
    /// One convolution of the whole image per component
    /// ([`BasisConvolution`](conv_core::BasisConvolution)).
    Basis {
        /// The largest number of components kept. The measured error includes the error of leaving
        /// out the others.
        rank: usize,
    },
    /// The direct sum over all pixels with light, in double precision
    /// ([`Direct`](conv_core::Direct)).
    Direct,
}

impl Contender {
    /// The name of the method.
    pub fn method(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::LowRank { .. } => "lowrank",
            Self::Auto { .. } => "auto",
            Self::Patch { .. } => "patch",
            Self::Basis { .. } => "basis",
            Self::Direct => "direct",
        }
    }

    /// The setting, such as `tolerance=1e-3`, `patch=64` or `rank=30`. None for the methods without
    /// a setting.
    pub fn setting(self) -> Option<String> {
        match self {
            Self::Single | Self::Direct => None,
            Self::LowRank { tolerance } | Self::Auto { tolerance } => Some(if tolerance == 0.0 {
                "tolerance=0".to_owned()
            } else {
                format!("tolerance={tolerance:e}")
            }),
            Self::Patch { size } => Some(format!("patch={size}")),
            Self::Basis { rank } => Some(format!("rank={rank}")),
        }
    }

    /// The tolerance. None for the methods that take no tolerance.
    pub fn tolerance(self) -> Option<f64> {
        match self {
            Self::LowRank { tolerance } | Self::Auto { tolerance } => Some(tolerance),
            _ => None,
        }
    }

    /// The settings of this contender, except for the method.
    pub(super) fn settings(self, options: &BenchOptions) -> SimulateOptions {
        let mut settings = SimulateOptions {
            tolerance: self.tolerance().unwrap_or(0.0),
            anchor: options.anchor,
            tolerance_on: options.tolerance_on,
            device: Device::Cpu,
            ..SimulateOptions::default()
        };
        if self.tolerance().is_some() {
            settings.device = options.device;
            settings.gpu_adapter.clone_from(&options.gpu_adapter);
            settings.gpu_memory = options.gpu_memory;
        }
        settings
    }

    /// Returns the simulator of this contender for frames of one shape. `record` is the model of
    /// `psf`.
    pub(super) fn simulator<T: ConvReal>(
        self,
        record: &PsfModelRecord,
        psf: &Psf,
        frame: FrameShape,
        options: &BenchOptions,
    ) -> Result<Simulator<T>, PsfieldError> {
        let (psf, method) = match self {
            Self::Single => {
                let middle = Position::new((frame.nx() - 1) as f64 / 2.0, (frame.ny() - 1) as f64 / 2.0)?;
                (Psf::from(constant(psf.model()?, middle)?), Method::LowRank)
            }
            Self::LowRank { .. } => (psf.clone(), Method::LowRank),
            Self::Auto { .. } => (psf.clone(), Method::Auto),
            Self::Patch { size } => (psf.clone(), Method::Patch(size)),
            Self::Basis { rank } => {
                let truncated = model_of(record.truncated(rank)?)?;
                (Psf::from(truncated), Method::Basis)
            }
            Self::Direct => (psf.clone(), Method::Direct),
        };
        let settings = SimulateOptions {
            method,
            ..self.settings(options)
        };
        psf.simulator((frame.ny(), frame.nx())).options(settings).build()
    }
}

/// A contender that is planned and ready to run.
#[derive(Debug)]
pub(super) struct PlannedContender<T: ConvReal> {
    pub(super) simulator: Simulator<T>,
    /// The results. The run times and the error are 0 or None until they are measured.
    pub(super) row: BenchRow,
}

/// The time of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct RunTime {
    pub(super) seconds: f64,
    /// The times of the steps of this run on a GPU. None if it ran on the processor.
    pub(super) gpu: Option<GpuSeconds>,
}

impl<T: ConvReal> PlannedContender<T> {
    pub(super) fn new(
        contender: Contender,
        case: &BenchCase<T>,
        psf: &Psf,
        options: &BenchOptions,
    ) -> Result<Self, PsfieldError> {
        let frame = case.scene.shape();
        let simulator = contender.simulator(&case.record, psf, frame, options)?;
        let made = simulator.prepare(&Scene::from(&case.scene), &NoProgress)?;
        let plan = made.plan.as_ref();
        let (modes, tile) = match contender {
            Contender::Patch { size } => (Some(1.0), Some([size, size])),
            Contender::Basis { .. } => (Some(made.model.stamp_count() as f64), None),
            _ => (
                plan.map(PlanSummary::mean_modes),
                plan.map(|plan| plan.tile.into()),
            ),
        };
        let row = BenchRow {
            method: contender.method(),
            setting: contender.setting(),
            tolerance: contender.tolerance(),
            size: [frame.nx(), frame.ny()],
            samples: case.record.coefficients().positions().len(),
            rank: made.model.rank(),
            precision: T::NAME,
            anchor: options.anchor,
            seconds_plan: plan.is_some().then_some(made.plan_seconds),
            seconds: 0.0,
            seconds_median: 0.0,
            ratio_to_single: 0.0,
            relative_l2: None,
            modes,
            tile,
            transform: plan.map(|plan| plan.transform.into()),
            threads: rayon::current_num_threads(),
            peak_memory_bytes: None,
            gpu: made.placement.adapter().map(str::to_owned),
            gpu_seconds: None,
        };
        Ok(Self { simulator, row })
    }
}

/// Clears `image`, then simulates the image in this array. The returned time is the time of the
/// simulation alone.
pub(super) fn timed_run<T: ConvReal>(
    simulator: &Simulator<T>,
    scene: &Scene<'_, T>,
    image: &mut Array2<T>,
) -> Result<RunTime, PsfieldError> {
    image.fill(T::zero());
    let clock = Instant::now();
    simulator.simulate_into(scene, image.view_mut(), &NoProgress)?;
    Ok(RunTime {
        seconds: clock.elapsed().as_secs_f64(),
        gpu: simulator.gpu_seconds(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_name_what_they_set() {
        let text = |contender: Contender| contender.setting().unwrap_or_default();
        assert_eq!(text(Contender::LowRank { tolerance: 1e-3 }), "tolerance=1e-3");
        assert_eq!(text(Contender::Auto { tolerance: 0.0 }), "tolerance=0");
        assert_eq!(text(Contender::Patch { size: 64 }), "patch=64");
        assert_eq!(text(Contender::Basis { rank: 30 }), "rank=30");
        assert_eq!(text(Contender::Direct), "");
    }
}
