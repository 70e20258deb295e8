//! Reads columns of numbers from text tables.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use csv::{ByteRecord, Position, ReaderBuilder, Trim};

use crate::catalogue::ecsv;
use crate::error::{IoError, IoErrorKind, Place, Row, unreadable};
use crate::fits::columns::{Nans, NumberColumns, bad_value, find, shown};

pub(super) const NOT_CSV: &str = "this is not a well-formed CSV table";
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A text table in memory with named columns.
#[derive(Debug)]
pub(crate) struct TextTable {
    path: PathBuf,
    text: Vec<u8>,
    /// The names of the columns. A column without a name has an empty string.
    pub(crate) names: Vec<String>,
    separator: Separator,
    /// The position of the first byte of the rows.
    rows_from: usize,
    /// The line number of this byte, counted from 1.
    first_line: u64,
}

impl TextTable {
    /// Reads a file and finds its column names.
    ///
    /// If the comments are lines `# number NAME ...`, as SExtractor writes them, they give the
    /// names. Otherwise the first line that is not a comment (`#`) gives them. If that line holds
    /// only numbers, the last comment before it gives them, provided that it has the same number of
    /// fields.
    ///
    /// The first line that is not a comment decides how fields are separated: by commas if it has
    /// one, else by tabs if it has one, else by blanks.
    pub(crate) fn open(path: &Path) -> Result<Self, IoError> {
        let mut text = std::fs::read(path).map_err(unreadable(path))?;
        if text.starts_with(BYTE_ORDER_MARK) {
            text.drain(..BYTE_ORDER_MARK.len());
        }
        // Old spreadsheets end lines in a carriage return alone.
        if !text.contains(&b'\n') {
            for byte in text.iter_mut().filter(|byte| **byte == b'\r') {
                *byte = b'\n';
            }
        }
        let mut comments = Vec::new();
        let mut first = (text.len(), text.len(), 1);
        for (number, start, end) in lines(&text) {
            let Some(comment) = text[start..end].strip_prefix(b"#") else {
                first = (start, end, number);
                break;
            };
            comments.push(comment);
        }
        let (start, end, number) = first;
        let line = &text[start..end];
        let separator = [b',', b'\t']
            .into_iter()
            .find(|separator| line.contains(separator))
            .map_or(Separator::Blanks, Separator::Byte);
        let fields = separator.fields(line);
        let in_comment = || {
            let is_row = !fields.is_empty() && fields.iter().all(|field| is_number(field.as_bytes()));
            let names = separator.fields(comments.last().filter(|_| is_row)?);
            (names.len() == fields.len()).then_some(names)
        };
        let (names, separator, rows_from, first_line) =
            match (sextractor_names(&comments, line), in_comment()) {
                (Some(names), _) => (names, Separator::Blanks, start, number),
                (None, Some(names)) => (names, separator, start, number),
                (None, None) => {
                    // Blanks may follow the names.
                    let rest = text[end..].iter().position(|&byte| byte == b'\n');
                    let next = rest.map_or(text.len(), |length| end + length + 1);
                    (fields, separator, next, number + 1)
                }
            };
        Ok(Self {
            path: path.to_owned(),
            names,
            separator,
            rows_from,
            first_line,
            text,
        })
    }

    /// Returns this table with its first line as a row, if this line holds numbers instead of names.
    /// The columns are then named by their numbers.
    pub(crate) fn with_first_row(mut self) -> Self {
        if !self.names.is_empty() && self.names.iter().all(|name| is_number(name.as_bytes())) {
            let before = self.text[..self.rows_from].trim_ascii_end();
            self.rows_from = before
                .iter()
                .rposition(|&byte| byte == b'\n')
                .map_or(0, |end| end + 1);
            self.first_line -= 1;
            self.names = (1..=self.names.len())
                .map(|number| format!("column {number}"))
                .collect();
        }
        self
    }

    /// The unit of a column, as the header of an ECSV file or the comments of SExtractor state it. Empty if
    /// they do not.
    pub(crate) fn unit(&self, name: &str) -> Result<String, IoError> {
        let before = &self.text[..self.rows_from];
        let comments: Vec<&[u8]> = lines(before)
            .map_while(|(_, start, end)| before[start..end].strip_prefix(b"#"))
            .collect();
        // Case is ignored, unless it decides between several columns.
        let pick = |units: Vec<(String, String)>| {
            let exact = units.iter().find(|(column, _)| column == name);
            let any = || units.iter().find(|(column, _)| column.eq_ignore_ascii_case(name));
            exact
                .or_else(any)
                .map_or_else(String::new, |(_, unit)| unit.clone())
        };
        if let Some(columns) = ecsv::units(&comments) {
            let columns = columns.map_err(|why| {
                let problem = format!("the header of this ECSV file is not valid: {why}");
                IoError::new(&self.path, IoErrorKind::Table, problem)
            })?;
            return Ok(pick(columns));
        }
        Ok(pick(comments.into_iter().filter_map(sextractor_unit).collect()))
    }

