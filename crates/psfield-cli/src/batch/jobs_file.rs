//! Reads jobs files. The options of the jobs are not parsed here.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use toml::{Table, Value};

use crate::UsageError;
use crate::old_names;

/// The jobs of a file, with options that are not parsed yet.
#[derive(Debug)]
pub(super) struct JobsFile {
    pub(super) path: PathBuf,
    pub(super) defaults: Settings,
    /// The place of each job in the file (for messages), and its options.
    pub(super) jobs: Vec<(String, Settings)>,
}

impl JobsFile {
    /// Reads TOML or CSV, depending on the extension of the file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let is_toml = match extension.as_deref() {
            Some("toml") => true,
            Some("csv") => false,
            _ => {
                let what = format!("{}: a jobs file must end in .toml or .csv", path.display());
                return Err(UsageError(what).into());
            }
        };
        let text = match psf_types::read_text_file(path) {
            Err(error) if error.kind() == ErrorKind::InvalidData => {
                return Err(UsageError(format!("{}: {error}", path.display())).into());
            }
            read => read.with_context(|| format!("cannot read {}", path.display()))?,
        };
        let folder = path.parent().unwrap_or(Path::new(""));
        let parsed = if is_toml {
            Self::from_toml(&text, folder)
        } else {
            Self::from_csv(text.as_bytes(), folder)
        };
        let file = parsed.map_err(|what| UsageError(format!("{}: {what}", path.display())))?;
        if file.jobs.is_empty() {
            return Err(UsageError(format!("{}: the file has no job", path.display())).into());
        }
        Ok(Self {
            path: path.to_owned(),
            ..file
        })
    }

    /// Parses TOML: a table `[defaults]`, and a table `[[job]]` for each job.
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
                            return Err(format!("{place}: a job must be a table, [[job]]"));
                        };
                        let options = settings(options, folder).map_err(|what| format!("{place}: {what}"))?;
                        jobs.push((place, options));
                    }
                }
                ("defaults" | "job", _) => {
                    return Err(format!(
                        "{key}: write one table [defaults] and a table [[job]] for each job"
                    ));
                }
                _ => {
                    return Err(format!(
                        "{key}: only [defaults] and [[job]] are known, and options stand below one of them"
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

    /// Parses CSV: a line of option names, and a row for each job.
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
            let row = row.map_err(|e| match e.kind() {
                csv::ErrorKind::UnequalLengths {
                    pos: Some(at),
                    expected_len,
                    len,
                } => {
                    format!(
                        "line {}: {len} fields, but the line of option names has {expected_len}",
                        line_of(bytes, at)
                    )
                }
                _ => e.to_string(),
            })?;
            let line = row.position().map_or(0, |position| line_of(bytes, position));
            let place = format!("job {} (line {line})", k + 1);
            let mut options = Settings::default();
            for (name, value) in names.iter().zip(&row).filter(|(_, value)| !value.is_empty()) {
                options
                    .set(name, vec![value.to_owned()], folder)
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

/// Returns the line number of a record. `position` is the start of the record, or of the blank
/// lines and comments before the record.
fn line_of(bytes: &[u8], position: &csv::Position) -> u64 {
    let rest = &bytes[position.byte() as usize..];
    let skipped = rest
        .split(|&byte| byte == b'\n')
        .take_while(|line| matches!(line, [] | [b'\r'] | [b'#', ..]));
    position.line() + skipped.count() as u64
}

/// Converts a TOML table to options.
pub(crate) fn settings(table: Table, folder: &Path) -> Result<Settings, String> {
    let mut settings = Settings::default();
    for (name, value) in table {
        let value = match value {
            Value::Array(values) => {
                let texts = values.iter().map(|value| text(&name, value));
                texts.collect::<Result<_, _>>()?
            }
            Value::Table(pairs) => {
                let pair = |(key, value)| Ok(format!("{key}={}", text(&name, value)?));
                vec![
                    pairs
                        .iter()
                        .map(pair)
                        .collect::<Result<Vec<_>, String>>()?
                        .join(","),
                ]
            }
            single => vec![text(&name, &single)?],
        };
        settings.set(&name, value, folder)?;
    }
    Ok(settings)
}

/// Converts a value to the string of an argument.
fn text(name: &str, value: &Value) -> Result<String, String> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Integer(number) => Ok(number.to_string()),
        Value::Float(number) => Ok(number.to_string()),
        Value::Boolean(flag) => Ok(flag.to_string()),
        other => Err(format!(
            "{name}: expected a string, a number, true or false, or a list or table of them, found a value of type {}",
            other.type_str()
        )),
    }
}

/// Parses an option and its value for `--set`: `OPTION=VALUE`, or the name of a flag alone.
pub(super) fn assignment(text: &str) -> Result<(String, String), String> {
    let (option, value) = text.split_once('=').unwrap_or((text, "true"));
    if option.trim().is_empty() || value.is_empty() {
        return Err("an option and its value are needed, as in tolerance=1e-5".to_owned());
    }
    Ok((option.to_owned(), value.to_owned()))
}

/// The value of an option.
#[derive(Debug, Clone)]
pub(super) struct Setting {
    /// The values of a list in TOML, or one value.
    pub(super) list: Vec<String>,
    /// The folder to which a relative path refers.
    pub(super) folder: PathBuf,
}

impl Setting {
    /// The values, separated by commas.
    pub(super) fn value(&self) -> String {
        self.list.join(",")
    }
}

/// Options by name, without leading hyphens.
#[derive(Debug, Clone, Default)]
pub(crate) struct Settings(BTreeMap<String, Setting>);

impl Settings {
    /// Sets an option given on the command line.
    pub(super) fn add(&mut self, (option, value): (String, String)) -> Result<(), UsageError> {
        self.set(&option, vec![value], Path::new(""))
            .map_err(|what| UsageError(format!("--set: {what}")))
    }

    /// Sets an option. Returns an error if it is set already. Underscores in the name count as
    /// hyphens: `stamp_size` is `stamp-size`.
    pub(crate) fn set(&mut self, option: &str, list: Vec<String>, folder: &Path) -> Result<(), String> {
        let name = old_names::option("simulate", &option.trim().replace('_', "-"));
        let folder = folder.to_owned();
        match self.0.insert(name, Setting { list, folder }) {
            Some(_) => Err(format!("{option} is given twice")),
            None => Ok(()),
        }
    }

    /// Returns these options, completed by the options of `weaker` that are not set here.
    pub(super) fn or(mut self, weaker: &Self) -> Self {
        for (name, setting) in &weaker.0 {
            self.0.entry(name.clone()).or_insert_with(|| setting.clone());
        }
        self
    }

    pub(super) fn take(&mut self, name: &str) -> Option<Setting> {
        self.0.remove(name)
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub(super) fn get(&self, name: &str) -> Option<&Setting> {
        self.0.get(name)
    }

    /// Iterates in the order of the names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Setting)> {
        self.0.iter().map(|(name, setting)| (name.as_str(), setting))
    }
}
