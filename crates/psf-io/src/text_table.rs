//! Columns of numbers from text tables.

use std::path::{Path, PathBuf};

use csv::{ByteRecord, Position, ReaderBuilder, Trim};

use crate::number_columns::{Gaps, NumberColumns};
use crate::text_header::{Separator, TextHeader, blank_separated, lines};
use crate::{IoError, Row};

/// Column names and values quoted in errors are cut to this many characters.
const QUOTED: usize = 40;
/// Column names listed in errors.
const LISTED: usize = 20;
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A text table in memory whose columns have names.
#[derive(Debug)]
pub(crate) struct TextTable {
    path: PathBuf,
    text: Vec<u8>,
    header: TextHeader,
}

impl TextTable {
    /// Reads a file and finds its column names ([`TextHeader::of`]).
    pub(crate) fn open(path: &Path) -> Result<Self, IoError> {
        let mut text = std::fs::read(path).map_err(|source| IoError::Read {
            path: path.to_owned(),
            source,
        })?;
        if text.starts_with(BYTE_ORDER_MARK) {
            text.drain(..BYTE_ORDER_MARK.len());
        }
        Ok(Self {
            path: path.to_owned(),
            header: TextHeader::of(&text),
            text,
        })
    }

    /// The names of the columns; empty for those without.
    pub(crate) fn names(&self) -> &[String] {
        &self.header.names
    }

    /// Reads columns by name, upper and lower case being the same.
    pub(crate) fn read(&self, names: &[&str], gaps: Gaps) -> Result<NumberColumns, IoError> {
        let places = names.iter().map(|name| self.find(name));
        let places: Vec<usize> = places.collect::<Result<_, _>>()?;
        let mut columns = vec![Vec::new(); names.len()];
        let mut rows = Vec::new();
        self.for_each_row(|line, fields| {
            for ((column, &place), name) in columns.iter_mut().zip(&places).zip(names) {
                column.push(number(fields[place], gaps).ok_or_else(|| IoError::Value {
                    path: self.path.clone(),
                    row: Row::Line(line),
                    column: (*name).to_owned(),
                    got: shown(fields[place]),
                })?);
            }
            rows.push(line);
            Ok(())
        })?;
        Ok(NumberColumns::of_text(columns, rows))
    }

    /// Calls a function with the line of each row and its fields, of which there are as many as names.
    fn for_each_row(
        &self,
        mut function: impl FnMut(u64, &[&[u8]]) -> Result<(), IoError>,
    ) -> Result<(), IoError> {
        let rows = &self.text[self.header.rows_from..];
        let skipped = self.header.first_line - 1;
        let mut on_row = |line: u64, fields: &[&[u8]]| {
            if fields.len() == self.header.names.len() {
                return function(line, fields);
            }
            Err(IoError::RowLength {
                path: self.path.clone(),
                row: Row::Line(line),
                expected: self.header.names.len() as u64,
                got: fields.len() as u64,
            })
        };
        let Separator::Byte(separator) = self.header.separator else {
            for (number, start, end) in lines(rows) {
                if rows[start] != b'#' {
                    let fields: Vec<&[u8]> = blank_separated(&rows[start..end]).collect();
                    on_row(number + skipped, &fields)?;
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
        let failed = |source| IoError::Csv {
            path: self.path.clone(),
            source,
        };
        while reader.read_byte_record(&mut record).map_err(failed)? {
            let fields: Vec<&[u8]> = record.iter().collect();
            on_row(line_of(rows, record.position()) + skipped, &fields)?;
        }
        Ok(())
    }

    fn find(&self, name: &str) -> Result<usize, IoError> {
        let names = &self.header.names;
        let mut found = (0..names.len()).filter(|&i| names[i].eq_ignore_ascii_case(name));
        match (found.next(), found.next()) {
            (Some(place), None) => Ok(place),
            (None, _) => Err(IoError::MissingColumn {
                path: self.path.clone(),
                column: name.to_owned(),
                found: listed(names),
            }),
            (Some(_), Some(_)) => Err(IoError::AmbiguousColumn {
                path: self.path.clone(),
                column: name.to_owned(),
            }),
        }
    }
}

/// The number in a field, if there is one that is allowed.
fn number(field: &[u8], gaps: Gaps) -> Option<f64> {
    let number = match std::str::from_utf8(field) {
        Ok("") => Some(f64::NAN),
        Ok(text) => text.parse::<f64>().ok(),
        Err(_) => None,
    };
    number.filter(|number| gaps == Gaps::Kept || number.is_finite())
}

/// The line of a record: the parser's position is where it began to look for it, ahead of comments and empty lines.
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

/// Column names for errors: the first of those that are not empty.
pub(crate) fn listed<'a>(names: impl IntoIterator<Item = &'a String>) -> Vec<String> {
    let mut named = names.into_iter().filter(|name| !name.is_empty());
    let quoted = |name: &String| format!("{:?}", shown(name.as_bytes()));
    let mut list: Vec<String> = named.by_ref().take(LISTED).map(quoted).collect();
    match named.count() {
        0 => {}
        more => list.push(format!("and {more} more")),
    }
    list
}

fn shown(field: &[u8]) -> String {
    String::from_utf8_lossy(field).chars().take(QUOTED).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<Vec<Vec<f64>>, IoError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        TextTable::open(file.path())?
            .read(&["x", "y"], Gaps::Refused)
            .map(NumberColumns::into_values)
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
            match read(text.as_bytes()) {
                Err(IoError::Value {
                    row, column, got: g, ..
                }) => {
                    assert_eq!((row, column.as_str(), g.as_str()), (Row::Line(7), "y", got));
                }
                other => panic!("{other:?}"),
            }
        }
        let error = read(b"# two stars\n1,2\n").unwrap_err();
        assert!(error.to_string().contains("\"1\", \"2\""), "{error}");
        assert!(matches!(
            read(b"x,y,X\n1,2,3\n"),
            Err(IoError::AmbiguousColumn { .. })
        ));
        assert!(matches!(read(b""), Err(IoError::MissingColumn { .. })));
    }

