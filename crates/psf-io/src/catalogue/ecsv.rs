//! The header of an ECSV file: YAML in the comments before the table.

use yaml_rust2::Event;
use yaml_rust2::parser::Parser;

/// The first line of an ECSV file, without the `#`.
const MAGIC: &str = "%ECSV";

/// The names and units of the columns, from the comments before the table without their `#`. `None` for
/// a file that is not ECSV, an error for a header that is not YAML.
///
/// The events of the parser are enough, which is safe for headers of any depth.
pub(super) fn units(comments: &[&[u8]]) -> Option<Result<Vec<(String, String)>, String>> {
    let mut lines = comments.iter().map(|line| String::from_utf8_lossy(line));
    lines
        .next()
        .filter(|first| first.trim_start().starts_with(MAGIC))?;
    let strip = |line: std::borrow::Cow<'_, str>| {
        let text = line.strip_prefix(' ').unwrap_or(&line);
        format!("{text}\n")
    };
    let yaml: String = lines.map(strip).collect();
    Some(columns_of(&yaml))
}

/// An open collection.
enum Open {
    Sequence,
    /// A mapping, and the key whose value comes next.
    Mapping(Option<String>),
}

/// The entries `name` and `unit` of the list `datatype`.
fn columns_of(yaml: &str) -> Result<Vec<(String, String)>, String> {
    let mut parser = Parser::new_from_str(yaml);
    let (mut open, mut columns) = (Vec::new(), Vec::new());
    loop {
        let (event, _) = parser.next_token().map_err(|error| error.to_string())?;
        let in_column = matches!(&open[..], [Open::Mapping(Some(key)), Open::Sequence, Open::Mapping(_)] if key == "datatype");
        match event {
            Event::StreamEnd => return Ok(columns),
            Event::SequenceStart(..) => open.push(Open::Sequence),
            Event::MappingStart(..) => {
                if matches!(&open[..], [Open::Mapping(Some(key)), Open::Sequence] if key == "datatype") {
                    columns.push((String::new(), String::new()));
                }
                open.push(Open::Mapping(None));
            }
            Event::SequenceEnd | Event::MappingEnd => {
                open.pop();
                ended(&mut open, "");
            }
            Event::Scalar(text, ..) => {
                let key = match open.last() {
                    Some(Open::Mapping(key)) => key.as_deref(),
                    _ => None,
                };
                if let Some((name, unit)) = columns.last_mut().filter(|_| in_column) {
                    match key {
                        Some("name") => name.clone_from(&text),
                        Some("unit") => unit.clone_from(&text),
                        _ => {}
                    }
                }
                ended(&mut open, &text);
            }
            Event::Alias(_) => ended(&mut open, ""),
            _ => {}
        }
    }
}

/// Notes in the innermost open collection that a value, or a key of this text, has ended.
fn ended(open: &mut [Open], text: &str) {
    if let Some(Open::Mapping(key)) = open.last_mut() {
        *key = match key {
            None => Some(text.to_owned()),
            Some(_) => None,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Option<Result<Vec<(String, String)>, String>> {
        let lines: Vec<&[u8]> = text.lines().map(|line| &line.as_bytes()[1..]).collect();
        units(&lines)
    }

    #[test]
    fn units_of_astropy_are_found_in_all_their_forms() {
        let header = "# %ECSV 1.0\n# ---\n# delimiter: ','\n# datatype:\n# - name: x\n#   unit: pix\n#   datatype: float64\n\
            #   meta: !!omap\n#   - {unit: s}\n# - {name: y, datatype: float64}\n\
            # - {name: flux, unit: mJy, datatype: float64, description: 'a long description, with {braces}, that\n\
            #     goes on, unit: no'}\n# meta: !!omap\n# - {unit: K}\n# - x:\n#     unit: &id001 !astropy.units.Unit {unit: pix}\n\
            #     again: *id001\n# schema: astropy-2.0\n";
        let expected = [("x", "pix"), ("y", ""), ("flux", "mJy")];
        let found = of(header).unwrap().unwrap();
        assert_eq!(found, expected.map(|(a, b)| (a.to_owned(), b.to_owned())));
    }

    #[test]
    fn other_comments_have_no_units_and_wrong_yaml_is_told() {
        assert!(of("# stars\n# - {name: x, unit: pix}\n").is_none());
        assert!(
            of("# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x\n# meta: y\n")
                .unwrap()
                .is_err()
        );
        let deep = format!("# %ECSV 1.0\n# ---\n# a: {}\n", "[".repeat(200_000));
        assert!(of(&deep).unwrap().is_err());
        let laughs =
            "# %ECSV 1.0\n# a: &a [1,1,1,1]\n# b: &b [*a,*a,*a,*a]\n# datatype:\n# - {name: x, unit: pix}\n";
        assert_eq!(of(laughs).unwrap().unwrap().len(), 1);
    }
}
