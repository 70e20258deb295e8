//! Names of earlier releases. They still work, with a note that gives the new name.

use std::ffi::OsString;

/// Options that have a new name: the command, the old name and the new one.
const OPTIONS: [(&str, &str, &str); 1] = [("fit", "--noise", "--sample-noise")];

/// Replaces old names among the arguments of the program, the first of which is its own name.
/// Returns the arguments, and a note for each name that was replaced.
pub(crate) fn replaced(arguments: impl IntoIterator<Item = OsString>) -> (Vec<OsString>, Vec<String>) {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    let mut notes = Vec::new();
    let command = arguments.get(1).cloned().unwrap_or_default();
    for (_, old, new) in OPTIONS.iter().filter(|(of, ..)| command == *of) {
        for argument in &mut arguments {
            let text = argument.to_str().unwrap_or_default();
            let value = text
                .strip_prefix(old)
                .filter(|rest| rest.is_empty() || rest.starts_with('='));
            if let Some(value) = value {
                *argument = format!("{new}{value}").into();
                notes.push(format!(
                    "{old} is now called {new}: the old name will go with the next release"
                ));
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
        for kept in [
            "psfield fit s.fits --noises 2",
            "psfield simulate --noise 2",
            "psfield",
        ] {
            assert_eq!(of(kept), (kept.into(), 0));
        }
    }
}
