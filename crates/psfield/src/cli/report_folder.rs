//! The folder that a report goes to.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use psfield::report::{Document, OBJECT_COLUMNS, ObjectRow};
use serde::Serialize;

/// Where a report is written.
#[derive(Debug, clap::Args)]
pub(super) struct ReportFolder {
    /// The folder to write report.html, report.json, tables and figures (SVG and PNG) to; made if it does not exist, empty unless --overwrite is given
    #[arg(long, value_name = "DIR")]
    report: PathBuf,
    /// Replace files that exist there
    #[arg(long)]
    overwrite: bool,
}

const PAGE: &str = "report.html";
const NUMBERS: &str = "report.json";

/// The numbers of a report, beside what made them.
#[derive(Debug, Serialize)]
struct Numbers<'a, T> {
    software: &'a psfield::report::Software,
    inputs: std::collections::BTreeMap<&'a str, &'a str>,
    #[serde(flatten)]
    measured: &'a T,
}

impl ReportFolder {
    pub(super) fn path(&self) -> &Path {
        &self.report
    }

    /// Refuses before any work where the folder cannot be made or has files that may not be replaced. It is made when there is something to
    /// write.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        check(&self.report, &[PAGE, NUMBERS], self.overwrite)?;
        // Tables and figures, whose names are not known yet, are refused as early.
        let held = match std::fs::read_dir(&self.report) {
            Ok(mut found) => found.next().is_some(),
            Err(_) => false,
        };
        anyhow::ensure!(
            self.overwrite || !held,
            "{}: the folder is not empty: choose another, or allow files there to be replaced (--overwrite)",
            self.report.display()
        );
        Ok(())
    }

    /// Writes everything; the page last, so that a page has all its files.
    pub(super) fn write(
        &self,
        document: &Document,
        measured: &impl Serialize,
        tables: &[(&str, &[ObjectRow])],
    ) -> anyhow::Result<Vec<String>> {
        make(&self.report)?;
        let mut files = Vec::new();
        let mut at = |name: String| {
            let path = self.report.join(&name);
            files.push(name);
            path
        };
        for (name, rows) in tables {
            psf_io::write_csv(at((*name).to_owned()), &OBJECT_COLUMNS, *rows, self.overwrite)?;
        }
        for shown in document.figures() {
            let name = shown.name;
            psf_io::write_text(at(format!("{name}.svg")), shown.figure.svg(), self.overwrite)?;
            let png = shown.figure.png()?;
            psf_io::write_bytes(at(format!("{name}.png")), &png, self.overwrite)?;
        }
        let numbers = Numbers {
            software: &document.software,
            inputs: document
                .inputs
                .iter()
                .map(|(name, value)| (name.as_str(), value.as_str()))
                .collect(),
            measured,
        };
        let numbers = serde_json::to_string_pretty(&numbers)?;
        psf_io::write_text(at(NUMBERS.to_owned()), &numbers, self.overwrite)?;
        psf_io::write_text(at(PAGE.to_owned()), &document.to_html(), self.overwrite)?;
        Ok(files)
    }
}

/// Refuses where a folder cannot be made or has one of these files, which may not be replaced. Nothing is left behind.
pub(super) fn check(folder: &Path, files: &[&str], overwrite: bool) -> anyhow::Result<()> {
    if folder.is_dir() {
        for name in files {
            psf_io::check_output(folder.join(name), overwrite)?;
        }
        return Ok(());
    }
    let missing: Vec<&Path> = folder
        .ancestors()
        .take_while(|part| !part.as_os_str().is_empty() && !part.exists())
        .collect();
    make(folder)?;
    for part in missing {
        // One that another process uses by now stays.
        let _ = std::fs::remove_dir(part);
    }
    Ok(())
}

/// Makes a folder, if it is not there.
pub(super) fn make(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: the report folder cannot be made", folder.display()))
}
