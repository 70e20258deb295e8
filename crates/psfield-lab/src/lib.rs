//! Measures and shows the images of [`psfield`]: run time against error ([`mod@bench`]), the
//! figures and tables of the paper from which the method comes (Bai, Jia et al. 2025; [`report`]),
//! the round trip from a frame to its simulation ([`RoundTrip`]), figures ([`plot`]) and pictures
//! of images ([`preview`]).
//!
//! This crate builds on the library [`psfield`] and does not depend on the command line.
//!
//! # Features
//! `gpu` (off by default): enables the feature `gpu` of [`psfield`].

pub mod bench;
mod error;
mod memory;
pub mod plot;
pub mod preview;
pub mod report;
mod round_trip;
mod star_comparison;

pub use error::LabError;
pub use memory::{available_memory_bytes, peak_memory_bytes};
pub use round_trip::{ROUND_TRIP_COLUMNS, RoundTrip, RoundTripOptions, RoundTripReport, RoundTripRow};
pub use star_comparison::{Agreement, Distribution, StarComparison};
