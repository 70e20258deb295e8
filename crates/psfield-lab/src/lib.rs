//! Measures and shows the images of [`psfield`]: run time against error ([`mod@bench`]), the
//! figures and tables of the paper from which the method comes (Bai, Jia et al. 2025; [`report`]),
//! the round trip from a frame to its simulation ([`RoundTrip`]), figures ([`plot`]) and pictures
//! of images ([`preview`]).
//!
//! This crate builds on the library [`psfield`] and does not depend on the command line.
//!
//! # Features
//! `gpu` (off by default): enables the feature `gpu` of [`psfield`].

/// Declares a struct for the rows of a table, and a constant with the names of the table's columns:
/// the names of the struct's fields.
macro_rules! table_row {
    ($(#[$meta:meta])* $columns:ident $row:ident { $($field:ident: $type:ty,)+ }) => {
        #[doc = concat!("The names of the columns of a table of [`", stringify!($row), "`]s.")]
        pub const $columns: &[&str] = &[$(stringify!($field)),+];

        $(#[$meta])*
        pub struct $row {
            $(pub $field: $type,)+
        }
    };
}

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
