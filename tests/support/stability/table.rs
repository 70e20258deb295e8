//! The stability suite as a page of Markdown.

use std::fmt::Write;

use super::outcome::{Cell, Outcome};
use super::{Section, sections};

/// The mark between a measured error and its limit. The error before the mark differs between
/// machines.
const AT_MOST: &str = " ≤ ";

const HEAD: &str = "# Numerical stability\n\n\
    ![measured errors and limits of the first table, method auto](docs/pictures/stability.png)\n\n\
    This page lists what psfield does with extreme inputs. Each measured figure stands before the limit\n\
    that it must keep. This command makes the page:\n\n\
    ```sh\n\
    cargo run --release -p integration-tests --bin stability > STABILITY.md\n\
    ```\n\n\
    Tests run these cases: `cargo test --release -p integration-tests --test stability`. With\n\
    `-- --check STABILITY.md` the program compares rows, limits and messages with this page (measured\n\
    figures differ between machines). No image holds NaN, and nothing panics. A refused input gives the\n\
    message below the table.\n";

/// Reasons and messages under a table, without repeats.
#[derive(Default)]
struct Notes(Vec<String>);

impl Notes {
    fn number(&mut self, text: &str) -> usize {
        let known = self.0.iter().position(|n| n == text);
        known.unwrap_or_else(|| {
            self.0.push(text.to_owned());
            self.0.len() - 1
        }) + 1
    }
}

/// Runs all cases and returns the page and the failures.
pub fn render() -> (String, Vec<String>) {
    let (mut page, mut failures) = (HEAD.to_owned(), Vec::new());
    for section in sections() {
        let (text, failed) = of_section(&section);
        page += &text;
        failures.extend(failed);
    }
    (page, failures)
}

fn of_section(section: &Section) -> (String, Vec<String>) {
    let (mut text, mut notes, mut failures) = (String::new(), Notes::default(), Vec::new());
    let columns = section.columns.join(" | ");
    let rule = " --- |".repeat(section.columns.len() + 1);
    write!(
        text,
        "\n## {}\n\n{}\n\n| case | {columns} |\n|{rule}\n",
        section.title, section.story
    )
    .expect("writing to a String cannot fail");
    for case in &section.cases {
        let cells = (case.run)();
        assert_eq!(
            cells.len(),
            section.columns.len(),
            "{}: one cell per column",
            case.name
        );
        write!(text, "| {} |", case.name).expect("writing to a String cannot fail");
        for (cell, column) in cells.iter().zip(section.columns) {
            if let Some(failure) = cell.failure() {
                failures.push(format!("{}: {}, {column}: {failure}", section.title, case.name));
            }
            write!(text, " {} |", of_cell(cell, &mut notes)).expect("writing to a String cannot fail");
        }
        text.push('\n');
    }
    if !notes.0.is_empty() {
        text += "\n| note | text |\n| --- | --- |\n";
    }
    for (n, note) in notes.0.iter().enumerate() {
        writeln!(text, "| {} | {note} |", n + 1).expect("writing to a String cannot fail");
    }
    (text, failures)
}

fn of_cell(cell: &Cell, notes: &mut Notes) -> String {
    let failed = if cell.failure().is_some() {
        " **FAILS**"
    } else {
        ""
    };
    let text = match &cell.0 {
        Outcome::Error { got, limit } => {
            let got = if *got == 0.0 {
                "0".to_owned()
            } else {
                format!("{got:.0e}")
            };
            format!("{got}{AT_MOST}{limit:.0e}")
        }
        Outcome::Refused { message, .. } => {
            format!("refused ({})", notes.number(&format!("Refused: \"{message}\"")))
        }
        Outcome::NotApplicable(reason) => {
            format!("n/a ({})", notes.number(&format!("Not measured: {reason}")))
        }
    };
    text + failed
}

/// The lines that differ in more than measured errors.
pub fn differences(page: &str, expected: &str) -> Vec<String> {
    let (a, b): (Vec<String>, Vec<String>) = (masked(page), masked(expected));
    let longest = a.len().max(b.len());
    let line = |lines: &[String], n: usize| lines.get(n).cloned().unwrap_or_default();
    (0..longest)
        .filter(|&n| line(&a, n) != line(&b, n))
        .map(|n| format!("line {}: {} instead of {}", n + 1, line(&a, n), line(&b, n)))
        .collect()
}

/// The lines of a page, without the measured errors before the limits.
fn masked(page: &str) -> Vec<String> {
    let cell = |text: &str| match text.split_once(AT_MOST) {
        Some((_, limit)) => format!("{AT_MOST}{limit}"),
        None => text.to_owned(),
    };
    page.lines()
        .map(|line| line.split('|').map(cell).collect::<Vec<_>>().join("|"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_measured_figures_may_differ() {
        let row = "| a case | 3e-16 ≤ 1e-12 | refused (1) |";
        assert!(differences(row, &row.replace("3e-16", "5e-16")).is_empty());
        for other in [
            "| a case | 3e-16 ≤ 1e-11 | refused (1) |",
            "| another | 3e-16 ≤ 1e-12 | refused (1) |",
            "",
        ] {
            assert_eq!(differences(row, other).len(), 1, "{other}");
        }
    }
}
