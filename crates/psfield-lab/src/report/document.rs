//! A report: sections of text, tables and figures, and the HTML page that shows them.

use std::fmt::Write;

use serde::Serialize;

use crate::plot::Figure;

/// A report, from which an HTML page is made.
#[derive(Debug, Clone)]
pub struct Document {
    /// The heading.
    pub title: String,
    /// The program that made the report.
    pub software: Software,
    /// Names and values of the inputs and of the conditions of the run.
    pub inputs: Vec<(&'static str, String)>,
    /// The sections, in order.
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

/// A table of strings.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// The text above the table.
    pub caption: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows, each with as many cells as there are columns.
    pub rows: Vec<Vec<String>>,
}

/// A figure with its caption and the name of its files.
#[derive(Debug, Clone)]
pub struct NamedFigure {
    /// The name of the files, without extension.
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
        let title = escaped(&self.title);
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
        );
        let software = &self.software;
        let _ = writeln!(
            page,
            "<p>psfield {}, {}, threads: {}. Command: <code>{}</code></p>",
            escaped(software.psfield),
            escaped(&software.machine),
            software.threads,
            escaped(&software.command)
        );
        page.push_str("<div class=\"wide\"><table class=\"inputs\"><caption>Inputs and conditions of this report</caption>\n");
        for (name, value) in &self.inputs {
            row(&mut page, [*name, value]);
        }
        page.push_str("</table></div>\n");
        for part in &self.sections {
            section(&mut page, part);
        }
        page.push_str("</body>\n</html>\n");
        page
    }

    /// All figures, in order.
    pub fn figures(&self) -> impl Iterator<Item = &NamedFigure> {
        self.sections.iter().flat_map(|section| &section.figures)
    }
}

impl Section {
    /// Makes a section with a heading, a paragraph if one is given, and figures.
    pub(super) fn new(title: &str, text: Option<String>, figures: Vec<NamedFigure>) -> Self {
        Self {
            title: title.to_owned(),
            paragraphs: text.into_iter().collect(),
            tables: Vec::new(),
            figures,
        }
    }
}

impl Table {
    /// Makes a table with these columns and without rows.
    pub(super) fn new(caption: &str, columns: &[&str]) -> Self {
        Self {
            caption: caption.to_owned(),
            columns: columns.iter().map(|&c| c.to_owned()).collect(),
            rows: Vec::new(),
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

const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1a1a1a; --paper: #ffffff; --faint: #5b6470; --line: #d5dae0; --shade: #f4f6f8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8eb; --paper: #16191d; --faint: #a4adb8; --line: #3a414a; --shade: #20252b; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 1120px; margin: 0 auto; padding: 1.5rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
p { max-width: 48rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; font-size: 0.9rem; }
caption { text-align: left; color: var(--faint); padding-bottom: 0.3rem; max-width: 60rem; }
th, td { padding: 0.25rem 0.5rem; border-bottom: 1px solid var(--line); text-align: right; vertical-align: top; }
td { white-space: nowrap; } th { background: var(--shade); } th:first-child, td:first-child { text-align: left; }
table.inputs td { text-align: left; white-space: normal; } .wide { overflow-x: auto; }
.figures { display: flex; flex-wrap: wrap; gap: 1.2rem; } figure { margin: 0; max-width: 100%; } figure img { max-width: 100%; height: auto; background: #ffffff; border-radius: 6px; }
figcaption { color: var(--faint); max-width: 60rem; font-size: 0.95rem; }
code { background: var(--shade); padding: 0.1rem 0.3rem; border-radius: 4px; overflow-wrap: anywhere; }
@media print {
  :root { --ink: #000000; --paper: #ffffff; --faint: #333333; --line: #bbbbbb; --shade: #f0f0f0; }
  @page { margin: 14mm; }
  body { max-width: none; padding: 0; font-size: 10pt; } p { max-width: none; }
  .wide { overflow: visible; } table { font-size: 7pt; } th, td { padding: 0.15rem 0.25rem; } td:first-child { white-space: normal; }
  .figures { display: block; } figure { width: auto !important; margin: 0.8rem 0; } figure, tr { break-inside: avoid; } h2, caption, section > p { break-after: avoid; } figure img { max-height: 235mm; width: auto; }
}
";

fn section(page: &mut String, section: &Section) {
    let _ = writeln!(page, "<section>\n<h2>{}</h2>", escaped(&section.title));
    for paragraph in &section.paragraphs {
        let _ = writeln!(page, "<p>{}</p>", escaped(paragraph));
    }
    for part in &section.tables {
        table(page, part);
    }
    page.push_str("<div class=\"figures\">\n");
    for shown in &section.figures {
        let caption = escaped(&shown.caption);
        let (width, height) = shown.figure.size();
        let _ = writeln!(
            page,
            "<figure style=\"width:{width}px\"><img width=\"{width}\" height=\"{height}\" alt=\"{caption}\" src=\"{}\">\n<figcaption>{caption}</figcaption></figure>",
            shown.figure.data_uri()
        );
    }
    page.push_str("</div>\n</section>\n");
}

fn table(page: &mut String, table: &Table) {
    let _ = write!(
        page,
        "<div class=\"wide\"><table><caption>{}</caption>\n<thead><tr>",
        escaped(&table.caption)
    );
    for name in &table.columns {
        let _ = write!(
            page,
            "<th scope=\"col\">{}</th>",
            escaped(name).replace(" %", "\u{a0}%")
        );
    }
    page.push_str("</tr></thead>\n<tbody>\n");
    for cells in &table.rows {
        row(page, cells.iter().map(String::as_str));
    }
    page.push_str("</tbody></table></div>\n");
}

fn row<'a>(page: &mut String, cells: impl IntoIterator<Item = &'a str>) {
    page.push_str("<tr>");
    for cell in cells {
        let _ = write!(page, "<td>{}</td>", escaped(cell));
    }
    page.push_str("</tr>\n");
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Axis, Curve, Curves};

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
        let curves = Curves {
            x: Axis::linear("x"),
            y: Axis::linear("y"),
            curves: vec![Curve::new("c", vec![(0.0, 1.0), (1.0, 2.0)])],
            marks: Vec::new(),
        };
        let mut table = Table::new("numbers", &["a", "b"]);
        table.rows.push(vec!["1".to_owned(), "<b>".to_owned()]);
        let document = Document {
            title: "A & B".to_owned(),
            software: Software::of_command("psfield reproduce --report '<dir>'".to_owned()),
            inputs: vec![("file", "\"quoted\"".to_owned())],
            sections: vec![Section {
                title: "first".to_owned(),
                paragraphs: vec!["one < two".to_owned()],
                tables: vec![table],
                figures: vec![NamedFigure {
                    name: "line",
                    caption: "a line".to_owned(),
                    figure: curves.figure().unwrap(),
                }],
            }],
        };
        let page = document.to_html();
        for text in [
            "A &amp; B",
            "&lt;dir&gt;",
            "one &lt; two",
            "&lt;b&gt;",
            "&quot;quoted&quot;",
            "a line",
        ] {
            assert!(page.contains(text), "{text}");
        }
        assert!(
            page.contains("src=\"data:image/svg+xml;base64,") && page.contains("prefers-color-scheme: dark")
        );
        for outside in ["http", "url(", "@import", "<script", "<link"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
