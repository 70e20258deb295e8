//! The helps of the command line: commands in groups, and long texts in lines of readable width.

use clap::{Command, CommandFactory};

/// Commands by purpose. All others are listed under [`OTHERS`].
const GROUPS: [(&str, &[&str]); 2] = [
    ("Make a PSF", &["sample", "fit", "convert"]),
    ("Simulate", &["simulate", "expose", "batch"]),
];
const OTHERS: &str = "Look and check";

/// The widest line of a long help, without its indentation.
const WIDTH: usize = 86;

/// Builds the command line with its helps.
pub(crate) fn command<C: CommandFactory>() -> Command {
    let command = wrapped(C::command());
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
    let all = GROUPS.into_iter().chain([(OTHERS, others.as_slice())]);
    let texts =
        all.map(|(heading, names)| format!("{heading}:\n{}\n", names.iter().map(line).collect::<String>()));
    texts.collect()
}

/// Wraps the long texts of a command, its options and its subcommands. (The parser does so only
/// with its feature `wrap_help`.)
fn wrapped(command: Command) -> Command {
    let command = command.mut_args(|arg| match arg.get_long_help().map(ToString::to_string) {
        Some(text) => arg.long_help(lines(&text)),
        None => arg,
    });
    let command = command.mut_subcommands(wrapped);
    match command.get_long_about().map(ToString::to_string) {
        Some(text) => command.long_about(lines(&text)),
        None => command,
    }
}

/// Breaks lines at blanks where they exceed [`WIDTH`].
fn lines(text: &str) -> String {
    let mut wrapped = String::new();
    for line in text.lines() {
        let mut width = 0;
        for word in line.split(' ') {
            let length = word.chars().count();
            if width > 0 && width + 1 + length > WIDTH {
                wrapped.push('\n');
                width = 0;
            } else if width > 0 {
                wrapped.push(' ');
                width += 1;
            }
            wrapped += word;
            width += length;
        }
        wrapped.push('\n');
    }
    wrapped.trim_end().to_owned()
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
    fn long_lines_are_broken_at_blanks() {
        let word = "x".repeat(WIDTH / 2);
        assert_eq!(lines("one\n\ntwo three"), "one\n\ntwo three");
        assert_eq!(lines(&format!("{word} {word} a")), format!("{word}\n{word} a"));
    }
}
