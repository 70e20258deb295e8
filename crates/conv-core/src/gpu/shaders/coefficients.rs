//! The twin of `coefficients.wgsl`.

const HEADER_WORDS: [&str; 9] = [
    "dense",
    "functions",
    "divides",
    "plain",
    "columns",
    "rows",
    "row starts",
    "runs",
    "values",
];

/// A value times the coefficient of a kernel at a pixel of its block.
pub(super) fn weighted(
    tables: &[u32],
    value: f64,
    table: usize,
    kernel: usize,
    row: usize,
    column: usize,
) -> f64 {
    let words = &tables[table..];
    let header = |name: &str| {
        let place = HEADER_WORDS.iter().position(|&word| word == name);
        words[place.expect("a word of the header")] as usize
    };
    let function = |function: usize| {
        let real = |place: usize| f64::from(f32::from_bits(words[header("values") + place]));
        if header("dense") == 1 {
            return real((function * header("rows") + row) * header("columns") + column);
        }
        let starts = header("row starts") + row;
        let runs = words[starts] as usize..words[starts + 1] as usize;
        let first = |run: usize| words[header("runs") + run] as usize;
        let run = runs.rev().find(|&run| first(run) <= column);
        let run = run.expect("runs begin with the row");
        let place = 2 * (run * header("functions") + function);
        real(place) + (column - first(run)) as f64 * real(place + 1)
    };
    if kernel < header("plain") {
        return value;
    }
    let product = value * function(kernel - header("plain") + header("divides"));
    if header("divides") == 1 {
        product / function(0)
    } else {
        product
    }
}
