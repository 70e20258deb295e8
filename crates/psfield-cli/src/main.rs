//! The command line `psfield`: reads arguments, writes files and reports. The other crates of the
//! workspace do the computation.

#![deny(clippy::print_stderr)]

mod batch;
mod bench;
mod catalog_args;
mod compare;
mod context;
mod convert;
mod demo;
mod devices;
mod evaluate;
mod expose;
mod files;
mod fit;
mod help;
mod inject;
#[cfg(unix)]
mod interrupts;
mod json_lines;
mod measure;
mod observe;
mod old_names;
mod out_of_memory;
mod preview;
mod psf_args;
mod report_folder;
mod reproduce;
mod sample;
mod simulate;
mod star_args;
mod table_args;
mod validate;
mod values;

use std::process::ExitCode;

use anyhow::Context as _;
use clap::builder::{BoolValueParser, TypedValueParser};
use clap::{ArgMatches, FromArgMatches, Parser, Subcommand};
use context::{Context, GivenOptions, UsageError, message_of};
use conv_core::InstructionSet;
use files::NamedFiles;

/// Astronomical images with a point spread function that varies over the field
///
/// Positions are 0-based pixels: an integer is the centre of a pixel. A command refuses to replace
/// an existing file unless --overwrite is given.
///
/// Exit status: 0 done, 1 failed, 2 bad usage, 128 + N stopped by signal N (130 after Ctrl-C). A
/// stopped run leaves each output complete or as it was before.
///
/// A first run:
///
/// psfield demo
///
/// psfield sample psfield-demo/telescope.toml -o samples.fits
///
/// psfield fit samples.fits -o model.fits
///
/// psfield simulate psfield-demo/scene.fits --catalog psfield-demo/stars.csv --psf model.fits
/// -o image.fits
///
/// psfield expose image.fits --photon-noise --sky 200 --read-noise 5 -o raw.fits
#[derive(Debug, Parser)]
#[command(name = "psfield", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: GlobalArgs,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Common options")]
struct GlobalArgs {
    /// Print one JSON object on standard output instead of text
    #[arg(long, global = true, action = clap::ArgAction::SetTrue, value_parser = BoolValueParser::new().map(files::JsonTo::of_flag))]
    json: files::JsonTo,
    /// Print only errors (and the output of --json)
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Number of threads, without effect on the result [default: one per core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

/// The commands. `help::GROUPS` gives their order in the help.
#[derive(Debug, Subcommand)]
enum Command {
    Sample(Box<sample::SampleArgs>),
    Fit(fit::FitCommandArgs),
    Convert(convert::ConvertArgs),
    Simulate(Box<simulate::SimulateArgs>),
    Expose(Box<expose::ExposeArgs>),
    Batch(batch::BatchArgs),
    Observe(observe::ObserveArgs),
    Inject(Box<inject::InjectArgs>),
    Series(simulate::SeriesArgs),
    Demo(demo::DemoArgs),
    Preview(preview::PreviewArgs),
    Evaluate(evaluate::EvaluateArgs),
    Measure(measure::MeasureArgs),
    Compare(compare::CompareArgs),
    Validate(Box<validate::ValidateArgs>),
    Reproduce(reproduce::ReproduceArgs),
    Bench(bench::BenchArgs),
    Devices(devices::DevicesArgs),
}

impl Cli {
    /// Runs the command. `ran` and `matches`: its definition and its arguments. `notes`: notes to print.
    fn run(self, ran: &clap::Command, matches: &ArgMatches, notes: &[String]) -> anyhow::Result<()> {
        let mut files = NamedFiles::of(ran, matches)?;
        match &self.command {
            Command::Sample(args) => files.outputs.extend(args.hold_out_file()),
            Command::Simulate(args) => files.outputs.extend(args.default_truth()),
            Command::Preview(args) => files.outputs.extend(args.default_picture()),
            _ => {}
        }
        files.check()?;
        InstructionSet::asked().map_err(|error| UsageError(error.to_string()))?;
        out_of_memory::name(&files.inputs);
        #[cfg(unix)]
        interrupts::handle().context("cannot install the handlers for Ctrl-C and termination signals")?;
        // 0: one thread per core. This thread is one of them: it begins each parallel step at once,
        // while a sleeping thread takes milliseconds to join in.
        let threads = self.global.threads.map_or(0, usize::from);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .use_current_thread();
        pool.build_global().context("cannot start the threads")?;
        let context = Context {
            json: self.global.json == files::JsonTo::Output,
            quiet: self.global.quiet,
            part: String::new(),
            given: GivenOptions::of(ran, matches),
        };
        for note in notes {
            context.note(note);
        }
        match self.command {
            Command::Demo(args) => args.run(&context),
            Command::Sample(args) => args.run(&context),
            Command::Fit(args) => args.run(&context),
            Command::Simulate(args) => args.run(&context),
            Command::Batch(args) => args.run(&context),
            Command::Observe(args) => args.run(&context),
            Command::Inject(args) => args.run(&context),
            Command::Series(args) => args.run(&context),
            Command::Evaluate(args) => args.run(&context),
            Command::Expose(args) => args.run(&context),
            Command::Convert(args) => args.run(&context),
            Command::Measure(args) => args.run(&context),
            Command::Compare(args) => args.run(&context),
            Command::Preview(args) => args.run(&context),
            Command::Bench(args) => args.run(&context),
            Command::Devices(args) => args.run(&context),
            Command::Validate(args) => args.run(&context),
            Command::Reproduce(args) => args.run(&context),
        }
    }
}

/// Sets `XDG_RUNTIME_DIR` if it is missing, as in a container. Mesa's GPU drivers would otherwise
/// write errors to the terminal.
#[cfg(feature = "gpu")]
#[allow(unsafe_code, reason = "only the environment keeps these drivers quiet")]
fn quieten_drivers() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: this is the only thread so far.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
}

/// Ends the program with clap's message about the arguments, or with the help or version that the
/// arguments ask for.
fn refuse(error: &clap::Error) -> ! {
    if error.kind() != clap::error::ErrorKind::ValueValidation {
        error.exit();
    }
    context::say(values::plain_text(error).trim_end());
    std::process::exit(error.exit_code())
}

fn main() -> ExitCode {
    #[cfg(feature = "gpu")]
    quieten_drivers();
    let (arguments, notes) = old_names::replaced(std::env::args_os());
    let mut command = help::command::<Cli>();
    let given = command
        .try_get_matches_from_mut(arguments)
        .unwrap_or_else(|error| refuse(&error));
    let cli = Cli::from_arg_matches(&given).unwrap_or_else(|error| refuse(&error.format(&mut command)));
    let (name, arguments) = given.subcommand().expect("clap requires a command");
    let ran = command.find_subcommand(name).expect("clap found this command");
    let Err(error) = cli.run(ran, arguments, &notes) else {
        return ExitCode::SUCCESS;
    };
    if let Some(usage) = error.downcast_ref::<UsageError>() {
        command.build();
        let ran = command.find_subcommand_mut(name);
        ran.expect("clap found this command")
            .error(clap::error::ErrorKind::ArgumentConflict, usage)
            .exit();
    }
    // If the reader of standard output closes it early (`| head`), the command has not failed.
    if error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
    {
        return ExitCode::SUCCESS;
    }
    context::say(&format!("psfield: error: {}", message_of(&error)));
    ExitCode::FAILURE
}
