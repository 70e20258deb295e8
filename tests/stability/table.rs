//! Prints the stability suite as a page of Markdown, or compares it with a page: `--check
//! STABILITY.md`.

use std::process::ExitCode;

use integration_tests::stability::{differences, render};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let expected = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => None,
        ["--check", path] => match std::fs::read_to_string(path) {
            Ok(text) => Some(text),
            Err(error) => {
                eprintln!("{path}: {error}");
                return ExitCode::FAILURE;
            }
        },
        _ => {
            eprintln!("usage: stability [--check STABILITY.md]");
            return ExitCode::from(2);
        }
    };
    let (page, mut wrong) = render();
    match expected {
        Some(expected) => wrong.extend(differences(&page, &expected)),
        None => print!("{page}"),
    }
    for line in &wrong {
        eprintln!("{line}");
    }
    if wrong.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
