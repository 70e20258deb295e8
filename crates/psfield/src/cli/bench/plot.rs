//! Run time against error.

use psfield::bench::BenchRow;
use psfield::plot::{Axis, Curve, Curves, Figure, Mark, Marker, PlotError, curve_panels};

use super::report::{settings_of, size_of};

/// An error below this, or none at all, is drawn here.
const LEAST_ERROR: f64 = 1e-17;

/// The methods in the order of the key, with marker and place among the colours of curves.
const METHODS: [(&str, Marker, usize); 6] = [
    (UNIT, Marker::Cross, 3),
    ("lowrank", Marker::Circle, 0),
    ("auto", Marker::Triangle, 5),
    ("patch", Marker::Square, 2),
    ("basis", Marker::Diamond, 1),
    ("direct", Marker::Cross, 4),
];
/// The method whose time is the unit.
const UNIT: &str = "single";

/// A panel for each case, whose rows have the single PSF first.
pub(super) fn plot(cases: &[&[BenchRow]]) -> Result<Figure, PlotError> {
    let panels: Vec<(String, Curves)> = cases
        .iter()
        .map(|rows| {
            let title = format!("{}\n{}", size_of(&rows[0]), settings_of(&rows[0]));
            (title, curves(rows))
        })
        .collect();
    curve_panels(&panels)
}

fn curves(rows: &[BenchRow]) -> Curves {
    let of = |name| rows.iter().filter(move |row| row.method == name);
    // One convolution costs this, whatever the error.
    let marks = of(UNIT)
        .map(|row| Mark::Horizontal(row.seconds, UNIT.to_owned()))
        .collect();
    let curves = METHODS
        .iter()
        .filter(|(name, ..)| of(name).any(|row| row.relative_l2.is_some()))
        .map(|&(name, marker, colour)| {
            let points: Vec<(f64, f64, Option<&str>)> = of(name)
                .filter_map(|row| Some((error(row)?, row.seconds, row.setting.as_deref())))
                .collect();
            // `auto` has the settings of `lowrank`, close by.
            let named = name != "auto" || of("lowrank").next().is_none();
            Curve::new(name, points.iter().map(|p| (p.0, p.1)).collect())
                .with_marker(marker)
                .with_colour(colour)
                .with_labels(if named { labels(&points) } else { Vec::new() })
        })
        .collect();
    Curves {
        x: Axis::logarithmic("measured relative L2 error"),
        y: Axis::logarithmic("run time, seconds (fastest run)"),
        curves,
        marks,
    }
}

/// The settings' values, those of points close together in one text.
fn labels(points: &[(f64, f64, Option<&str>)]) -> Vec<((f64, f64), String)> {
    points
        .chunk_by(|a, b| close(a.0, b.0) && close(a.1, b.1))
        .map(|same| {
            let values = same.iter().filter_map(|p| p.2?.rsplit('=').next());
            ((same[0].0, same[0].1), values.collect::<Vec<_>>().join(", "))
        })
        .collect()
}

/// Whether two values lie so close on a logarithmic axis that their labels would overlap.
fn close(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < 0.3
}

/// The error as it is drawn, where there is one.
fn error(row: &BenchRow) -> Option<f64> {
    row.relative_l2.map(|e| e.max(LEAST_ERROR))
}
