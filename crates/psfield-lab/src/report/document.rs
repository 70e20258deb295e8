//! A report: sections of text, tables and figures, and the HTML page that shows them.

use std::fmt::Write;

use serde::Serialize;

use crate::plot::{Chart, Figure, escaped};

/// A report, from which an HTML page is made.
#[derive(Debug, Clone)]
pub struct Document {
    /// The heading.
    pub title: &'static str,
    /// The program that made the report.
    pub software: Software,
    /// Names and values of the inputs and of the conditions of the run.
    pub inputs: Vec<(&'static str, String)>,
    /// The sections, in order.
    pub sections: Vec<Section>,
}

/// A part of a report.
#[derive(Debug, Clone)]
pub struct Section {
    title: &'static str,
    paragraphs: Vec<String>,
    tables: Vec<Table>,
    /// Figures.
    pub figures: Vec<NamedFigure>,
}

/// A table of strings.
#[derive(Debug, Clone)]
pub(super) struct Table {
    /// The text above the table.
    caption: String,
    columns: Vec<String>,
    /// Rows, each with as many cells as there are columns.
    rows: Vec<Vec<String>>,
}

/// A figure with its caption and the name of its file.
#[derive(Debug, Clone)]
pub struct NamedFigure {
    /// The name of the file, without extension.
    pub name: &'static str,
    /// The text below the figure.
    pub caption: String,
    /// The figure.
    pub figure: Figure,
}

impl Document {
    /// Returns a self-contained HTML page, which can be printed. The page is light or dark, as the
    /// reader's system is set.
    pub fn to_html(&self) -> String {
        let (title, software) = (escaped(self.title), &self.software);
        let inputs = self.inputs.iter().map(|(name, value)| [*name, value]);
        let sections = self.sections.iter().map(Section::to_html);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n\
             <p>psfield {}, {}, threads: {}. Command: <code>{}</code></p>\n\
             <div class=\"wide\"><table class=\"inputs\"><caption>Inputs and conditions of this report</caption>\n{}</table></div>\n\
             {}</body>\n</html>\n",
            escaped(software.psfield),
            escaped(&software.machine),
            software.threads,
            escaped(&software.command),
            rows("td", inputs),
            sections.collect::<String>(),
        )
    }

    /// All figures, in order.
    pub fn figures(&self) -> impl Iterator<Item = &NamedFigure> {
        self.sections.iter().flat_map(|section| &section.figures)
    }
}

/// Width in pixels of one of two charts next to each other.
const HALF_PAGE: f64 = 550.0;

impl Section {
    /// Makes a section with a heading and paragraphs of plain text.
    pub(super) fn new<const N: usize>(title: &'static str, paragraphs: [&str; N]) -> Self {
        Self {
            title,
            paragraphs: paragraphs.map(str::to_owned).into(),
            tables: Vec::new(),
            figures: Vec::new(),
        }
    }

    /// Adds a table.
    pub(super) fn with_table(mut self, table: Table) -> Self {
        self.tables.push(table);
        self
    }

    /// Adds a figure.
    pub(super) fn with_figure(mut self, name: &'static str, caption: &str, charts: &[Chart]) -> Self {
        self.figures.push(NamedFigure {
            name,
            caption: caption.to_owned(),
            figure: Figure::new(charts, HALF_PAGE),
        });
        self
    }

    fn to_html(&self) -> String {
        let mut html = format!("<section>\n<h2>{}</h2>\n", escaped(self.title));
        // Writing to a string does not fail.
        for paragraph in &self.paragraphs {
            let _ = writeln!(html, "<p>{}</p>", escaped(paragraph));
        }
        for table in &self.tables {
            let columns = table.columns.iter().map(|name| name.replace(" %", "\u{a0}%"));
            let _ = writeln!(
                html,
                "<div class=\"wide\"><table><caption>{}</caption>\n<thead>{}</thead>\n<tbody>\n{}</tbody></table></div>",
                escaped(&table.caption),
                rows("th", [columns.collect::<Vec<_>>()]),
                rows("td", &table.rows),
            );
        }
        html.push_str("<div class=\"figures\">\n");
        for NamedFigure { caption, figure, .. } in &self.figures {
            let (width, drawn) = (figure.width(), figure.in_page(caption));
            let _ = writeln!(
                html,
                "<figure style=\"width:{width:.0}px\">{drawn}<figcaption>{}</figcaption></figure>",
                escaped(caption)
            );
        }
        html + "</div>\n</section>\n"
    }
}