    /// The error for a choice among the tables of this file.
    pub(crate) fn has_no_hdus(&self) -> IoError {
        const TEXT: &str = "a text file holds only one table: a table can be chosen only in a FITS file";
        IoError::new(&self.path, IoErrorKind::Setting, TEXT).with_setting("table")
    }

    /// Reads the columns with these names. Case is ignored.
    pub(crate) fn read(&self, names: &[&str], nans: Nans) -> Result<NumberColumns, IoError> {
        let places = names.iter().map(|name| find(&self.path, self.names.iter(), name));
        let places: Vec<usize> = places.collect::<Result<_, _>>()?;
        self.check_comments(&places)?;
        let mut columns = vec![Vec::new(); names.len()];
        let mut rows = Vec::new();
        self.for_each_row(|line, fields| {
            for ((column, &place), name) in columns.iter_mut().zip(&places).zip(names) {
                let bad = || bad_value(&self.path, Row::Line(line), name, &shown(fields[place]));
                column.push(number(fields[place], nans).ok_or_else(bad)?);
            }
            rows.push(line);
            Ok(())
        })?;
        Ok(NumberColumns {
            values: columns,
            rows: rows.len(),
            lines: Some(rows),
        })
    }

    /// Reads a column of texts. Case is ignored in its name.
    pub(crate) fn read_texts(&self, name: &str) -> Result<Vec<String>, IoError> {
        let place = find(&self.path, self.names.iter(), name)?;
        let mut texts = Vec::new();
        self.for_each_row(|_, fields| {
            texts.push(String::from_utf8_lossy(fields[place]).trim().to_owned());
            Ok(())
        })?;
        Ok(texts)
    }

    /// Returns an error for a comment that may be a row. Such a comment has as many fields as a row, and
    /// numbers in the columns at `places`. If the first column holds numbers, no row begins with `#`.
    fn check_comments(&self, places: &[usize]) -> Result<(), IoError> {
        if places.is_empty() || places.contains(&0) {
            return Ok(());
        }
        let rows = &self.text[self.rows_from..];
        for (number, start, end) in lines(rows).filter(|&(_, start, _)| rows[start] == b'#') {
            let fields = self.separator.fields(&rows[start..end]);
            if fields.len() == self.names.len()
                && places.iter().all(|&place| is_number(fields[place].as_bytes()))
            {
                const AMBIGUOUS: &str = "the line begins with # as a comment does, but looks like a row: put its first field in double \
                     quotes, or remove the line";
                let line = Row::Line(number + self.first_line - 1);
                return Err(IoError::new(&self.path, IoErrorKind::Table, AMBIGUOUS).at(Place::Row(line)));
            }
        }
        Ok(())
    }

    /// Calls a function with the line number and the fields of each row. A row must have as many
    /// fields as there are column names.
    fn for_each_row(
        &self,
        mut function: impl FnMut(u64, &[&[u8]]) -> Result<(), IoError>,
    ) -> Result<(), IoError> {
        let rows = &self.text[self.rows_from..];
        let skipped = self.first_line - 1;
        let mut on_row = |line: u64, fields: &[&[u8]]| {
            // The last tab of a line separates nothing.
            let fields = match (&self.separator, fields) {
                (Separator::Byte(b'\t'), [rest @ .., b""]) if rest.len() == self.names.len() => rest,
                _ => fields,
            };
            if fields.len() == self.names.len() {
                return function(line, fields);
            }
            let (expected, got) = (self.names.len(), fields.len());
            let problem = format!("the row has {got} fields, but there are {expected} column names");
            Err(IoError::new(&self.path, IoErrorKind::Table, problem).at(Place::Row(Row::Line(line))))
        };
        let Separator::Byte(separator) = self.separator else {
            for (number, start, end) in lines(rows).filter(|&(_, start, _)| rows[start] != b'#') {
                let line = &rows[start..end];
                if line.contains(&b'"') {
                    let fields = quoted_fields(line).ok_or_else(|| {
                        const OPEN: &str = "a field begins with a double quote, but does not end with one";
                        let place = Place::Row(Row::Line(number + skipped));
                        IoError::new(&self.path, IoErrorKind::Table, OPEN).at(place)
                    })?;
                    on_row(number + skipped, &fields.iter().map(|f| &**f).collect::<Vec<_>>())?;
                } else {
                    on_row(number + skipped, &blank_separated(line).collect::<Vec<_>>())?;
                }
            }
            return Ok(());
        };
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(separator)
            .comment(Some(b'#'))
            .trim(Trim::All)
            .from_reader(rows);
        let mut record = ByteRecord::new();
        let failed =
            |source: csv::Error| IoError::new(&self.path, IoErrorKind::Table, NOT_CSV).because(source);
        while reader.read_byte_record(&mut record).map_err(failed)? {
            let fields: Vec<&[u8]> = record.iter().collect();
            // A line of blanks.
            if fields == [b""] && self.names.len() > 1 {
                continue;
            }
            on_row(line_of(rows, record.position()) + skipped, &fields)?;
        }
        Ok(())
    }
}

