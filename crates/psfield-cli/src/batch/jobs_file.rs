//! Jobs files, and options as they were given.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use toml::{Table, Value};

use crate::UsageError;

/// The jobs of a file, not understood yet.
#[derive(Debug)]
pub(super) struct JobsFile {
    pub(super) path: PathBuf,
    pub(super) defaults: Settings,
    /// Where each job stands, for messages, and what it sets.
    pub(super) jobs: Vec<(String, Settings)>,
}

impl JobsFile {
    /// Reads TOML or CSV, by the name of the file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let is_toml = match extension.as_deref() {
            Some("toml") => true,
            Some("csv") => false,
            _ => {
                let what = format!("{}: a jobs file ends in .toml or .csv", path.display());
                return Err(UsageError(what).into());
            }
        };
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let parsed = if is_toml {
            match std::str::from_utf8(&bytes) {
                Ok(text) => Self::from_toml(text, folder),
                Err(e) => Err(format!("no UTF-8 text: {e}")),
            }
        } else {
            Self::from_csv(&bytes, folder)
        };
        let file = parsed.map_err(|what| UsageError(format!("{}: {what}", path.display())))?;
        if file.jobs.is_empty() {
            return Err(UsageError(format!("{}: there is no job in it", path.display())).into());
        }
        Ok(Self {
            path: path.to_owned(),
            ..file
        })
    }

    /// `[defaults]` and `[[job]]` tables.
    pub(super) fn from_toml(text: &str, folder: &Path) -> Result<Self, String> {
        let table: Table = text.parse().map_err(|e: toml::de::Error| e.to_string())?;
        let mut defaults = Settings::default();
        let mut jobs = Vec::new();
        for (key, value) in table {
            match (key.as_str(), value) {
                ("defaults", Value::Table(options)) => {
                    defaults = settings(options, folder).map_err(|what| format!("[defaults]: {what}"))?;
                }
                ("job", Value::Array(tables)) => {
                    for (k, job) in tables.into_iter().enumerate() {
                        let place = format!("job {}", k + 1);
                        let Value::Table(options) = job else {
                            return Err(format!("{place}: jobs are tables: [[job]]"));
                        };
                        let options = settings(options, folder).map_err(|what| format!("{place}: {what}"))?;
                        jobs.push((place, options));
                    }
                }
                ("defaults" | "job", _) => {
                    return Err(format!(
                        "{key}: tables are needed, [defaults] once and [[job]] for each job"
                    ));
                }
                _ => {
                    return Err(format!(
                        "{key}: only [defaults] and [[job]] are known; options stand below one of them"
                    ));
                }
            }
        }
        Ok(Self {
            path: PathBuf::new(),
            defaults,
            jobs,
        })
    }

    /// A line of option names, a row a job.
    pub(super) fn from_csv(bytes: &[u8], folder: &Path) -> Result<Self, String> {
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_reader(bytes);
        let names = reader.headers().map_err(|e| e.to_string())?.clone();
        if let Some(column) = names.iter().position(str::is_empty) {
            return Err(format!("column {} has no name", column + 1));
        }
        let mut jobs = Vec::new();
        for (k, row) in reader.records().enumerate() {
            let row = row.map_err(|e| e.to_string())?;
            let line = row.position().map_or(0, |position| line_of(bytes, position));
            let place = format!("job {} (line {line})", k + 1);
            let mut options = Settings::default();
            for (name, value) in names.iter().zip(&row).filter(|(_, value)| !value.is_empty()) {
                options
                    .set(name, value.to_owned(), folder)
                    .map_err(|what| format!("{place}: {what}"))?;
            }
            jobs.push((place, options));
        }
        Ok(Self {
            path: PathBuf::new(),
            defaults: Settings::default(),
            jobs,
        })
    }
}

/// The line of a record, whose position is that of the blank lines and comments before it.
fn line_of(bytes: &[u8], position: &csv::Position) -> u64 {
    let rest = &bytes[position.byte() as usize..];
    let skipped = rest
        .split(|&byte| byte == b'\n')
        .take_while(|line| matches!(line, [] | [b'\r'] | [b'#', ..]));
    position.line() + skipped.count() as u64
}

/// The options of a table.
fn settings(table: Table, folder: &Path) -> Result<Settings, String> {
    let mut settings = Settings::default();
    for (name, value) in table {
        let value = match value {
            Value::Array(values) => {
                let texts: Result<Vec<_>, _> = values.iter().map(|value| text(&name, value)).collect();
                texts?.join(",")
            }
            Value::Table(pairs) => {
                let texts: Result<Vec<_>, _> = pairs
                    .iter()
                    .map(|(key, value)| Ok(format!("{key}={}", text(&name, value)?)))
                    .collect::<Result<_, String>>();
                texts?.join(",")
            }
            single => text(&name, &single)?,
        };
        settings.set(&name, value, folder)?;
    }
    Ok(settings)
}

/// A single value as it would stand on the command line.
fn text(name: &str, value: &Value) -> Result<String, String> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Integer(number) => Ok(number.to_string()),
        Value::Float(number) => Ok(number.to_string()),
        Value::Boolean(flag) => Ok(flag.to_string()),
        other => Err(format!(
            "{name}: a text, number, true or false, or a list of them is needed, this is of type {}",
            other.type_str()
        )),
    }
}

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
