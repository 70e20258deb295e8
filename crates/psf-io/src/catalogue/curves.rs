//! Tables of a curve over the wavelength: bandpasses and spectra.

use std::path::Path;

use crate::catalogue::table_file::{AnyTable, TableFile};
use crate::error::{IoError, IoErrorKind, Place};
use crate::fits::columns::Nans;
use crate::units::{in_unit, wavelength_in_um};

/// Reads a table whose first column is the wavelength and whose second column is a value: a bandpass
/// or a spectrum. Returns the wavelengths in micrometres and the values.
///
/// The file is a text table (CSV, ECSV or separated by blanks; a line of names and comments with `#`
/// are optional) or the only table of a FITS file with two columns or more. `unit` is the unit of the
/// wavelengths: `um`, `nm`, `Angstrom`, `mm` or `m`. If the curve is the `only` one, further columns are an
/// error, except those of errors and flags. Without a unit, the file must state the unit: as
/// `TUNIT` in FITS, as `unit` in ECSV, or in the name of the column (`wavelength_nm`).
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("filter.csv");
/// std::fs::write(&path, "wavelength_nm,throughput\n500,0\n600,0.8\n")?;
/// let (wavelengths_um, throughput) = psf_io::read_curve(&path, None, true)?;
/// assert_eq!((wavelengths_um[1], throughput[1]), (0.6, 0.8));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Setting`] for an unknown unit, or if none is stated. [`IoErrorKind::Table`] for
/// fewer than two columns, or for several curves where there should be one. The errors of
/// [`read_catalog`](crate::read_catalog).
pub fn read_curve(
    path: impl AsRef<Path>,
    unit: Option<&str>,
    only: bool,
) -> Result<(Vec<f64>, Vec<f64>), IoError> {
    const UNITS: &str = "um, nm, Angstrom, mm or m; on the command line and in Python behind the name of the file, as in filter.txt:nm";
    let path = path.as_ref();
    let file = match TableFile::open(path)? {
        TableFile::Text(table) => TableFile::Text(table.with_first_row()),
        fits @ TableFile::Fits(_) => fits,
    };
    let ([wavelength, value], table) = file.pick(None, "wavelength and a value", |names| {
        if let [wavelength, value, others @ ..] = names {
            if let (true, [_, ..]) = (only, &further_curves(others)[..]) {
                let curves = [&[value.as_str()], &further_curves(others)[..]]
                    .concat()
                    .join(", ");
                let problem =
                    format!("the table has several curves ({curves}): keep the wavelengths and one of them");
                return Err(IoError::new(path, IoErrorKind::Table, problem));
            }
            return Ok([wavelength.clone(), value.clone()]);
        }
        let problem = format!(
            "a wavelength and a value are needed, but there are {} columns",
            names.len()
        );
        Err(IoError::new(path, IoErrorKind::Table, problem))
    })?;
    let stated = match unit {
        Some(unit) => unit.to_owned(),
        None => unit_of(&table, &wavelength)?,
    };
    let factor = wavelength_in_um(&stated).ok_or_else(|| {
        let problem = match stated.as_str() {
            "" => format!("the file does not state the unit of its wavelengths: give it ({UNITS})"),
            other => format!("{other:?} is not a unit of wavelengths: give {UNITS}"),
        };
        IoError::new(path, IoErrorKind::Setting, problem).at(Place::Column(wavelength.clone()))
    })?;
    let mut columns = table.read(&[&wavelength, &value], Nans::Refused)?.values;
    let values = columns.pop().expect("two columns");
    let mut wavelengths = columns.pop().expect("two columns");
    for wavelength in &mut wavelengths {
        *wavelength = in_unit(*wavelength, factor);
    }
    Ok((wavelengths, values))
}

/// Returns whether a text is a unit of wavelengths, in upper or lower case.
pub fn is_wavelength_unit(unit: &str) -> bool {
    wavelength_in_um(unit).is_some()
}

/// The columns that are curves, and not the errors or flags of one.
fn further_curves(names: &[String]) -> Vec<&str> {
    const OTHERS: [&str; 8] = ["err", "unc", "sig", "std", "flag", "weight", "mask", "note"];
    let is_curve = |name: &&String| {
        let lower = name.to_ascii_lowercase();
        !lower.is_empty() && !OTHERS.iter().any(|part| lower.contains(part))
    };
    names.iter().filter(is_curve).map(String::as_str).collect()
}

/// The unit of a column of wavelengths that a file states. Empty if it states none.
fn unit_of(table: &AnyTable<'_>, column: &str) -> Result<String, IoError> {
    let stated = table.unit(column)?;
    if !stated.is_empty() {
        return Ok(stated);
    }
    let mut parts = column.split(|c: char| !c.is_alphanumeric()).skip(1);
    Ok(parts
        .find(|part| wavelength_in_um(part).is_some())
        .unwrap_or_default()
        .to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, unit: Option<&str>) -> Result<(Vec<f64>, Vec<f64>), IoError> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("curve.txt");
        std::fs::write(&path, text).unwrap();
        read_curve(&path, unit, false)
    }

    #[test]
    fn text_tables_of_every_kind_are_read() {
        let expected = (vec![0.5, 0.6], vec![0.25, 1.0]);
        let ecsv = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: w, unit: Angstrom, datatype: float64}\n\
                    # - {name: t, datatype: float64}\nw t\n5000 0.25\n6000 1\n";
        for (text, unit) in [
            ("5000 0.25\n6000 1.0\n", Some("Angstrom")),
            ("# a filter\n  500.0\t0.25\n600\t1\n", Some("nm")),
            ("wave_um,throughput\n0.5,0.25\n0.6,1\n", None),
            ("wavelength [nm],t,error\n500,0.25,0\n600,1,0\n", None),
            (ecsv, None),
        ] {
            assert_eq!(read(text, unit).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn curves_without_a_unit_or_a_value_are_refused() {
        for (text, unit, part) in [
            ("500 0.25\n600 1\n", None, "does not state the unit"),
            ("w,t\n500,0.25\n", None, "does not state the unit"),
            ("500 0.25\n600 1\n", Some("Hz"), "not a unit of wavelengths"),
            ("500\n600\n", Some("nm"), "1 columns"),
            ("500 0.25\n600 x\n", Some("nm"), "line 2"),
            ("500 0.25\n600 nan\n", Some("nm"), "line 2"),
        ] {
            let message = read(text, unit).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
