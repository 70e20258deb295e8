//! Mutations of text files: tables, TOML, JSON.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::numbers::{change_byte, pick, place, word};

/// Separators of words.
const MARKS: &[&str] = &[
    ",",
    ";",
    "\"",
    "'",
    "\n",
    "\r\n",
    "\t",
    " ",
    "#",
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "=",
    ":",
    "\\",
    "\u{feff}",
    "\0",
    "é",
    "#   1 X_IMAGE  [pixel]\n",
    "x,y,flux\n",
    "x y flux\n",
    "null",
    "true",
    "[[",
    "\"\"\"",
    "--,--",
];

/// One mutation.
pub(crate) fn mutate(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    match rng.random_range(0..9) {
        0..=2 => replace_number(data, rng),
        3 => insert(data, pick(MARKS, rng).as_bytes(), rng),
        4 => insert(data, word(rng).as_bytes(), rng),
        5 => change_byte(data, rng),
        6 => remove_line(data, rng),
        7 => repeat_line(data, rng),
        _ => remove_part(data, rng),
    }
}

/// Replaces a number by another.
fn replace_number(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    let is_number = |b: &u8| b.is_ascii_digit() || b".+-eE".contains(b);
    let starts: Vec<usize> = (0..data.len())
        .filter(|&i| data[i].is_ascii_digit() && (i == 0 || !is_number(&data[i - 1])))
        .collect();
    let Some(which) = place(starts.len(), rng) else {
        return insert(data, word(rng).as_bytes(), rng);
    };
    let start = starts[which];
    let length = data[start..].iter().take_while(|b| is_number(b)).count();
    data.splice(start..start + length, word(rng).into_bytes());
}

fn insert(data: &mut Vec<u8>, bytes: &[u8], rng: &mut ChaCha8Rng) {
    let at = rng.random_range(0..=data.len());
    data.splice(at..at, bytes.iter().copied());
}

/// The range of a random line, including its line end.
fn line(data: &[u8], rng: &mut ChaCha8Rng) -> std::ops::Range<usize> {
    let at = place(data.len(), rng).unwrap_or(0);
    let start = data[..at].iter().rposition(|&b| b == b'\n').map_or(0, |i| i + 1);
    let end = data[at..].iter().position(|&b| b == b'\n');
    start..end.map_or(data.len(), |i| at + i + 1)
}

fn remove_line(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    data.drain(line(data, rng));
}

fn repeat_line(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    let bounds = line(data, rng);
    let copy = data[bounds.clone()].repeat(rng.random_range(1..4));
    let at = if rng.random::<bool>() {
        bounds.end
    } else {
        line(data, rng).start
    };
    data.splice(at..at, copy);
}

fn remove_part(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    if let Some(start) = place(data.len(), rng) {
        let length = rng.random_range(1..=16).min(data.len() - start);
        data.drain(start..start + length);
    }
}
