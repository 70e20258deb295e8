//! The stability suite: extreme inputs, each with the error it causes and the limit that it must
//! keep.
//!
//! The test `stability` runs these cases as tests, and the program `stability` prints them as
//! `STABILITY.md`.

mod bases;
mod faint;
mod fields;
mod images;
mod kriging;
mod models;
mod outcome;
mod positions;
mod scenes;
mod stamps;
mod table;

pub use outcome::{Cell, Outcome};
pub use table::{differences, render};

/// Rows that share their columns.
#[derive(Debug)]
pub struct Section {
    /// The heading.
    pub title: &'static str,
    /// The measured quantity and the reasons for the limits, as paragraphs of Markdown.
    pub story: &'static str,
    /// One name for each cell of a row.
    pub columns: &'static [&'static str],
    /// The rows.
    pub cases: Vec<Case>,
}

/// A row: an extreme input and its measurement.
pub struct Case {
    /// The extreme property of the input.
    pub name: String,
    /// Measures one cell for each column.
    pub run: Box<dyn Fn() -> Vec<Cell> + Send + Sync>,
}

impl std::fmt::Debug for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Case")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

impl Case {
    fn new(name: impl Into<String>, run: impl Fn() -> Vec<Cell> + Send + Sync + 'static) -> Self {
        Self {
            name: name.into(),
            run: Box::new(run),
        }
    }
}

/// All cases.
pub fn sections() -> Vec<Section> {
    vec![
        scenes::section(),
        faint::section(),
        stamps::section(),
        bases::section(),
        fields::section(),
        kriging::section(),
        fields::image_section(),
    ]
}
