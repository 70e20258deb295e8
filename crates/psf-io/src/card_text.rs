//! Texts in header records.

use crate::card::{RECORD, Record};

/// The longest text, quotes doubled, in a record of a long string that goes on in the next.
const CONTINUED_TEXT: usize = 67;
/// The longest text, quotes doubled, in a single record.
const SINGLE_TEXT: usize = 68;

/// Printable ASCII stays; all else becomes an escape.
pub(crate) fn printable(text: &str) -> String {
    text.chars()
        .flat_map(|c| {
            let plain = (' '..='~').contains(&c);
            let escape = (!plain).then(|| c.escape_default());
            plain.then_some(c).into_iter().chain(escape.into_iter().flatten())
        })
        .collect()
}

pub(crate) fn padded(text: &[u8]) -> Record {
    let mut record = [b' '; RECORD];
    record[..text.len()].copy_from_slice(text);
    record
}

/// As much of the comment as fits.
pub(crate) fn with_comment(mut text: String, comment: &str) -> Record {
    if !comment.is_empty() && text.len() + 4 < RECORD {
        text.push_str(" / ");
        text.push_str(comment);
        text.truncate(RECORD);
    }
    padded(text.as_bytes())
}

pub(crate) fn text_records(keyword: &str, text: &str, comment: &str) -> Vec<Record> {
    let escaped = text.replace('\'', "''");
    if escaped.len() <= SINGLE_TEXT {
        return vec![with_comment(
            format!("{keyword:<8}= {:<20}", format!("'{escaped:<8}'")),
            comment,
        )];
    }
    // Doubled quotes must not be torn apart, so the split goes by the characters of the text.
    let mut parts = vec![String::new()];
    for c in text.chars() {
        let piece = if c == '\'' { "''".to_owned() } else { c.to_string() };
        if parts[parts.len() - 1].len() + piece.len() > CONTINUED_TEXT {
            parts.push(String::new());
        }
        parts.last_mut().expect("never empty").push_str(&piece);
    }
    let last = parts.len() - 1;
    let record = |(i, part): (usize, &String)| {
        let head = if i == 0 {
            format!("{keyword:<8}= ")
        } else {
            "CONTINUE  ".to_owned()
        };
        if i == last {
            with_comment(format!("{head}'{part}'"), comment)
        } else {
            padded(format!("{head}'{part}&'").as_bytes())
        }
    };
    parts.iter().enumerate().map(record).collect()
}

/// A quoted text and what follows it; trailing blanks of the text do not count.
pub(crate) fn quoted(field: &[u8]) -> Option<(String, &[u8])> {
    let mut rest = field.strip_prefix(b"'")?;
    let mut text = Vec::new();
    loop {
        let quote = rest.iter().position(|&b| b == b'\'')?;
        text.extend_from_slice(&rest[..quote]);
        rest = &rest[quote + 1..];
        match rest.strip_prefix(b"'") {
            Some(after) => {
                text.push(b'\'');
                rest = after;
            }
            None => return Some((String::from_utf8_lossy(&text).trim_end().to_owned(), rest)),
        }
    }
}
