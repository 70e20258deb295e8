//! PNG pictures of images.

use std::path::Path;

use image::{GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use metrics::Summary;
use ndarray::{Array2, ArrayView2, ArrayView3};
use psf_types::{FrameShape, Position};

/// Faint and bright light in one picture: black at `low`, white at `high`, linear below `soft` and logarithmic above.
/// Row 0 is at the bottom, as FITS viewers show it.
pub(crate) fn asinh_picture(image: ArrayView2<'_, f32>, low: f32, soft: f32, high: f32) -> GrayImage {
    let (ny, nx) = image.dim();
    let full = ((high - low) / soft).asinh();
    GrayImage::from_fn(nx as u32, ny as u32, |x, y| {
        let value = image[[ny - 1 - y as usize, x as usize]];
        Luma([(255.0 * (((value - low) / soft).asinh() / full).clamp(0.0, 1.0)) as u8])
    })
}

/// A difference: blue below 0, red above, white at 0; full colour at `scale`.
pub(crate) fn difference_picture(image: ArrayView2<'_, f32>, scale: f32) -> RgbImage {
    let (ny, nx) = image.dim();
    RgbImage::from_fn(nx as u32, ny as u32, |x, y| {
        let v = (image[[ny - 1 - y as usize, x as usize]] / scale).clamp(-1.0, 1.0);
        let fade = (255.0 * (1.0 - v.abs())) as u8;
        Rgb(if v < 0.0 {
            [fade, fade, 255]
        } else {
            [255, fade, fade]
        })
    })
}

/// PSFs in a grid of `across` columns, the first at the bottom left, each enlarged `zoom` times; all share one scale.
pub(crate) fn mosaic_picture(stamps: ArrayView3<'_, f64>, across: usize, zoom: usize) -> GrayImage {
    let (count, ny, nx) = stamps.dim();
    let (width, height) = (nx * zoom + 1, ny * zoom + 1);
    let down = count.div_ceil(across);
    // A grey line between neighbours.
    let peak = stamps.iter().copied().fold(0.0, f64::max) as f32;
    let mut whole = Array2::from_elem((down * height, across * width), peak * 0.02);
    for (n, stamp) in stamps.outer_iter().enumerate() {
        let (row, column) = (n / across * height, n % across * width);
        for y in 0..ny * zoom {
            for x in 0..nx * zoom {
                whole[[row + y, column + x]] = stamp[[y / zoom, x / zoom]] as f32;
            }
        }
    }
    asinh_picture(whole.view(), 0.0, peak * 1e-3, peak)
}

/// Positions on the frame, `size` pixels wide: a dot each, the frame's edge in grey.
pub(crate) fn positions_picture(positions: &[Position], frame: FrameShape, size: u32) -> GrayImage {
    const MARGIN: u32 = 12;
    let scale = f64::from(size) / frame.nx() as f64;
    let height = (frame.ny() as f64 * scale).round() as u32;
    let mut picture = GrayImage::from_fn(size + 2 * MARGIN, height + 2 * MARGIN, |x, y| {
        let inside = (MARGIN..MARGIN + size).contains(&x) && (MARGIN..MARGIN + height).contains(&y);
        Luma([if inside { 255 } else { 200 }])
    });
    for p in positions {
        let x = f64::from(MARGIN) + (p.x() + 0.5) * scale;
        let y = f64::from(MARGIN + height) - (p.y() + 0.5) * scale;
        for dy in -2i32..=2 {
            for dx in -2i32..=2 {
                if dx * dx + dy * dy <= 5 {
                    picture.put_pixel((x as i32 + dx) as u32, (y as i32 + dy) as u32, Luma([0]));
                }
            }
        }
    }
    picture
}

/// The value below which the fraction `q` of all values lies.
pub(crate) fn quantile(image: ArrayView2<'_, f32>, q: f64) -> anyhow::Result<f32> {
    Ok(Summary::of(image.iter().map(|&v| f64::from(v)))?.quantile(q)? as f32)
}

/// Writes a picture as PNG; whole or not at all.
pub(crate) fn write_png<P>(
    path: &Path,
    picture: &image::ImageBuffer<P, Vec<u8>>,
    overwrite: bool,
) -> anyhow::Result<()>
where
    P: image::Pixel<Subpixel = u8> + image::PixelWithColorType,
{
    // Not straight into the file, whose last bytes `image` would write without a look at what the system says.
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png)?;
    Ok(psf_io::write_bytes(path, png.get_ref(), overwrite)?)
}
