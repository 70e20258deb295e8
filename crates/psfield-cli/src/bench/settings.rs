//! The settings of a benchmark, and its device.

use std::num::NonZeroUsize;

use clap::ValueEnum;
use psf_types::ToleranceOn;
use psfield_lab::bench::{BenchOptions, Contender};
use serde::Serialize;

use crate::bench::{BenchArgs, MethodName};

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
        let real = args.real.is_some();
        let quick_or = |quick: usize, other| if args.quick { quick } else { other };
        // The given numbers, or else those of `--quick`, or else those of `--real`, or else the defaults.
        let numbers = |given: &Option<Vec<NonZeroUsize>>,
                       quick: usize,
                       of_real: &[usize],
                       others: &[usize]| {
            match given {
                Some(given) => given.iter().map(|n| n.get()).collect(),
                None if args.quick => vec![quick],
                None if real => of_real.to_vec(),
                None => others.to_vec(),
            }
        };
        let (patches, ranks) = ([32, 64, 128, 256], [10, 30, 100]);
        let tolerances = if args.quick {
            vec![1e-2, 1e-4]
        } else {
            vec![1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 0.0]
        };
        let tolerance_on = if real {
            ToleranceOn::L2
        } else {
            ToleranceOn::default()
        };
        let all = MethodName::value_variants();
        Self {
            sizes: numbers(&args.sizes, 256, &[1024, 4096, 9216], &[512, 1024, 2048]),
            grids: numbers(&args.grids, 5, &[71], &[9, 33]),
            methods: args.methods.clone().unwrap_or_else(|| all.to_vec()),
            tolerances: args.tolerances.clone().unwrap_or(tolerances),
            patches: numbers(&args.patches, 64, &patches, &patches),
            ranks: numbers(&args.ranks, 10, &ranks, &ranks),
            tolerance_on: args.tolerance_on.unwrap_or(tolerance_on),
            repeat: args
                .repeat
                .map_or(quick_or(1, BenchOptions::DEFAULT_REPEAT), |n| n.get().into()),
            pixels: args
                .pixels
                .map_or(quick_or(100, BenchOptions::DEFAULT_PIXELS), |n| n as usize),
            seed: args.seed,
        }
    }

    /// Returns the contenders (each a method with its setting) for a model of this rank, method by
    /// method, without duplicates.
    pub(super) fn contenders(&self, rank: usize) -> Vec<Contender> {
        let tolerances = || self.tolerances.iter().copied();
        let mut all = Vec::new();
        for method in &self.methods {
            let of_method: Vec<Contender> = match method {
                MethodName::Single => vec![Contender::Single],
                MethodName::Lowrank => tolerances()
                    .map(|tolerance| Contender::LowRank { tolerance })
                    .collect(),
                MethodName::Auto => tolerances()
                    .map(|tolerance| Contender::Auto { tolerance })
                    .collect(),
                MethodName::Patch => self
                    .patches
                    .iter()
                    .map(|&size| Contender::Patch { size })
                    .collect(),
                MethodName::Basis => {
                    // The rank of a truncated model is at most the rank of the model.
                    let ranks = self.ranks.iter().map(|&k| k.min(rank));
                    ranks.map(|rank| Contender::Basis { rank }).collect()
                }
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
