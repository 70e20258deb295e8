//! The command line, run as a user runs it: as a process in a folder of files.

mod bad_input;
mod batch;
mod bench;
mod catalogs;
mod converting;
mod desk;
mod devices;
mod evaluation;
mod exposing;
mod files;
mod full_disk;
#[cfg(unix)]
mod interrupts;
mod library;
mod measuring;
mod memory;
mod misuse;
mod observe;
mod preview;
mod reports;
mod sampling;
mod series;
mod simulation;
mod simulation_input;
mod stars;
mod states;
mod usage;
