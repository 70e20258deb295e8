//! The command line `psfield`.

mod cli;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    let name = cli.command_name();
    let Err(error) = cli.run() else {
        return ExitCode::SUCCESS;
    };
    if let Some(usage) = error.downcast_ref::<cli::UsageError>() {
        let mut command = cli::Cli::command();
        command.build();
        command
            .find_subcommand_mut(name)
            .expect("the command that ran")
            .error(clap::error::ErrorKind::ArgumentConflict, usage)
            .exit();
    }
    // Who reads a part of the output and leaves (`| head`) has what was asked for.
    if error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
    {
        return ExitCode::SUCCESS;
    }
    eprintln!("psfield: error: {}", cli::told(&error));
    ExitCode::FAILURE
}
