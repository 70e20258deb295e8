//! The folder of a report.

use std::collections::BTreeMap;
use std::path::{Display, Path};

use anyhow::Context as _;
use psfield_lab::report::{Document, OBJECT_COLUMNS, ObjectRow};
use serde::Serialize;

use crate::context::{Bar, Context, object};
use crate::files::OutputFolder;

/// The folder in which a report is written.
#[derive(Debug, clap::Args)]
pub(crate) struct ReportFolder {
    /// Folder for the report: report.html, report.json, tables and figures (SVG and PNG)
    ///
    /// It is made if it does not exist. It must be empty unless --overwrite is given.
    #[arg(long, value_name = "DIR")]
    pub(crate) report: OutputFolder,
    /// Replace files that exist in the folder
    #[arg(long)]
    pub(crate) overwrite: bool,
}

const PAGE: &str = "report.html";
const NUMBERS: &str = "report.json";
/// Names of files that every report has.
pub(crate) const FILES: [&str; 2] = [PAGE, NUMBERS];

impl ReportFolder {
    /// Refuses, before any work, a folder that cannot be made or that cannot take these files. The
    /// folder is made later, when there is something to write.
    pub(crate) fn check(&self, files: &[&str]) -> anyhow::Result<()> {
        check(&self.report, files, self.overwrite)?;
        // The names of some files are not known yet. Without `--overwrite`, the folder must
        // therefore be empty.
        let held = match std::fs::read_dir(&*self.report) {
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

    /// Makes the folder if it does not exist.
    pub(crate) fn make(&self) -> anyhow::Result<()> {
        make(&self.report)
    }

    /// Writes all files. The HTML page is the last, so that a page exists only with all its files.
    /// Then removes the progress bar and prints the report. `notes`: how the PSF was read.
    pub(crate) fn publish(
        &self,
        document: &Document,
        (measured, notes): (&impl Serialize, Option<Vec<String>>),
        tables: &[(&str, &[ObjectRow])],
        (context, bar): (&Context, Bar),
        text: impl FnOnce(Display<'_>) -> String,
    ) -> anyhow::Result<()> {
        self.make()?;
        let mut files = Vec::new();
        let mut at = |name: String| {
            let path = self.report.join(&name);
            files.push(name);
            path
        };
        for (name, rows) in tables {
            psf_io::write_csv(at((*name).to_owned()), OBJECT_COLUMNS, *rows, self.overwrite)?;
        }
        for shown in document.figures() {
            let name = shown.name;
            psf_io::write_text(at(format!("{name}.svg")), shown.figure.svg(), self.overwrite)?;
            let png = shown.figure.png()?;
            psf_io::write_bytes(at(format!("{name}.png")), &png, self.overwrite)?;
        }
        let inputs = document.inputs.iter();
        let numbers = object! {
            software: &document.software,
            inputs: inputs.map(|(name, value)| (*name, value.as_str())).collect::<BTreeMap<_, _>>(),
            #[serde(flatten)]
            measured,
        };
        let numbers = serde_json::to_string_pretty(&numbers)?;
        psf_io::write_text(at(NUMBERS.to_owned()), &numbers, self.overwrite)?;
        psf_io::write_text(at(PAGE.to_owned()), &document.to_html(), self.overwrite)?;
        drop(bar);
        let folder = self.report.as_path();
        // A flattened `None` adds no keys.
        let report = object! {
            folder,
            files,
            #[serde(flatten)]
            notes: notes.map(|notes| object! { notes }),
            #[serde(flatten)]
            measured,
        };
        context.report(&report, || text(folder.display()))
    }
}

/// Checks that a report can be written to a folder. Returns an error if the folder cannot be made,
/// or if it holds one of `files` and `overwrite` is false. Leaves no new folders behind.
fn check(folder: &Path, files: &[&str], overwrite: bool) -> anyhow::Result<()> {
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
        // This fails, and keeps the folder, if another process has written in it by now.
        let _ = std::fs::remove_dir(part);
    }
    Ok(())
}

/// Makes a folder if it does not exist.
fn make(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: the report folder cannot be made", folder.display()))
}
