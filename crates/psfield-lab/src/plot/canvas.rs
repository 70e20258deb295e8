//! A canvas that draws a figure as SVG and as pixels at once.

use std::io;
use std::sync::LazyLock;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ImageError, RgbImage};
use plotters::backend::DrawingBackend;
use plotters::coord::CoordTranslate;
use plotters::prelude::{DrawingArea, SVGBackend};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingErrorKind, FontTransform,
};
use tiny_skia::{FillRule, IntSize, Paint, Path, PathBuilder, Pixmap, PixmapPaint, Rect, Stroke, Transform};
use ttf_parser::{Face, OutlineBuilder};

/// PNG pixels along each side of a figure's pixel, for sharp print.
pub(super) const PNG_SCALE: f32 = 2.0;

/// The font of the text in PNGs. It is part of the program, so that a figure gives the same PNG on
/// every machine.
static FONT: LazyLock<Face<'static>> =
    LazyLock::new(|| Face::parse(dejavu::sans::regular(), 0).expect("DejaVu Sans is a TrueType font"));

/// Draws each shape twice: into an SVG, and into an image that has [`PNG_SCALE`] times as many
/// pixels along each axis as the SVG.
pub(super) struct Canvas<'a> {
    svg: SVGBackend<'a>,
    pixels: &'a mut Pixmap,
}

type Drawn = Result<(), DrawingErrorKind<io::Error>>;

impl<'a> Canvas<'a> {
    pub(super) fn new(svg: &'a mut String, pixels: &'a mut Pixmap, size: (u32, u32)) -> Self {
        Self {
            svg: SVGBackend::with_string(svg, size),
            pixels,
        }
    }

    fn stroke(&mut self, path: Option<Path>, style: &impl BackendStyle) {
        let stroke = Stroke {
            width: style.stroke_width() as f32,
            ..Stroke::default()
        };
        if let Some(path) = path {
            self.pixels
                .stroke_path(&path, &paint(style.color()), &stroke, scaled(), None);
        }
    }

    fn fill(&mut self, path: Option<Path>, colour: BackendColor, transform: Transform) {
        if let Some(path) = path {
            self.pixels
                .fill_path(&path, &paint(colour), FillRule::Winding, transform, None);
        }
    }

    fn stroke_or_fill(&mut self, path: Option<Path>, style: &impl BackendStyle, fill: bool) {
        if fill {
            self.fill(path, style.color(), scaled());
        } else {
            self.stroke(path, style);
        }
    }
}

fn scaled() -> Transform {
    Transform::from_scale(PNG_SCALE, PNG_SCALE)
}

fn paint(colour: BackendColor) -> Paint<'static> {
    let (r, g, b) = colour.rgb;
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, (colour.alpha * 255.0).round() as u8);
    paint
}

fn rectangle((left, top): BackendCoord, (right, bottom): BackendCoord) -> Option<Path> {
    let rect = Rect::from_ltrb(left as f32, top as f32, right as f32, bottom as f32)?;
    Some(PathBuilder::from_rect(rect))
}

