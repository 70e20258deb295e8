//! The device that executes a plan, the reason for the choice, and the time of an execution.

use conv_core::{ConvReal, Engine};
use serde::Serialize;

use crate::readable::readable;

/// The device that executes a plan. Prints as a phrase, such as `on the CPU: there is no GPU`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "on")]
#[non_exhaustive]
pub enum Placement {
    /// On a GPU.
    Gpu {
        /// Its name, kind and backend.
        adapter: String,
        /// Predicted seconds of an execution, on the GPU and on the processor. None if the caller
        /// asked for the GPU.
        predicted_seconds: Option<PredictedSeconds>,
    },
    /// On the processor.
    Cpu {
        /// The reason.
        reason: CpuReason,
    },
}

/// Predicted seconds of an execution if every pixel is lit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PredictedSeconds {
    /// On the GPU.
    pub gpu: f64,
    /// On the processor, with all threads of rayon's current pool.
    pub cpu: f64,
}

/// The reason why a plan is executed on the processor.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
#[non_exhaustive]
pub enum CpuReason {
    /// The caller asked for the processor.
    Asked,
    /// The method makes no plan, and GPUs only execute plans.
    Method,
    /// The scene holds only stars and galaxies, which are drawn on the processor.
    Stars,
    /// The plan is for several layers of light, such as spectra, which only the processor convolves together.
    Spectra,
    /// The plan is in a precision that GPUs do not compute in.
    Precision {
        /// The precision of the plan.
        precision: &'static str,
    },
    /// The work is predicted to take less time than opening a GPU.
    Small {
        /// Predicted seconds on the processor.
        cpu_seconds: f64,
    },
    /// The machine has no GPU, and no adapter that simulates one.
    NoGpu,
    /// The adapter is software: it runs shaders on the processor.
    Software {
        /// Its name, kind and backend.
        adapter: String,
    },
    /// The GPU cannot execute this plan.
    Unsuited {
        /// Its name, kind and backend.
        adapter: String,
    },
    /// The GPU is predicted to be no faster.
    Slower {
        /// Its name, kind and backend.
        adapter: String,
        /// The predictions.
        predicted_seconds: PredictedSeconds,
    },
    /// The GPU could not be used.
    Failed {
        /// The message of the error.
        error: String,
    },
    /// This build has no GPU support: its feature `gpu` is off.
    NotBuilt,
}

impl Placement {
    /// Returns the placement on the processor for the given reason.
    pub fn cpu(reason: CpuReason) -> Self {
        Self::Cpu { reason }
    }

    /// Name, kind and backend of the GPU. None on the processor.
    pub fn adapter(&self) -> Option<&str> {
        match self {
            Self::Gpu { adapter, .. } => Some(adapter),
            Self::Cpu { .. } => None,
        }
    }

    /// Returns whether the plan is on the processor because a GPU could not be used
    /// ([`CpuReason::Failed`]).
    pub fn is_failure(&self) -> bool {
        matches!(
            self,
            Self::Cpu {
                reason: CpuReason::Failed { .. }
            }
        )
    }
}

impl std::fmt::Display for Placement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Gpu {
                adapter,
                predicted_seconds: None,
            } => write!(f, "on {adapter}"),
            Self::Gpu {
                adapter,
                predicted_seconds: Some(PredictedSeconds { gpu, cpu }),
            } => {
                let (gpu, cpu) = (seconds(*gpu), seconds(*cpu));
                write!(f, "on {adapter}: predicted {gpu} there, {cpu} on the CPU")
            }
            Self::Cpu { reason } => write!(f, "on the CPU: {reason}"),
        }
    }
}

