//! The help of the command line: commands in groups.

use clap::builder::{Resettable, StyledStr};
use clap::{Arg, Command, CommandFactory};
use conv_core::PlanOptions;
use psf_sample::{AdaptiveSampling, Criterion, KrigingSampling, Refinement, SamplingOptions};
use psf_stars::Detection;
use psfield::SimulateOptions;

use crate::values::text_of_bytes;

/// Commands by purpose. All others are listed under [`LAST_GROUP`].
const GROUPS: [(&str, &[&str]); 3] = [
    ("Make a PSF", &["sample", "fit", "convert", "evaluate"]),
    (
        "Simulate",
        &[
            "simulate", "expose", "series", "batch", "observe", "inject", "demo",
        ],
    ),
    ("Look and check", &["preview", "measure", "compare", "validate"]),
];
const LAST_GROUP: &str = "Measure psfield itself";

/// Builds the command line with its help texts.
pub(crate) fn command<C: CommandFactory>() -> Command {
    // Without this, a negative number is taken for an unknown option.
    let command = C::command().mut_subcommands(|command| command.allow_negative_numbers(true));
    let defaults = defaults();
    let command = command.mut_subcommands(|command| command.mut_args(|arg| with_defaults(arg, &defaults)));
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{}Options:\n{{options}}\n\n\
         psfield COMMAND -h shows the main options of a command, psfield COMMAND --help shows all.\n",
        groups(&command)
    );
    command.help_template(template)
}

/// The defaults of the library that help texts name in braces.
fn defaults() -> [(&'static str, String); 12] {
    let (sampling, simulation) = (SamplingOptions::default(), SimulateOptions::default());
    [
        ("{criterion}", Criterion::default().to_string()),
        ("{detection_threshold}", Detection::DEFAULT_THRESHOLD.to_string()),
        ("{max_draws}", sampling.max_draws.to_string()),
        ("{measure}", sampling.measure.to_string()),
        ("{memory}", text_of_bytes(PlanOptions::DEFAULT_MEMORY_BYTES)),
        ("{method}", Refinement::default().to_string()),
        ("{seed}", sampling.seed.to_string()),
        ("{start}", AdaptiveSampling::DEFAULT_START.to_string()),
        ("{threshold}", sampling.threshold.to_string()),
        ("{tolerance}", format!("{:e}", simulation.tolerance)),
        ("{floor}", simulation.floor.to_string()),
        ("{verify}", KrigingSampling::DEFAULT_VERIFY.to_string()),
    ]
}

/// Replaces the names of defaults in the help of an argument by their values.
fn with_defaults(arg: Arg, defaults: &[(&str, String)]) -> Arg {
    let filled = |text: &StyledStr| {
        let fill = |text: String, (name, value): &(&str, String)| text.replace(name, value);
        StyledStr::from(defaults.iter().fold(text.to_string(), fill))
    };
    let help: Resettable<StyledStr> = arg.get_help().map(filled).into();
    let long_help: Resettable<StyledStr> = arg.get_long_help().map(filled).into();
    arg.help(help).long_help(long_help)
}

/// The commands under their headings, each with its one-line description.
fn groups(command: &Command) -> String {
    let is_grouped = |name: &str| GROUPS.iter().any(|(_, names)| names.contains(&name));
    let names = command.get_subcommands().map(Command::get_name);
    let others: Vec<&str> = names.filter(|name| !is_grouped(name)).collect();
    let line = |name: &&str| {
        let found = command.find_subcommand(name);
        let about = found.and_then(Command::get_about).map(ToString::to_string);
        format!("  {name:10} {}\n", about.unwrap_or_default())
    };
    let all = GROUPS.into_iter().chain([(LAST_GROUP, others.as_slice())]);
    let texts =
        all.map(|(heading, names)| format!("{heading}:\n{}\n", names.iter().map(line).collect::<String>()));
    texts.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_hold_commands_that_exist() {
        let command = crate::Cli::command();
        for name in GROUPS.iter().flat_map(|(_, names)| *names) {
            assert!(command.find_subcommand(name).is_some(), "{name}");
        }
    }

    #[test]
    fn no_default_stays_a_name() {
        for command in command::<crate::Cli>().get_subcommands() {
            for arg in command.get_arguments() {
                let help = arg.get_long_help().or(arg.get_help());
                let help = help.map(ToString::to_string).unwrap_or_default();
                assert!(!help.contains(": {"), "{help}");
            }
        }
    }
}
