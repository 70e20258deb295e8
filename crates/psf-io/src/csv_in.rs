//! Columns of numbers from text tables.

use std::path::Path;

use csv::{ByteRecord, ErrorKind, Position, ReaderBuilder, Trim};

use crate::{IoError, Row};

/// Column names and values quoted in errors are cut to this many characters.
const QUOTED: usize = 40;
/// Column names listed in errors.
const LISTED: usize = 20;

/// Reads columns of finite numbers by name, upper and lower case being the same.
pub(crate) fn read_csv_columns<const N: usize>(
    path: &Path,
    names: [&str; N],
) -> Result<[Vec<f64>; N], IoError> {
    let text = std::fs::read(path).map_err(|source| IoError::Read {
        path: path.to_owned(),
        source,
    })?;
    let failed = |source: csv::Error| match source.kind() {
        ErrorKind::UnequalLengths {
            pos,
            expected_len,
            len,
        } => IoError::RowLength {
            path: path.to_owned(),
            row: row_at(&text, pos.as_ref()),
            expected: *expected_len,
            got: *len,
        },
        _ => IoError::Csv {
            path: path.to_owned(),
            source,
        },
    };
    let mut reader = ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(Trim::All)
        .from_reader(text.as_slice());
    let header = reader.byte_headers().map_err(failed)?.clone();
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        *place = find(path, &header, name)?;
    }
    let mut columns = [const { Vec::new() }; N];
    let mut record = ByteRecord::new();
    while reader.read_byte_record(&mut record).map_err(failed)? {
        for ((column, &place), name) in columns.iter_mut().zip(&places).zip(names) {
            let field = &record[place];
            let number = std::str::from_utf8(field)
                .ok()
                .and_then(|text| text.parse::<f64>().ok());
            match number.filter(|number| number.is_finite()) {
                Some(number) => column.push(number),
                None => {
                    return Err(IoError::Value {
                        path: path.to_owned(),
                        row: row_at(&text, record.position()),
                        column: name.to_owned(),
                        got: shown(field),
                    });
                }
            }
        }
    }
    Ok(columns)
}

/// The line of a record: the parser's position is where it began to look for it, ahead of comments and empty lines.
fn row_at(text: &[u8], position: Option<&Position>) -> Row {
    let (start, line) = position.map_or((0, 1), |position| (position.byte(), position.line()));
    let rest = usize::try_from(start)
        .ok()
        .and_then(|start| text.get(start..))
        .unwrap_or_default();
    let skipped = rest
        .split(|&byte| byte == b'\n')
        .take_while(|line| line.starts_with(b"#") || line.is_empty() || *line == b"\r")
        .count();
    Row::Line(line + skipped as u64)
}

fn find(path: &Path, header: &ByteRecord, name: &str) -> Result<usize, IoError> {
    let mut found = (0..header.len()).filter(|&i| header[i].eq_ignore_ascii_case(name.as_bytes()));
    match (found.next(), found.next()) {
        (Some(place), None) => Ok(place),
        (None, _) => Err(IoError::MissingColumn {
            path: path.to_owned(),
            column: name.to_owned(),
            found: header
                .iter()
                .take(LISTED)
                .map(|field| format!("{:?}", shown(field)))
                .collect(),
        }),
        (Some(_), Some(_)) => Err(IoError::AmbiguousColumn {
            path: path.to_owned(),
            column: name.to_owned(),
        }),
    }
}

fn shown(field: &[u8]) -> String {
    String::from_utf8_lossy(field).chars().take(QUOTED).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<[Vec<f64>; 2], IoError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_csv_columns(file.path(), ["x", "y"])
    }

    #[test]
    fn comments_case_order_and_other_columns_do_not_matter() {
        let text =
            b"\xef\xbb\xbf# made by hand\n name , Y, X\r\n\"M 31, \xe9\", 2.5 ,1e3\r\n\n# more\nb,-0,.5";
        assert_eq!(read(text).unwrap(), [vec![1e3, 0.5], vec![2.5, -0.0]]);
        assert_eq!(read(b"x,y\n").unwrap(), [vec![], vec![]]);
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
        let error = read(b"# x,y\n1,2\n").unwrap_err();
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
}
