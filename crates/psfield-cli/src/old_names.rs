//! Names of earlier releases. They still work, with a note that gives the new name.

use std::ffi::OsString;

/// Commands that have a new name: the old name and the new one.
const COMMANDS: [(&str, &str); 1] = [("roundtrip", "validate")];

/// Options that have a new name: the command, the old name and the new one.
const OPTIONS: [(&str, &str, &str); 6] = [
    ("evaluate", "--grid", "--pixels"),
    ("fit", "--noise", "--sample-noise"),
    ("roundtrip", "--threshold", "--detection-threshold"),
    ("sample", "--max-samples", "--max-draws"),
    ("simulate", "--oversample", "--oversampling"),
    ("validate", "--truth", "--reference"),
];

/// Returns the note that a name is old.
pub(crate) fn note(old: &str, new: &str) -> String {
    format!("{old} is now called {new}: the next release removes the old name")
}

/// Returns the present name of an option of a command, both without leading hyphens.
pub(crate) fn option(command: &str, name: &str) -> String {
    let dashed = format!("--{name}");
    let mut renamed = OPTIONS
        .iter()
        .filter(|(of, old, _)| *of == command && *old == dashed);
    renamed.next().map_or(name, |(.., new)| &new[2..]).to_owned()
}

/// Replaces old names in the arguments of the program. (The first argument is the program's own
/// name.) Returns the arguments, and a note for each name that was replaced.
pub(crate) fn replaced(arguments: impl IntoIterator<Item = OsString>) -> (Vec<OsString>, Vec<String>) {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    let mut notes = Vec::new();
    // The common options may stand before the command. The number is the value of --threads.
    let is_command = |text: &&str| !text.starts_with('-') && text.parse::<u16>().is_err();
    let mut texts = arguments.iter().enumerate().skip(1);
    let command = texts.find_map(|(at, text)| Some((at, text.to_str().filter(is_command)?.to_owned())));
    let Some((at, command)) = command else {
        return (arguments, notes);
    };
    if let Some((old, new)) = COMMANDS.iter().find(|(old, _)| command == *old) {
        arguments[at] = (*new).into();
        notes.push(note(&format!("psfield {old}"), &format!("psfield {new}")));
    }
    for (_, old, new) in OPTIONS.iter().filter(|(of, ..)| command == *of) {
        for argument in &mut arguments {
            let text = argument.to_str().unwrap_or_default();
            let value = text
                .strip_prefix(old)
                .filter(|rest| rest.is_empty() || rest.starts_with('='));
            if let Some(value) = value {
                *argument = format!("{new}{value}").into();
                notes.push(note(old, new));
            }
        }
    }
    (arguments, notes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_names_are_replaced_in_their_command_alone() {
        let of = |line: &str| {
            let (arguments, notes) = replaced(line.split(' ').map(OsString::from));
            (arguments.join(OsString::from(" ").as_os_str()), notes.len())
        };
        let fit = "psfield fit s.fits --noise";
        assert_eq!(
            of(&format!("{fit} 2")),
            ("psfield fit s.fits --sample-noise 2".into(), 1)
        );
        assert_eq!(
            of(&format!("{fit}=2")),
            ("psfield fit s.fits --sample-noise=2".into(), 1)
        );
        let trip = "psfield roundtrip f.fits --threshold 4";
        assert_eq!(
            of(trip),
            ("psfield validate f.fits --detection-threshold 4".into(), 2)
        );
        let line = "psfield -q --threads 2 fit s.fits --noise 2";
        assert_eq!(of(line).1, 1);
        for kept in [
            "psfield fit s.fits --noises 2",
            "psfield simulate --noise 2",
            "psfield",
        ] {
            assert_eq!(of(kept), (kept.into(), 0));
        }
    }
}
