//! The column names of text tables.

/// The highest number of a column where no row tells how many there are.
const MOST_WITHOUT_ROWS: usize = 10_000;

/// What stands between the fields of a text table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Separator {
    /// One of this character; quotes are known.
    Byte(u8),
    /// Any number of blanks.
    Blanks,
}

/// How a text table begins.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct TextHeader {
    /// Empty for columns without a name.
    pub(crate) names: Vec<String>,
    pub(crate) separator: Separator,
    /// The first byte of the rows, and the number of its line, from 1.
    pub(crate) rows_from: usize,
    pub(crate) first_line: u64,
}

impl TextHeader {
    /// Finds the names: in SExtractor's way, `# number NAME ...` a line, where the comments are such lines; else in the first line that is
    /// no comment (`#`); or, when that line holds nothing but numbers, in the last comment ahead of it if it has as many fields.
    ///
    /// Fields are separated by commas, tabs or blanks, whichever the first line that is no comment has, in this order.
    pub(crate) fn of(text: &[u8]) -> Self {
        let mut comments = Vec::new();
        let mut first = (text.len(), text.len(), 1);
        for (number, start, end) in lines(text) {
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
        let rows_here = |names, separator| Self {
            names,
            separator,
            rows_from: start,
            first_line: number,
        };
        if let Some(numbered) = sextractor_names(&comments, line) {
            return rows_here(numbered, Separator::Blanks);
        }
        let fields = separator.fields(line);
        if !fields.is_empty() && fields.iter().all(|field| field.parse::<f64>().is_ok()) {
            let names = comments.last().map(|comment| separator.fields(comment));
            if let Some(names) = names.filter(|names| names.len() == fields.len()) {
                return rows_here(names, separator);
            }
        }
        Self {
            names: fields,
            separator,
            rows_from: end,
            first_line: number,
        }
    }
}

impl Separator {
    /// The fields of a line, trimmed.
    fn fields(self, line: &[u8]) -> Vec<String> {
        let owned = |field: &[u8]| String::from_utf8_lossy(field).into_owned();
        match self {
            Self::Blanks => blank_separated(line).map(owned).collect(),
            Self::Byte(separator) => {
                let mut reader = csv::ReaderBuilder::new()
                    .has_headers(false)
                    .delimiter(separator)
                    .trim(csv::Trim::All)
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

/// The fields of a line.
pub(crate) fn blank_separated(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|field| !field.is_empty())
}

/// The lines that are not empty: number from 1, first byte and the byte behind the last, line breaks left out.
pub(crate) fn lines(text: &[u8]) -> impl Iterator<Item = (u64, usize, usize)> {
    let mut start = 0;
    text.split(|&byte| byte == b'\n')
        .zip(1..)
        .filter_map(move |(line, number)| {
            let first = start;
            start += line.len() + 1;
            (!line.trim_ascii().is_empty()).then(|| (number, first, first + line.trim_ascii_end().len()))
        })
}

/// The names in lines `# number NAME ...`, as many as the first row has fields; columns that no line names belong to a vector and have
/// no name.
///
/// Comments may begin with a number too: the numbers of columns start at 1 and rise up to the last comment, and the row has nothing but
/// numbers, at least as many.
fn sextractor_names(comments: &[&[u8]], row: &[u8]) -> Option<Vec<String>> {
    let is_number = |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| text.parse::<f64>().is_ok());
    let fields: Vec<&[u8]> = blank_separated(row).collect();
    if !fields.iter().all(|field| is_number(field)) {
        return None;
    }
    let of_column = |comment: &&[u8]| {
        let mut words = blank_separated(comment);
        let number: usize = std::str::from_utf8(words.next()?).ok()?.parse().ok()?;
        Some((number, String::from_utf8_lossy(words.next()?).into_owned()))
    };
    of_column(comments.last()?)?;
    let columns: Vec<(usize, String)> = comments.iter().filter_map(of_column).collect();
    let rises = columns.windows(2).all(|pair| pair[0].0 < pair[1].0);
    let last = columns[columns.len() - 1].0;
    // A catalogue may have no row.
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
