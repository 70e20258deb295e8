//! What a benchmark does when nothing is said.

use std::num::NonZeroUsize;

use psfield::bench::{BenchOptions, Contender};
use serde::Serialize;

use super::{BenchArgs, MethodName};

/// The lists and numbers in force: the arguments, else those of `--quick`, else the defaults.
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
    pub(super) repeat: usize,
    pub(super) pixels: usize,
    pub(super) seed: u64,
}

impl Settings {
    pub(super) fn of(args: &BenchArgs) -> Self {
        let quick = args.quick;
        let sizes: &[usize] = if quick { &[256] } else { &[512, 1024, 2048] };
        let grids: &[usize] = if quick { &[5] } else { &[9, 33] };
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
            methods: args.methods.clone().unwrap_or_else(|| MethodName::ALL.to_vec()),
            tolerances: args.tolerances.clone().unwrap_or_else(|| tolerances.to_vec()),
            patches: numbers(&args.patches, patches),
            ranks: numbers(&args.ranks, ranks),
            repeat: args.repeat.map_or(repeat, |n| usize::from(n.get())),
            pixels: args.pixels.map_or(pixels, |n| n as usize),
            seed: args.seed,
        }
    }

    /// The contenders for a model of some rank, method by method; no setting twice.
    pub(super) fn contenders(&self, rank: usize) -> Vec<Contender> {
        let mut all = Vec::new();
        let mut add = |contender| {
            if !all.contains(&contender) {
                all.push(contender);
            }
        };
        for method in &self.methods {
            match method {
                MethodName::Single => add(Contender::Single),
                MethodName::Lowrank => {
                    for &tolerance in &self.tolerances {
                        add(Contender::LowRank { tolerance });
                    }
                }
                MethodName::Auto => {
                    for &tolerance in &self.tolerances {
                        add(Contender::Auto { tolerance });
                    }
                }
                MethodName::Patch => {
                    for &size in &self.patches {
                        add(Contender::Patch { size });
                    }
                }
                MethodName::Basis => {
                    for &asked in &self.ranks {
                        // A rank beyond the model's is the model's.
                        add(Contender::Basis {
                            rank: asked.min(rank),
                        });
                    }
                }
                MethodName::Direct => add(Contender::Direct),
            }
        }
        all
    }
}
