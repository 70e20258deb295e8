//! The folder of a report.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use psfield_lab::report::{Document, OBJECT_COLUMNS, ObjectRow, Section};
use serde::Serialize;

use crate::context::object;
use crate::files::OutputFolder;

/// The folder in which a report is written.
#[derive(Debug, clap::Args)]
pub(crate) struct ReportFolder {
    /// Folder for the report: report.html, report.json, tables and figures (SVG)
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
        let folder = self.report.as_path();
        if !folder.is_dir() {
            // Leaves no new folders behind.
            let missing: Vec<&Path> = folder
                .ancestors()
                .take_while(|part| !part.as_os_str().is_empty() && !part.exists())
                .collect();
            self.make()?;
            for part in missing {
                // This fails, and keeps the folder, if another process has written in it by now.
                let _ = std::fs::remove_dir(part);
            }
            return Ok(());
        }
        for name in files {
            psf_io::check_output(folder.join(name), self.overwrite)?;
        }
        // The names of some files are not known yet. Without `--overwrite`, the folder must
        // therefore be empty.
        let held = std::fs::read_dir(folder).is_ok_and(|mut found| found.next().is_some());
        anyhow::ensure!(
            self.overwrite || !held,
            "{}: the folder is not empty: choose another, or allow files there to be replaced (--overwrite)",
            folder.display()
        );
        Ok(())
    }

    /// Makes the folder if it does not exist.
    pub(crate) fn make(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&*self.report)
            .with_context(|| format!("{}: the report folder cannot be made", self.report.display()))
    }

    /// Writes all files, and returns their names. Tables and numbers come first, so that an error in
    /// drawing loses no measurement. The HTML page is the last, so that a page exists only with all its
    /// files. `sections` draws the figures of the report.
    pub(crate) fn write(
        &self,
        tables: &[(&str, &[ObjectRow])],
        mut document: Document,
        measured: &impl Serialize,
        sections: impl FnOnce() -> Vec<Section>,
    ) -> anyhow::Result<Vec<String>> {
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
        let inputs = document.inputs.iter();
        let numbers = object! {
            software: &document.software,
            inputs: inputs.map(|(name, value)| (*name, value.as_str())).collect::<BTreeMap<_, _>>(),
            #[serde(flatten)]
            measured,
        };
        let numbers = serde_json::to_string_pretty(&numbers)?;
        psf_io::write_text(at(NUMBERS.to_owned()), &numbers, self.overwrite)?;
        document.sections = sections();
        for shown in document.figures() {
            let path = at(format!("{}.svg", shown.name));
            psf_io::write_text(path, &shown.figure.svg(), self.overwrite)?;
        }
        psf_io::write_text(at(PAGE.to_owned()), &document.to_html(), self.overwrite)?;
        Ok(files)
    }
}