/// The number in a field, NaN if the field is empty. Returns `None` if the field is not a number,
/// or if `nans` does not allow the number.
fn number(field: &[u8], nans: Nans) -> Option<f64> {
    let number = match std::str::from_utf8(field) {
        Ok("") => Some(f64::NAN),
        Ok(text) => text.parse::<f64>().ok().or_else(|| fortran_number(text)),
        Err(_) => None,
    };
    number.filter(|number| nans == Nans::Kept || number.is_finite())
}

/// A number whose exponent begins with D, as Fortran writes it: `1.0D+01`.
fn fortran_number(text: &str) -> Option<f64> {
    let (digits, exponent) = text.split_once(['D', 'd'])?;
    let is_of = |part: &str, others: &[u8]| {
        let allowed = |byte: u8| byte.is_ascii_digit() || others.contains(&byte);
        !part.is_empty() && part.bytes().all(allowed)
    };
    let fits = is_of(digits, b"+-.") && is_of(exponent, b"+-");
    fits.then(|| format!("{digits}e{exponent}").parse().ok())
        .flatten()
}

/// Returns whether a field that is not empty is a number.
fn is_number(field: &[u8]) -> bool {
    !field.is_empty() && number(field, Nans::Kept).is_some()
}

/// The line number of a record, counted from 1. The parser's position is before any comments and
/// empty lines that precede the record, so these lines are added.
fn line_of(text: &[u8], position: Option<&Position>) -> u64 {
    let (start, line) = position.map_or((0, 1), |position| (position.byte(), position.line()));
    let rest = usize::try_from(start)
        .ok()
        .and_then(|start| text.get(start..))
        .unwrap_or_default();
    let skipped = rest
        .split(|&byte| byte == b'\n')
        .take_while(|line| line.starts_with(b"#") || line.is_empty() || *line == b"\r")
        .count();
    line + skipped as u64
}

/// The highest column number that SExtractor's comments may give if the table has no rows.
const MOST_WITHOUT_ROWS: usize = 10_000;

/// The separator between the fields of a text table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Separator {
    /// A comma or a tab. Fields may be quoted.
    Byte(u8),
    /// One or more blanks. Fields may be quoted.
    Blanks,
}

impl Separator {
    /// Returns the trimmed fields of a line.
    fn fields(self, line: &[u8]) -> Vec<String> {
        let owned = |field: &[u8]| String::from_utf8_lossy(field).into_owned();
        match self {
            Self::Blanks => match quoted_fields(line) {
                Some(fields) => fields.iter().map(|field| owned(field)).collect(),
                None => blank_separated(line).map(owned).collect(),
            },
            Self::Byte(separator) => {
                let mut reader = ReaderBuilder::new()
                    .has_headers(false)
                    .delimiter(separator)
                    .trim(Trim::All)
                    .from_reader(line);
                let record = reader
                    .byte_records()
                    .next()
                    .and_then(Result::ok)
                    .unwrap_or_default();
                record.iter().map(owned).collect()
            }
        }
    }
}

/// Returns the fields of a line that are separated by blanks.
fn blank_separated(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|field| !field.is_empty())
}