fn polyline(points: &[BackendCoord], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (k, &(x, y)) in points.iter().enumerate() {
        if k == 0 {
            path.move_to(x as f32, y as f32);
        } else {
            path.line_to(x as f32, y as f32);
        }
    }
    if closed {
        path.close();
    }
    path.finish()
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = io::Error;

    fn get_size(&self) -> (u32, u32) {
        self.svg.get_size()
    }

    fn ensure_prepared(&mut self) -> Drawn {
        self.svg.ensure_prepared()
    }

    fn present(&mut self) -> Drawn {
        self.svg.present()
    }

    fn draw_pixel(&mut self, at: BackendCoord, colour: BackendColor) -> Drawn {
        self.fill(rectangle(at, (at.0 + 1, at.1 + 1)), colour, scaled());
        self.svg.draw_pixel(at, colour)
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.stroke(polyline(&[from, to], false), style);
        self.svg.draw_line(from, to, style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        upper_left: BackendCoord,
        bottom_right: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn {
        self.stroke_or_fill(rectangle(upper_left, bottom_right), style, fill);
        self.svg.draw_rect(upper_left, bottom_right, style, fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        let points: Vec<_> = path.into_iter().collect();
        self.stroke(polyline(&points, false), style);
        self.svg.draw_path(points, style)
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        centre: BackendCoord,
        radius: u32,
        style: &S,
        fill: bool,
    ) -> Drawn {
        let circle = PathBuilder::from_circle(centre.0 as f32, centre.1 as f32, radius as f32);
        self.stroke_or_fill(circle, style, fill);
        self.svg.draw_circle(centre, radius, style, fill)
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        let points: Vec<_> = path.into_iter().collect();
        self.fill(polyline(&points, true), style.color(), scaled());
        self.svg.fill_polygon(points, style)
    }

    /// Draws text into the SVG and into the pixels. The size and the offsets of the text in the
    /// pixels are copied from the SVG backend of plotters, so that both look alike.
    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Drawn {
        let em = style.size() as f32 / 1.24;
        let unit = em / f32::from(FONT.units_per_em());
        let x_height = FONT
            .x_height()
            .map_or(em / 2.0, |height| unit * f32::from(height));
        let (outline, width) = outline(text);
        let right = match style.anchor().h_pos {
            HPos::Left => 0.0,
            HPos::Center => -unit * width / 2.0,
            HPos::Right => -unit * width,
        };
        let down = match style.anchor().v_pos {
            VPos::Top => 0.76 * em,
            VPos::Center => 0.5 * x_height,
            VPos::Bottom => -0.5 * x_height,
        };
        let degrees = match style.transform() {
            FontTransform::None => 0.0,
            FontTransform::Rotate90 => 90.0,
            FontTransform::Rotate180 => 180.0,
            FontTransform::Rotate270 => 270.0,
        };
        let transform = scaled()
            .pre_translate(at.0 as f32, at.1 as f32)
            .pre_rotate(degrees)
            .pre_translate(right, down)
            .pre_scale(unit, -unit);
        self.fill(outline, style.color(), transform);
        self.svg.draw_text(text, style, at)
    }
}

/// A picture that is drawn over a figure. `left`, `top`, `width` and `height` are in pixels of the
/// figure.
#[derive(Debug)]
pub(super) struct Overlay {
    pub(super) left: i32,
    pub(super) top: i32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixels: RgbImage,
}

impl Overlay {
    /// Makes an overlay that fills the plotting area of a chart with a picture.
    pub(super) fn over<C: CoordTranslate>(plot: &DrawingArea<Canvas<'_>, C>, pixels: RgbImage) -> Self {
        let (x, y) = plot.get_pixel_range();
        Self {
            left: x.start,
            top: y.start,
            width: (x.end - x.start) as u32,
            height: (y.end - y.start) as u32,
            pixels,
        }
    }

    pub(super) fn element(&self) -> Result<String, ImageError> {
        let mut png = Vec::new();
        self.pixels.write_with_encoder(PngEncoder::new(&mut png))?;
        let (left, top, width, height) = (self.left, self.top, self.width, self.height);
        let place = format!("x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\"");
        Ok(format!(
            "<image {place} preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" \
             href=\"data:image/png;base64,{}\"/>\n\
             <rect {place} fill=\"none\" stroke=\"#808080\"/>\n",
            BASE64_STANDARD.encode(&png),
        ))
    }

    /// Draws the picture over `image`, with a grey line around the picture. The pixels of the
    /// picture become sharp rectangles.
    pub(super) fn lay_over(&self, image: &mut Pixmap) {
        let rgba = DynamicImage::from(self.pixels.clone()).into_rgba8();
        let (columns, rows) = rgba.dimensions();
        let Some(picture) =
            IntSize::from_wh(columns, rows).and_then(|size| Pixmap::from_vec(rgba.into_raw(), size))
        else {
            return;
        };
        let (left, top) = (self.left as f32, self.top as f32);
        let (width, height) = (self.width as f32, self.height as f32);
        let transform = scaled()
            .pre_translate(left, top)
            .pre_scale(width / columns as f32, height / rows as f32);
        image.draw_pixmap(0, 0, picture.as_ref(), &PixmapPaint::default(), transform, None);
        if let Some(edge) = Rect::from_xywh(left, top, width, height) {
            let grey = paint(BackendColor {
                rgb: (128, 128, 128),
                alpha: 1.0,
            });
            image.stroke_path(
                &PathBuilder::from_rect(edge),
                &grey,
                &Stroke::default(),
                scaled(),
                None,
            );
        }
    }
}

/// Returns the outlines of the glyphs of a string that starts at (0, 0), and the width of the
/// string. Both are in the font's units, with y upwards.
fn outline(text: &str) -> (Option<Path>, f32) {
    let mut outline = Outline {
        path: PathBuilder::new(),
        left: 0.0,
    };
    for character in text.chars() {
        let glyph = FONT.glyph_index(character).unwrap_or_default();
        FONT.outline_glyph(glyph, &mut outline);
        outline.left += f32::from(FONT.glyph_hor_advance(glyph).unwrap_or(0));
    }
    (outline.path.finish(), outline.left)
}

/// Joins the outlines of glyphs to one path. The next glyph starts at the x coordinate `left`.
struct Outline {
    path: PathBuilder,
    left: f32,
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.move_to(self.left + x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.line_to(self.left + x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.path.quad_to(self.left + x1, y1, self.left + x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.path
            .cubic_to(self.left + x1, y1, self.left + x2, y2, self.left + x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}
