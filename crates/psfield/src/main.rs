//! The command line `psfield`.

mod cli;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};

fn main() -> ExitCode {
    match cli::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => match error.downcast_ref::<cli::UsageError>() {
            Some(usage) => cli::Cli::command()
                .error(clap::error::ErrorKind::ArgumentConflict, usage)
                .exit(),
            None => {
                // Errors that show their cause themselves repeat it in the chain; say everything once.
                let mut said = error.to_string();
                eprint!("psfield: error: {said}");
                for cause in error.chain().skip(1).map(ToString::to_string) {
                    if !said.contains(&cause) {
                        eprint!(": {cause}");
                        said = cause;
                    }
                }
                eprintln!();
                ExitCode::FAILURE
            }
        },
    }
}