/// Returns the fields of a line that are separated by blanks, where a field in double quotes may hold
/// blanks, or nothing. Two double quotes in such a field stand for one. Returns `None` if a quote is not
/// closed at the end of its field.
fn quoted_fields(line: &[u8]) -> Option<Vec<Cow<'_, [u8]>>> {
    let mut fields = Vec::new();
    let mut rest = line.trim_ascii();
    while !rest.is_empty() {
        let length = if let Some(inside) = rest.strip_prefix(b"\"") {
            let (mut text, mut from) = (Cow::Borrowed(&b""[..]), 0);
            loop {
                let end = from + inside[from..].iter().position(|&byte| byte == b'"')?;
                match text {
                    Cow::Borrowed(_) => text = Cow::Borrowed(&inside[..end]),
                    Cow::Owned(ref mut text) => text.extend(&inside[from..end]),
                }
                if inside.get(end + 1) != Some(&b'"') {
                    fields.push(text);
                    break end + 2;
                }
                text.to_mut().push(b'"');
                from = end + 2;
            }
        } else {
            let end = rest.iter().position(u8::is_ascii_whitespace);
            let length = end.unwrap_or(rest.len());
            fields.push(Cow::Borrowed(&rest[..length]));
            length
        };
        let after = &rest[length..];
        rest = after.trim_ascii_start();
        if rest.len() == after.len() && !rest.is_empty() {
            return None;
        }
    }
    Some(fields)
}

/// The lines that are not empty: number counted from 1, position of the first byte, and position
/// after the last byte, without the line break.
fn lines(text: &[u8]) -> impl Iterator<Item = (u64, usize, usize)> {
    let mut start = 0;
    text.split(|&byte| byte == b'\n')
        .zip(1..)
        .filter_map(move |(line, number)| {
            let first = start;
            start += line.len() + 1;
            (!line.trim_ascii().is_empty()).then(|| (number, first, first + line.trim_ascii_end().len()))
        })
}

/// The names in lines `# number NAME ...`, one for each field of the first row. A column that no
/// line names belongs to a vector and has no name.
///
/// Other comments may begin with a number too. So the column numbers must start at 1 and increase
/// up to the last comment. The row must hold only numbers, and at least as many as the last column
/// number.
fn sextractor_names(comments: &[&[u8]], row: &[u8]) -> Option<Vec<String>> {
    let fields: Vec<&[u8]> = blank_separated(row).collect();
    if !fields.iter().all(|field| is_number(field)) {
        return None;
    }
    let of_column = |comment: &&[u8]| {
        let mut parts = blank_separated(comment);
        let number: usize = std::str::from_utf8(parts.next()?).ok()?.parse().ok()?;
        Some((number, String::from_utf8_lossy(parts.next()?).into_owned()))
    };
    of_column(comments.last()?)?;
    let columns: Vec<(usize, String)> = comments.iter().filter_map(of_column).collect();
    let rises = columns.windows(2).all(|pair| pair[0].0 < pair[1].0);
    let last = columns[columns.len() - 1].0;
    // A catalogue may have no rows.
    let most = if row.is_empty() {
        MOST_WITHOUT_ROWS
    } else {
        fields.len()
    };
    if columns[0].0 != 1 || !rises || last > most {
        return None;
    }
    let mut names = vec![String::new(); last.max(fields.len())];
    for (number, name) in columns {
        names[number - 1] = name;
    }
    Some(names)
}

