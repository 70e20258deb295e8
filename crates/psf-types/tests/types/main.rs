//! The checks of the data types, through what other crates see of them.

mod basis;
mod image;
mod model;
mod samples;
