//! A line through points.

/// A line through points, with a name in the key.
#[derive(Debug, Clone)]
pub struct Curve {
    pub(super) name: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) colour: Option<usize>,
    pub(super) marker: Option<Marker>,
    pub(super) labels: Vec<((f64, f64), String)>,
}

/// The shape that a point is drawn as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marker {
    /// A filled circle.
    Circle,
    /// A filled triangle.
    Triangle,
    /// A filled square.
    Square,
    /// A filled square on its corner.
    Diamond,
    /// Two crossing strokes.
    Cross,
}

impl Curve {
    /// A line through these points, in this order.
    pub fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.to_owned(),
            points,
            colour: None,
            marker: None,
            labels: Vec::new(),
        }
    }

    /// The part of the values that is below a value, as steps.
    pub fn distribution(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let steps = sorted.iter().enumerate();
        let points = steps
            .flat_map(|(k, &v)| [(v, k as f64 / n), (v, (k + 1) as f64 / n)])
            .collect();
        Self::new(name, points)
    }

    /// In this colour of [`SERIES`](super::SERIES), counted round, whatever its place among the curves.
    #[must_use]
    pub fn with_colour(self, colour: usize) -> Self {
        Self {
            colour: Some(colour),
            ..self
        }
    }

    /// With every point drawn.
    #[must_use]
    pub fn with_marker(self, marker: Marker) -> Self {
        Self {
            marker: Some(marker),
            ..self
        }
    }

    /// With texts beside points, in the curve's colour.
    #[must_use]
    pub fn with_labels(self, labels: Vec<((f64, f64), String)>) -> Self {
        Self { labels, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_steps_from_none_to_all() {
        let curve = Curve::distribution("d", [3.0, 1.0]);
        assert_eq!(curve.points, [(1.0, 0.0), (1.0, 0.5), (3.0, 0.5), (3.0, 1.0)]);
    }
}