/// The name and the unit in a comment `number NAME description [unit]` of SExtractor.
fn sextractor_unit(comment: &[u8]) -> Option<(String, String)> {
    let text = String::from_utf8_lossy(comment);
    let mut parts = text.split_whitespace();
    parts.next()?.parse::<usize>().ok()?;
    let name = parts.next()?.to_owned();
    let (_, unit) = text.trim_end().strip_suffix(']')?.rsplit_once('[')?;
    Some((name, unit.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<Vec<Vec<f64>>, IoError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        TextTable::open(file.path())?
            .read(&["x", "y"], Nans::Refused)
            .map(|columns| columns.values)
    }

    fn value_at(line: u64, column: &str) -> Place {
        let (row, column) = (Row::Line(line), column.to_owned());
        Place::Value { row, column }
    }

    fn assert_row_length(text: &str, line: u64, expected: usize, got: usize) {
        let error = read(text.as_bytes()).unwrap_err();
        let problem =
            format!(": line {line}: the row has {got} fields, but there are {expected} column names");
        assert!(error.to_string().ends_with(&problem), "{text}: {error}");
    }

    #[test]
    fn comments_case_order_and_other_columns_do_not_matter() {
        let text =
            b"\xef\xbb\xbf# made by hand\n name , Y, X\r\n\"M 31, \xe9\", 2.5 ,1e3\r\n\n# more\nb,-0,.5";
        assert_eq!(read(text).unwrap(), vec![vec![1e3, 0.5], vec![2.5, -0.0]]);
        assert_eq!(read(b"x,y\n").unwrap(), vec![vec![0.0; 0]; 2]);
    }

    #[test]
    fn errors_name_line_and_column() {
        for (bad, got) in [
            ("nan", "nan"),
            ("1e999", "1e999"),
            ("", ""),
            ("12px", "12px"),
            ("-inf", "-inf"),
        ] {
            let text = format!("# a comment\nx,y\n1,2\n\n# another\n# and more\n3,{bad}\n");
            let error = read(text.as_bytes()).unwrap_err();
            assert_eq!(error.place(), Some(&value_at(7, "y")));
            assert!(error.to_string().ends_with(&format!("got {got:?}")), "{error}");
        }
        let error = read(b"# two stars\n1,2\n").unwrap_err();
        assert!(error.to_string().contains("\"1\", \"2\""), "{error}");
        let error = read(b"x,y,x\n1,2,3\n").unwrap_err();
        assert!(
            error
                .to_string()
                .contains("column \"x\": the column exists more than once"),
            "{error}"
        );
        // Case decides between two columns.
        assert_eq!(read(b"x,y,X\n1,2,3\n").unwrap(), [[1.0], [2.0]]);
        let error = read(b"").unwrap_err();
        assert_eq!(error.place(), Some(&Place::Column("x".to_owned())));
    }

    #[test]
    fn rows_of_another_length_are_refused() {
        for (text, line, length) in [("x,y\r\n1,2\r\n\r\n#c\r\n1,5,2\r\n", 5, 3), ("x,y\n1\n", 2, 1)] {
            assert_row_length(text, line, 2, length);
        }
    }

    #[test]
    fn names_are_found_where_common_programs_write_them() {
        let expected = vec![vec![1.0, 3.0], vec![2.0, 4.0]];
        for text in [
            // A line of names, with blanks or tabs.
            "x  y\n1 2\n\n# comment\n  3\t4 \n",
            "name\tx\ty\nM 31\t1\t2\n\t3\t4\n",
            // numpy.savetxt, TOPCAT, astropy's commented_header
            "# made by hand\n# x,y\n1,2\n3,4\n",
            "# x y\r\n1 2\r\n3 4\r\n",
            "#x y\n1 2\n3 4\n",
            // The last column of SExtractor may be a vector.
            "# 1 X\n# 2 Y\n# 3 FLUX_APER\n1 2 7 8 9\n3 4 7 8 9\n",
            // Comments that begin with a number are not column names.
            "# 2916 stars of the field\nx,y\n1,2\n3,4\n",
            "# 1 star left out\n# x y\n1 2\n3 4\n",
            "# 1 star left out\nx y\n1 2\n3 4\n",
            "# 2 stars of the field\n# x y\n1 2\n3 4\n",
            // SExtractor's ASCII_HEAD. Columns 2 and 3 are one vector.
            "#   1 X          Object position along x      [pixel]\n#   2 FLUX_APER  Flux vector  [count]\n\
             #   4 Y          Object position along y  [pixel]\n    1.0  9 9  2.0\n    3.0  9 9   4.0\n",
        ] {
            assert_eq!(read(text.as_bytes()).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn errors_of_blank_separated_tables_name_line_and_fields() {
        for (text, line, expected, length) in [
            ("# x y\n1 2\n\n3\n", 4, 2, 1),
            ("x y\n1 2 3\n", 2, 2, 3),
            ("# 1 X\n# 2 Y\n1 2\n1 2 3\n", 4, 2, 3),
            ("# 1 X\n# 2 Y\n1 2 7\n1 2\n", 4, 3, 2),
        ] {
            assert_row_length(text, line, expected, length);
        }
        let error = read(b"# x y\n1 2\n3 a\n").unwrap_err();
        assert_eq!(error.place(), Some(&value_at(3, "y")));
        assert!(error.to_string().ends_with("got \"a\""), "{error}");
    }

    #[test]
    fn columns_without_a_name_are_not_listed() {
        let error = read(b"# 1 A\n# 9 B\n1 2 3 4 5 6 7 8 9\n").unwrap_err();
        assert!(
            error.to_string().ends_with("The columns are \"A\", \"B\""),
            "{error}"
        );
        assert_eq!(read(b"# 1 X\n# 2 Y\n").unwrap(), [[0.0; 0]; 2]);
    }

    #[test]
    fn fields_separated_by_blanks_may_be_quoted() {
        let text = "\"my name\" x y\n\"M 31\" 1 2\n\"a \"\"b\"\" c\" 3 \"4\"\nd 5 6\n";
        assert_eq!(read(text.as_bytes()).unwrap(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let table = TextTable::open(file.path()).unwrap();
        assert_eq!(table.read_texts("my name").unwrap(), ["M 31", "a \"b\" c", "d"]);
        // Astropy writes a masked value as an empty string in quotes.
        std::fs::write(file.path(), "x y\n1 \"\"\n\"\" 2\n").unwrap();
        let table = TextTable::open(file.path()).unwrap();
        let columns = table.read(&["x", "y"], Nans::Kept).unwrap().values;
        assert!(columns[1][0].is_nan() && columns[0][1].is_nan() && columns[1][1] == 2.0);
        for text in ["x y\n1 2\n\"3 4\n", "x y\n1 2\n\"3\"4 5\n"] {
            let error = read(text.as_bytes()).unwrap_err();
            assert_eq!(error.place(), Some(&Place::Row(Row::Line(3))), "{error}");
        }
    }

    #[test]
    fn blanks_at_the_end_of_lines_do_not_matter() {
        let expected = [[1.0, 3.0], [2.0, 4.0]];
        for text in [
            "x,y \n1,2\n3,4\n",
            "x,y\t\r\n1,2\r\n3,4\r\n",
            "x,y\r\r\n1,2\n3,4\n",
            "x,y\n1,2 \n3,4\n   \n",
            "x,y\n1,2\n \t\n3,4\n\t ",
            "x\ty\n1\t2\n3\t4\n   ",
            "x\ty\t\n1\t2\t\n3\t4\t\n",
            "x y  \n1 2\n3 4\n   ",
        ] {
            assert_eq!(read(text.as_bytes()).unwrap(), expected, "{text:?}");
        }
        let error = read(b"x,y \n1,2\n3,a\n").unwrap_err();
        assert_eq!(error.place(), Some(&value_at(3, "y")));
    }

    #[test]
    fn rows_that_begin_with_a_hash_do_not_vanish() {
        for text in [
            "name,x,y\na,1,2\n#1,3,4\n",
            "name x y\na 1 2\n#1 3 4\n",
            "name\tx\ty\na\t1\t2\n#1\t3\t4\n",
        ] {
            let error = read(text.as_bytes()).unwrap_err();
            assert_eq!(error.place(), Some(&Place::Row(Row::Line(3))), "{error}");
            assert!(error.to_string().contains("looks like a row"), "{error}");
        }
        for text in [
            "name,x,y\na,1,2\n\"#1\",3,4\n",
            "name,x,y\na,1,2\n# a comment, with, commas\nb,3,4\n",
            "name x y\na 1 2\n# three words here\n\"#1\" 3 4\n",
            // A column of numbers comes first, so this is a comment.
            "x,y,name\n1,2,a\n#5,6,c\n3,4,b\n",
        ] {
            assert_eq!(read(text.as_bytes()).unwrap(), [[1.0, 3.0], [2.0, 4.0]], "{text}");
        }
    }

    #[test]
    fn exponents_may_be_those_of_fortran() {
        let text = b"x,y\n1.0D+01,-2d-1\n.5D2,1D0\n";
        assert_eq!(read(text).unwrap(), [[10.0, 50.0], [-0.2, 1.0]]);
        for bad in ["D1", "1D", "infD1", "1D1D1", "0x1D1"] {
            assert!(read(format!("x,y\n1,{bad}\n").as_bytes()).is_err(), "{bad}");
        }
    }

    #[test]
    fn missing_values_are_nan_where_allowed() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "x,y\n1,\nnan,4\ninf,5\n").unwrap();
        let table = TextTable::open(file.path()).unwrap();
        let read = table.read(&["x", "y"], Nans::Kept).unwrap();
        assert_eq!((read.rows, read.place(1)), (3, Row::Line(3)));
        assert!(read.values[1][0].is_nan() && read.values[0][1].is_nan() && read.values[0][2].is_infinite());
        std::fs::write(file.path(), "x,y\n1,2px\n").unwrap();
        let table = TextTable::open(file.path()).unwrap();
        let error = table.read(&["x", "y"], Nans::Kept).unwrap_err();
        assert_eq!(
            (error.kind(), error.place()),
            (IoErrorKind::Data, Some(&value_at(2, "y")))
        );
    }
}
