//! Options of a job as they were given.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::super::UsageError;

/// `OPTION=VALUE`; a flag may stand alone.
#[derive(Debug, Clone)]
pub(super) struct Assignment {
    option: String,
    value: String,
}

impl FromStr for Assignment {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (option, value) = text.split_once('=').unwrap_or((text, "true"));
        if option.trim().is_empty() || value.is_empty() {
            return Err("an option and its value are needed, as in tolerance=1e-5".to_owned());
        }
        Ok(Self {
            option: option.to_owned(),
            value: value.to_owned(),
        })
    }
}

/// What an option is set to.
#[derive(Debug, Clone)]
pub(super) struct Setting {
    pub(super) value: String,
    /// Where relative paths count from.
    pub(super) folder: PathBuf,
}

/// Options by name, without leading hyphens.
#[derive(Debug, Clone, Default)]
pub(super) struct Settings(BTreeMap<String, Setting>);

impl Settings {
    /// Sets an option of the command line.
    pub(super) fn add(&mut self, of: Assignment) -> Result<(), UsageError> {
        self.set(&of.option, of.value, Path::new(""))
            .map_err(|what| UsageError(format!("--set: {what}")))
    }

    /// Sets an option that is not set yet. `stamp_size` is `stamp-size`.
    pub(super) fn set(&mut self, option: &str, value: String, folder: &Path) -> Result<(), String> {
        let name = option.trim().replace('_', "-");
        let folder = folder.to_owned();
        match self.0.insert(name, Setting { value, folder }) {
            Some(_) => Err(format!("{option} is given twice")),
            None => Ok(()),
        }
    }

    /// These, and of `weaker` what is not set here.
    pub(super) fn or(mut self, weaker: &Self) -> Self {
        for (name, setting) in &weaker.0 {
            self.0.entry(name.clone()).or_insert_with(|| setting.clone());
        }
        self
    }

    pub(super) fn take(&mut self, name: &str) -> Option<Setting> {
        self.0.remove(name)
    }

    pub(super) fn get(&self, name: &str) -> Option<&Setting> {
        self.0.get(name)
    }

    /// In the order of the names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Setting)> {
        self.0.iter().map(|(name, setting)| (name.as_str(), setting))
    }
}
