//! A report: sections of text, tables and figures.

use super::{Software, html};
use crate::plot::Figure;

/// A report, from which a page is made.
#[derive(Debug, Clone)]
pub struct Document {
    /// The heading.
    pub title: String,
    /// What made it.
    pub software: Software,
    /// What went in: name and value.
    pub inputs: Vec<(String, String)>,
    /// What it says, in order.
    pub sections: Vec<Section>,
}

/// A part of a report.
#[derive(Debug, Clone, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// Paragraphs of plain text.
    pub paragraphs: Vec<String>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Figures.
    pub figures: Vec<NamedFigure>,
}

/// A table of texts.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows, each with as many cells as there are columns.
    pub rows: Vec<Vec<String>>,
}

/// A figure with the name of its files and what it shows.
#[derive(Debug, Clone)]
pub struct NamedFigure {
    /// The files' name, without the ending.
    pub name: &'static str,
    /// What it shows.
    pub caption: String,
    /// The figure.
    pub figure: Figure,
}

impl Document {
    /// One HTML page that holds all it shows and needs nothing else: light and dark as the reader's system is, made for print as well.
    pub fn to_html(&self) -> String {
        html::page(self)
    }

    /// All figures, in order.
    pub fn figures(&self) -> impl Iterator<Item = &NamedFigure> {
        self.sections.iter().flat_map(|section| &section.figures)
    }
}

impl Table {
    /// A table of these columns, without rows.
    pub(super) fn new(caption: &str, columns: &[&str]) -> Self {
        Self {
            caption: caption.to_owned(),
            columns: columns.iter().map(|&c| c.to_owned()).collect(),
            rows: Vec::new(),
        }
    }
}
