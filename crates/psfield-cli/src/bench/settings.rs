//! The settings of a benchmark, and its device.

use std::num::NonZeroUsize;

use clap::ValueEnum;
use psf_types::ToleranceOn;
use psfield::Device;
use psfield_lab::bench::{BenchOptions, Contender};
use serde::Serialize;

use crate::bench::{BenchArgs, MethodName};
use crate::devices::device_parser;

/// The settings in force: the arguments, or else the values of `--quick`, or else the defaults.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Settings {
    /// Pixels along each side of the frame.
    pub(super) sizes: Vec<usize>,
    /// Samples along each side of the field.
    pub(super) grids: Vec<usize>,
    pub(super) methods: Vec<MethodName>,
    pub(super) tolerances: Vec<f64>,
    pub(super) patches: Vec<usize>,
    pub(super) ranks: Vec<usize>,
    pub(super) tolerance_on: ToleranceOn,
    pub(super) repeat: usize,
    pub(super) pixels: usize,
    pub(super) seed: u64,
}

impl Settings {
    pub(super) fn of(args: &BenchArgs) -> Self {
        let (quick, real) = (args.quick, args.real.is_some());
        let sizes: &[usize] = match (quick, real) {
            (true, _) => &[256],
            (false, true) => &[1024, 4096, 9216],
            (false, false) => &[512, 1024, 2048],
        };
        let grids: &[usize] = match (quick, real) {
            (true, _) => &[5],
            (false, true) => &[71],
            (false, false) => &[9, 33],
        };
        let patches: &[usize] = if quick { &[64] } else { &[32, 64, 128, 256] };
        let ranks: &[usize] = if quick { &[10] } else { &[10, 30, 100] };
        let tolerances: &[f64] = if quick {
            &[1e-2, 1e-4]
        } else {
            &[1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 0.0]
        };
        let (repeat, pixels) = if quick {
            (1, 100)
        } else {
            (BenchOptions::DEFAULT_REPEAT, BenchOptions::DEFAULT_PIXELS)
        };
        let numbers = |given: &Option<Vec<NonZeroUsize>>, default: &[usize]| {
            given.as_ref().map_or_else(
                || default.to_vec(),
                |given| given.iter().map(|n| n.get()).collect(),
            )
        };
        Self {
            sizes: numbers(&args.sizes, sizes),
            grids: numbers(&args.grids, grids),
            methods: args
                .methods
                .clone()
                .unwrap_or_else(|| MethodName::value_variants().to_vec()),
            tolerances: args.tolerances.clone().unwrap_or_else(|| tolerances.to_vec()),
            patches: numbers(&args.patches, patches),
            ranks: numbers(&args.ranks, ranks),
            tolerance_on: args.tolerance_on.unwrap_or(if real {
                ToleranceOn::L2
            } else {
                ToleranceOn::default()
            }),
            repeat: args.repeat.map_or(repeat, |n| usize::from(n.get())),
            pixels: args.pixels.map_or(pixels, |n| n as usize),
            seed: args.seed,
        }
    }

    /// Returns the contenders (each a method with its setting) for a model of this rank, method by
    /// method, without duplicates.
    pub(super) fn contenders(&self, rank: usize) -> Vec<Contender> {
        let mut all = Vec::new();
        for method in &self.methods {
            let tolerances = self.tolerances.iter();
            let of_method: Vec<Contender> = match method {
                MethodName::Single => vec![Contender::Single],
                MethodName::Lowrank => tolerances
                    .map(|&tolerance| Contender::LowRank { tolerance })
                    .collect(),
                MethodName::Auto => tolerances
                    .map(|&tolerance| Contender::Auto { tolerance })
                    .collect(),
                MethodName::Patch => self
                    .patches
                    .iter()
                    .map(|&size| Contender::Patch { size })
                    .collect(),
                // The rank of a truncated model is at most the rank of the model.
                MethodName::Basis => self
                    .ranks
                    .iter()
                    .map(|&k| Contender::Basis { rank: k.min(rank) })
                    .collect(),
                MethodName::Direct => vec![Contender::Direct],
            };
            for contender in of_method {
                if !all.contains(&contender) {
                    all.push(contender);
                }
            }
        }
        all
    }
}

/// The device of the methods lowrank and auto. It is never chosen automatically, because times are
/// compared on a known device.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Device")]
pub(super) struct BenchDeviceArgs {
    /// Device of lowrank and auto (gpu computes in f32; the other methods run on the CPU)
    #[arg(long, default_value = "cpu", value_parser = device_parser(["cpu", "gpu"]))]
    pub(super) device: Device,
    /// GPU to use: a part of its name, or its backend [default: the first that psfield devices
    /// lists]
    #[arg(long, value_name = "NAME", hide_short_help = true)]
    pub(super) gpu_adapter: Option<String>,
}

impl BenchDeviceArgs {
    /// Returns an error message if options do not fit together. `single` is true for precision f32.
    pub(super) fn misused(&self, single: bool) -> Option<&'static str> {
        match self.device {
            Device::Cpu if self.gpu_adapter.is_some() => Some("--gpu-adapter applies only to --device gpu"),
            Device::Gpu if !single => Some("--device gpu computes in f32: leave --precision f64 out"),
            _ => None,
        }
    }
}
