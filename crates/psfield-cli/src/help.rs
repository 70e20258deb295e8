//! The help of the command line: commands in groups.

use clap::{Command, CommandFactory};

/// Commands by purpose. All others are listed under [`LAST_GROUP`].
const GROUPS: [(&str, &[&str]); 3] = [
    ("Make a PSF", &["sample", "fit", "convert", "evaluate"]),
    ("Simulate", &["simulate", "expose", "series", "batch", "demo"]),
    ("Look and check", &["preview", "measure", "compare", "validate"]),
];
const LAST_GROUP: &str = "Measure psfield itself";

/// Builds the command line with its help texts.
pub(crate) fn command<C: CommandFactory>() -> Command {
    // Without this, a negative number is taken for an unknown option.
    let command = C::command().mut_subcommands(|command| command.allow_negative_numbers(true));
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{}Options:\n{{options}}\n\n\
         psfield COMMAND -h shows the main options of a command, psfield COMMAND --help shows all.\n",
        groups(&command)
    );
    command.help_template(template)
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
}
