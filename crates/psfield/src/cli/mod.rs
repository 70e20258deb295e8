//! The command line: arguments in, files and reports out. All that computes is in the library.

mod batch;
mod bench;
mod catalog_args;
mod compare;
mod context;
mod convert;
mod demo;
mod device_args;
mod devices;
mod evaluate;
mod expose;
mod fit;
mod fit_args;
#[cfg(unix)]
mod interrupts;
mod measure;
mod preview;
mod progress;
mod psf_file_args;
mod report_folder;
mod reproduce;
mod round_trip;
mod sample;
mod simulate;
mod star_args;
mod validate;
mod values;

use anyhow::Context as _;
use clap::{Parser, Subcommand};

use context::Context;
pub(crate) use context::{UsageError, told};

/// Astronomical images with a point spread function that varies over the field.
///
/// Positions are 0-based pixels, an integer is the centre of a pixel. Existing files are kept unless --overwrite is given.
/// Exit status: 0 done, 1 failed, 2 bad usage, 128 and the number of a signal that stopped it (130 after Ctrl-C); outputs are then as they
/// were before.
#[derive(Debug, Parser)]
#[command(name = "psfield", version, max_term_width = 110)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: GlobalArgs,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Common options")]
pub(crate) struct GlobalArgs {
    /// Print one JSON object on standard output in place of text
    #[arg(long, global = true, action = clap::ArgAction::SetTrue, value_parser = bench::JsonTo::of_flag)]
    json: bench::JsonTo,
    /// Print nothing but errors (and --json, if asked for)
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Threads to use; the result does not depend on it [default: one a core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Sample(Box<sample::SampleArgs>),
    Fit(fit::FitCommandArgs),
    Simulate(Box<simulate::SimulateArgs>),
    Batch(batch::BatchArgs),
    Evaluate(evaluate::EvaluateArgs),
    Expose(Box<expose::ExposeArgs>),
    Convert(convert::ConvertArgs),
    Measure(measure::MeasureArgs),
    Compare(compare::CompareArgs),
    Preview(preview::PreviewArgs),
    Bench(bench::BenchArgs),
    Devices(devices::DevicesArgs),
    #[command(name = "roundtrip")]
    RoundTrip(Box<round_trip::RoundTripArgs>),
    Validate(Box<validate::ValidateArgs>),
    Reproduce(reproduce::ReproduceArgs),
}

impl Cli {
    /// The name of the command.
    pub(crate) fn command_name(&self) -> &'static str {
        match self.command {
            Command::Demo(_) => "demo",
            Command::Sample(_) => "sample",
            Command::Fit(_) => "fit",
            Command::Simulate(_) => "simulate",
            Command::Batch(_) => "batch",
            Command::Evaluate(_) => "evaluate",
            Command::Expose(_) => "expose",
            Command::Convert(_) => "convert",
            Command::Measure(_) => "measure",
            Command::Compare(_) => "compare",
            Command::Preview(_) => "preview",
            Command::Bench(_) => "bench",
            Command::Devices(_) => "devices",
            Command::RoundTrip(_) => "roundtrip",
            Command::Validate(_) => "validate",
            Command::Reproduce(_) => "reproduce",
        }
    }

    /// Runs the command.
    pub(crate) fn run(self) -> anyhow::Result<()> {
        #[cfg(unix)]
        interrupts::remove_files_when_told_to_stop().context("cannot watch for signals")?;
        if let Some(threads) = self.global.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(usize::from(threads))
                .build_global()?;
        }
        let context = Context::new(self.global.json.is_output(), self.global.quiet);
        match self.command {
            Command::Demo(args) => args.run(&context),
            Command::Sample(args) => args.run(&context),
            Command::Fit(args) => args.run(&context),
            Command::Simulate(args) => args.run(&context),
            Command::Batch(args) => args.run(&context),
            Command::Evaluate(args) => args.run(&context),
            Command::Expose(args) => args.run(&context),
            Command::Convert(args) => args.run(&context),
            Command::Measure(args) => args.run(&context),
            Command::Compare(args) => args.run(&context),
            Command::Preview(args) => args.run(&context),
            Command::Bench(args) => args.run(&context),
            Command::Devices(args) => args.run(&context),
            Command::RoundTrip(args) => args.run(&context),
            Command::Validate(args) => args.run(&context),
            Command::Reproduce(args) => args.run(&context),
        }
    }
}
