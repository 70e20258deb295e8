//! Tests the checks of the data types through their public interface.

mod basis;
mod image;
mod model;
mod samples;
