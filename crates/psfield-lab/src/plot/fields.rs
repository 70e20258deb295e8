//! Charts of images and of fields: pictures, maps of values, positions.

use ndarray::{Array2, ArrayView2};
use psf_types::{FrameShape, Position};

use super::{Axis, Chart, Curve, Marker, Scale};
use crate::preview::Picture;

impl Chart {
    /// A chart of a frame. `room` is the space around the frame, as a fraction of its sides.
    fn of_field(title: &str, (nx, ny): (usize, usize), room: f64, curves: Vec<Curve>) -> Self {
        let axis = |name, n: f64| Axis::linear(name).within(-room * n - 0.5, (1.0 + room) * n - 0.5);
        let (x, y) = (axis("x (pixels)", nx as f64), axis("y (pixels)", ny as f64));
        Self {
            aspect: (ny as f64 / nx.max(1) as f64).clamp(0.3, 2.0),
            ..Self::new(title, x, y, curves)
        }
    }

    /// A chart of an image `[y, x]`, with row 0 at the bottom as in FITS viewers. The axes give pixels.
    pub fn picture(title: &str, image: ArrayView2<'_, f64>, scale: &Scale) -> Self {
        let (ny, nx) = image.dim();
        Self {
            picture: Some(Picture::coloured(image, |value| scale.colour(value))),
            scale: Some(scale.clone()),
            ..Self::of_field(title, (nx, ny), 0.0, Vec::new())
        }
    }

    /// A chart of values over a field, shown as colours. A position without a value is grey.
    ///
    /// `columns` is the number of columns if the positions form a regular grid over the field, ordered
    /// by y, then x. The values then fill the field. None: values are shown as dots.
    pub fn map(
        title: &str,
        frame: FrameShape,
        values: &[(Position, Option<f64>)],
        columns: Option<usize>,
        scale: &Scale,
    ) -> Self {
        let size = (frame.nx(), frame.ny());
        let value = |k: usize| values.get(k).and_then(|v| v.1).unwrap_or(f64::NAN);
        if let Some(columns) = columns.filter(|&c| c > 0) {
            let rows = values.len().div_ceil(columns);
            let cells = Array2::from_shape_fn((rows, columns), |(y, x)| value(y * columns + x));
            let field = Self::of_field(title, size, 0.0, Vec::new());
            return Self {
                aspect: field.aspect,
                ..Self::picture(title, cells.view(), scale).with_axes(field.x, field.y)
            };
        }
        let dots = values.iter().enumerate();
        Self {
            scale: Some(scale.clone()),
            dots: dots.map(|(k, (at, _))| ((at.x(), at.y()), value(k))).collect(),
            // Room for dots on the edges of the frame.
            ..Self::of_field(title, size, 0.03, Vec::new())
        }
    }

    /// A chart of positions on a frame.
    pub fn positions(title: &str, positions: &[Position], frame: FrameShape) -> Self {
        let dots = Curve {
            marker: Some(Marker::Dot),
            colour: Some(3),
            ..Curve::new("", positions.iter().map(|p| (p.x(), p.y())).collect())
        };
        Self::of_field(title, (frame.nx(), frame.ny()), 0.02, vec![dots])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::Figure;
    use ndarray::array;

    /// Values on a grid of 2 x 2.
    fn map(columns: Option<usize>) -> Chart {
        let places = (0..4).map(|k| Position::of_pixel(k % 2, k / 2));
        let values: Vec<_> = places.zip([-1.0, 0.0, 1.0, 5.0].map(Some)).collect();
        let scale = Scale::difference("q", 1.0);
        Chart::map("t", FrameShape::new(2, 2).unwrap(), &values, columns, &scale)
    }

    #[test]
    fn the_first_value_is_at_the_bottom_left_and_zero_is_white() {
        let picture = map(Some(2)).picture.unwrap();
        let png = image::load_from_memory(&picture.png()).unwrap().into_rgb8();
        let scale = Scale::difference("q", 1.0);
        assert_eq!(png.get_pixel(0, 1).0, scale.colour(-1.0));
        assert_eq!(png.get_pixel(1, 1).0, [255; 3]);
        assert_eq!(png.get_pixel(1, 0).0, scale.colour(1.0));
        let dots = Figure::new(&[map(None)], 200.0).svg();
        assert_eq!(dots.matches("<circle").count(), 4);
    }

    #[test]
    fn every_picture_has_its_colours_and_its_bar() {
        let image = array![[0.0, 1.0], [2.0, 3.0]];
        let picture = |title, scale: &Scale| Chart::picture(title, image.view(), scale);
        let axes = [("x, mm", 20.0), ("y, mm", 10.0)].map(|(name, end)| Axis::linear(name).within(0.0, end));
        let [x, y] = axes;
        let charts = [
            picture("two rows\nof heading", &Scale::sky("counts", 0.1, 3.0)),
            picture("difference", &Scale::difference("counts", 3.0)).with_axes(x, y),
        ];
        let svg = Figure::new(&charts, 300.0).svg();
        assert_eq!(svg.matches("<image").count(), 4);
        for text in [
            "two rows",
            "of heading",
            "difference",
            "x (pixels)",
            "x, mm",
            "y, mm",
            "counts",
        ] {
            assert!(svg.contains(&format!(">{text}</text>")), "{text}");
        }
    }

    #[test]
    fn positions_are_dots_without_lines() {
        let positions = [(1, 2), (3, 4)].map(|(x, y)| Position::of_pixel(x, y));
        let chart = Chart::positions("two", &positions, FrameShape::new(10, 10).unwrap());
        let svg = Figure::new(&[chart], 200.0).svg();
        assert!(svg.matches("<path").count() == 2 && !svg.contains("<polyline"));
    }
}