impl std::fmt::Display for CpuReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Asked => write!(f, "as asked"),
            Self::Method => write!(f, "this method cannot run on a GPU"),
            Self::Stars => write!(f, "stars and galaxies are drawn there"),
            Self::Spectra => write!(
                f,
                "images of several layers, such as spectra, are convolved there"
            ),
            Self::Precision { precision } => write!(f, "GPUs compute in f32, this plan is in {precision}"),
            Self::Small { cpu_seconds } => {
                let cpu = seconds(*cpu_seconds);
                write!(f, "predicted {cpu}, less than it takes to open a GPU")
            }
            Self::NoGpu => write!(f, "there is no GPU"),
            Self::Software { adapter } => write!(f, "there is no GPU, only {adapter}"),
            Self::Unsuited { adapter } => write!(f, "{adapter} cannot execute this plan"),
            Self::Slower {
                adapter,
                predicted_seconds: PredictedSeconds { gpu, cpu },
            } => {
                let (gpu, cpu) = (seconds(*gpu), seconds(*cpu));
                write!(f, "predicted {cpu} there, {gpu} on {adapter}")
            }
            Self::Failed { error } => write!(f, "the GPU cannot be used: {error}"),
            Self::NotBuilt => write!(f, "psfield was built without GPU support"),
        }
    }
}

/// Formats predicted seconds. Two digits are enough for a prediction.
fn seconds(seconds: f64) -> String {
    format!("{} s", readable(seconds, 2))
}

/// Times of the parts of an execution on a GPU, in seconds. The work of the host overlaps with the
/// other parts, so the sum of the parts may exceed the total.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GpuSeconds {
    /// Time of the shaders. None if the adapter has no clock that can be read.
    pub kernels: Option<f64>,
    /// Time of the copies to the GPU and from it. None if the adapter has no clock that can be
    /// read.
    pub transfers: Option<f64>,
    /// Time in which the processor worked during the execution.
    pub host: f64,
    /// Time from the light in the host's memory to the image in the host's memory.
    pub total: f64,
    /// Bytes copied to the GPU, and from it.
    pub bytes: [u64; 2],
    /// Bytes that the plan has to move if every pixel is lit: over the bus, and through the GPU's
    /// memory. Divided by the hardware's bandwidths, they are lower bounds on `transfers` and
    /// `kernels`.
    pub least_bytes: [u64; 2],
}

impl GpuSeconds {
    /// Times of the last execution of an engine. None if it runs on the processor.
    #[cfg(feature = "gpu")]
    pub(crate) fn of_last<T: ConvReal>(engine: &Engine<T>) -> Option<Self> {
        let times = engine.gpu_times()?;
        let work = engine.plan().gpu_work();
        Some(Self {
            kernels: times.kernels.map(|time| time.as_secs_f64()),
            transfers: times.transfers.map(|time| time.as_secs_f64()),
            host: times.host.as_secs_f64(),
            total: times.total.as_secs_f64(),
            bytes: times.bytes.into(),
            least_bytes: [work.bus_bytes, work.memory_bytes],
        })
    }

    /// Times of the last execution of an engine. None if it runs on the processor.
    #[cfg(not(feature = "gpu"))]
    pub(crate) fn of_last<T: ConvReal>(_engine: &Engine<T>) -> Option<Self> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placements_read_as_sentences() {
        let adapter = "NVIDIA H100 (discrete GPU, vulkan)".to_owned();
        let asked = Placement::Gpu {
            adapter: adapter.clone(),
            predicted_seconds: None,
        };
        assert_eq!(asked.to_string(), "on NVIDIA H100 (discrete GPU, vulkan)");
        assert_eq!(asked.adapter(), Some(adapter.as_str()));
        let slower = Placement::cpu(CpuReason::Slower {
            adapter,
            predicted_seconds: PredictedSeconds { gpu: 8.0, cpu: 3.1 },
        });
        assert_eq!(
            slower.to_string(),
            "on the CPU: predicted 3.1 s there, 8 s on NVIDIA H100 (discrete GPU, vulkan)"
        );
        assert_eq!((slower.adapter(), slower.is_failure()), (None, false));
        let json = serde_json::to_value(&slower).unwrap();
        assert_eq!(json["on"], "cpu");
        assert_eq!(json["reason"]["kind"], "slower");
        assert_eq!(json["reason"]["predicted_seconds"]["cpu"], 3.1);
    }
}