    #[test]
    fn rows_of_another_length_are_refused() {
        for (text, line, length) in [("x,y\r\n1,2\r\n\r\n#c\r\n1,5,2\r\n", 5, 3), ("x,y\n1\n", 2, 1)] {
            match read(text.as_bytes()) {
                Err(IoError::RowLength {
                    row, expected, got, ..
                }) => {
                    assert_eq!((row, expected, got), (Row::Line(line), 2, length));
                }
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn names_stand_where_the_usual_programs_put_them() {
        let expected = vec![vec![1.0, 3.0], vec![2.0, 4.0]];
        for text in [
            // A line of names, and blanks or tabs.
            "x  y\n1 2\n\n# comment\n  3\t4 \n",
            "name\tx\ty\nM 31\t1\t2\n\t3\t4\n",
            // numpy.savetxt, TOPCAT, astropy's commented_header
            "# made by hand\n# x,y\n1,2\n3,4\n",
            "# x y\r\n1 2\r\n3 4\r\n",
            "#x y\n1 2\n3 4\n",
            // The last column of SExtractor's may be a vector.
            "# 1 X\n# 2 Y\n# 3 FLUX_APER\n1 2 7 8 9\n3 4 7 8 9\n",
            // Comments that begin with a number are none of it.
            "# 2916 stars of the field\nx,y\n1,2\n3,4\n",
            "# 1 star left out\n# x y\n1 2\n3 4\n",
            "# 1 star left out\nx y\n1 2\n3 4\n",
            "# 2 stars of the field\n# x y\n1 2\n3 4\n",
            // SExtractor's ASCII_HEAD; columns 2 and 3 are one vector
            "#   1 X          Object position along x      [pixel]\n#   2 FLUX_APER  Flux vector  [count]\n\
             #   4 Y          Object position along y  [pixel]\n    1.0  9 9  2.0\n    3.0  9 9   4.0\n",
        ] {
            assert_eq!(read(text.as_bytes()).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn blanks_keep_count_of_lines_and_fields() {
        for (text, line, expected, length) in [
            ("# x y\n1 2\n\n3\n", 4, 2, 1),
            ("x y\n1 2 3\n", 2, 2, 3),
            ("# 1 X\n# 2 Y\n1 2\n1 2 3\n", 4, 2, 3),
            ("# 1 X\n# 2 Y\n1 2 7\n1 2\n", 4, 3, 2),
        ] {
            match read(text.as_bytes()) {
                Err(IoError::RowLength {
                    row,
                    expected: e,
                    got,
                    ..
                }) => {
                    assert_eq!((row, e, got), (Row::Line(line), expected, length), "{text}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
        match read(b"# x y\n1 2\n3 a\n") {
            Err(IoError::Value { row, got, .. }) => assert_eq!((row, got.as_str()), (Row::Line(3), "a")),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn columns_without_a_name_are_not_listed() {
        let error = read(b"# 1 A\n# 9 B\n1 2 3 4 5 6 7 8 9\n").unwrap_err();
        assert!(
            matches!(&error, IoError::MissingColumn { found, .. } if *found == ["\"A\"", "\"B\""]),
            "{error}"
        );
        assert_eq!(read(b"# 1 X\n# 2 Y\n").unwrap(), [[0.0; 0]; 2]);
        let names: Vec<String> = (0..300).map(|k| k.to_string()).collect();
        let list = listed(&names);
        assert_eq!((list.len(), list[LISTED].as_str()), (LISTED + 1, "and 280 more"));
    }

    #[test]
    fn gaps_are_nan_where_allowed() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "x,y\n1,\nnan,4\ninf,5\n").unwrap();
        let table = TextTable::open(file.path()).unwrap();
        let read = table.read(&["x", "y"], Gaps::Kept).unwrap();
        assert_eq!((read.rows(), read.place(1)), (3, Row::Line(3)));
        assert!(
            read.values()[1][0].is_nan() && read.values()[0][1].is_nan() && read.values()[0][2].is_infinite()
        );
        std::fs::write(file.path(), "x,y\n1,2px\n").unwrap();
        let table = TextTable::open(file.path()).unwrap();
        assert!(matches!(
            table.read(&["x", "y"], Gaps::Kept),
            Err(IoError::Value { .. })
        ));
    }
}