/// Rows of a table whose cells are `td` or `th`.
fn rows<R: IntoIterator<Item: AsRef<str>>>(cell: &str, rows: impl IntoIterator<Item = R>) -> String {
    let row = |row: R| {
        let cells = row
            .into_iter()
            .map(|text| format!("<{cell}>{}</{cell}>", escaped(text.as_ref())));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    rows.into_iter().map(row).collect()
}

/// A column of a table: its name, and the cell of a row.
pub(super) type Column<'a, R> = (&'a str, &'a dyn Fn(&R) -> String);

impl Table {
    /// Makes a table with a row for each item of a list.
    pub(super) fn new<'a, R: 'a>(
        caption: &str,
        columns: &[Column<'_, R>],
        rows: impl IntoIterator<Item = &'a R>,
    ) -> Self {
        let cells = |row| columns.iter().map(|(_, cell)| cell(row)).collect();
        Self {
            caption: caption.to_owned(),
            columns: columns.iter().map(|(name, _)| (*name).to_owned()).collect(),
            rows: rows.into_iter().map(cells).collect(),
        }
    }
}

/// Formats a number for a table or a sentence: with three decimals, or with two digits and an
/// exponent if its absolute value is below 0.01 or at least 1e4. None becomes a dash.
pub(crate) fn short(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(v) if (0.01..1e4).contains(&v.abs()) => format!("{v:.3}"),
        Some(v) => format!("{v:.1e}"),
    }
}

/// The program that made a report: its version, machine and command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Software {
    /// psfield's version.
    pub psfield: &'static str,
    /// Operating system, architecture, name of the processor if it is known, and number of logical
    /// processors.
    pub machine: String,
    /// Number of threads that shared the work.
    pub threads: usize,
    /// The command that made the report.
    pub command: String,
}

impl Software {
    /// Describes this program on this machine.
    pub fn of_command(command: String) -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            psfield: env!("CARGO_PKG_VERSION"),
            machine: format!(
                "{} {}, {}{processors} logical processors",
                std::env::consts::OS,
                std::env::consts::ARCH,
                processor().map_or_else(String::new, |name| name + ", ")
            ),
            threads: rayon::current_num_threads(),
            command,
        }
    }
}

/// The name of the processor. None if the system does not report it (only Linux does).
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// The average number of processes that ran or waited during the last minute. None if the system
/// does not report it (only Linux does).
pub(super) fn load() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split(' ').next()?.parse().ok()
}

const STYLE: &str = include_str!("page.css");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Axis, Curve};

    #[test]
    fn numbers_of_a_table_have_three_decimals_or_an_exponent() {
        for (value, text) in [
            (None, "-"),
            (Some(0.0), "0"),
            (Some(0.0901), "0.090"),
            (Some(-2.0), "-2.000"),
            (Some(1.23e-4), "1.2e-4"),
            (Some(12_345.0), "1.2e4"),
        ] {
            assert_eq!(short(value), text);
        }
    }

    #[test]
    fn a_page_holds_all_it_shows_and_no_text_becomes_markup() {
        let curve = Curve::new("c", vec![(0.0, 1.0), (1.0, 2.0)]);
        let chart = Chart::new("x & y", Axis::linear("x"), Axis::linear("y"), vec![curve]);
        let columns: [Column<'_, u8>; 2] = [("a", &|n| n.to_string()), ("b", &|_| "<b>".to_owned())];
        let section = Section::new("first", ["one < two"])
            .with_table(Table::new("numbers", &columns, &[1]))
            .with_figure("line", "a \"line\"", &[chart]);
        let document = Document {
            title: "A & B",
            software: Software::of_command("psfield reproduce --report '<dir>'".to_owned()),
            inputs: vec![("file", "\"quoted\"".to_owned())],
            sections: vec![section],
        };
        let page = document.to_html();
        for text in [
            "A &amp; B",
            "&lt;dir&gt;",
            "one &lt; two",
            "<th>a</th>",
            "<td>1</td><td>&lt;b&gt;</td>",
            "&quot;quoted&quot;",
            "a &quot;line&quot;",
            ">x &amp; y</text>",
            "<svg role=\"img\"",
            "prefers-color-scheme: dark",
        ] {
            assert!(page.contains(text), "{text}");
        }
        for outside in ["http", "url(", "@import", "<script", "<link"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
