//! The part of a scene that reaches its frame.

use std::borrow::Cow;
use std::ops::Range;

use ndarray::s;
use psf_types::{FrameShape, Image, PixelRegion, Scene};

use crate::ConvReal;
use crate::kernel::Reach;

/// The columns and rows of a scene whose light can reach the frame: all but what is farther from it than the stamps reach.
pub(crate) fn reaching(shape: FrameShape, frame: PixelRegion, reach: Reach) -> [Range<usize>; 2] {
    // The source of an offset u in [-left, right] from pixel y lies at y - u.
    let range = |first: i64, length: usize, before: usize, after: usize, limit: usize| {
        let first = first as usize;
        first.saturating_sub(before)..(first + length + after).min(limit)
    };
    [
        range(
            frame.x0(),
            frame.shape().nx(),
            reach.right,
            reach.left,
            shape.nx(),
        ),
        range(
            frame.y0(),
            frame.shape().ny(),
            reach.above,
            reach.below,
            shape.ny(),
        ),
    ]
}

/// The image part of a scene, cut to the frame and a margin of the stamps' reach: light beyond it falls on no pixel of the
/// frame, so nobody asks for its PSF. Point sources are left out.
pub(crate) fn within_reach<T: ConvReal>(scene: &Scene<T>, reach: Reach) -> Cow<'_, Scene<T>> {
    let (Some(light), frame) = (scene.pixels(), scene.frame()) else {
        return Cow::Borrowed(scene);
    };
    let [columns, rows] = reaching(scene.shape(), frame, reach);
    if columns.len() == light.ncols() && rows.len() == light.nrows() {
        return Cow::Borrowed(scene);
    }
    let cut =
        Image::new(light.slice(s![rows.clone(), columns.clone()]).to_owned()).expect("part of a valid image");
    let frame = PixelRegion::new(
        frame.x0() - columns.start as i64,
        frame.y0() - rows.start as i64,
        frame.shape(),
    );
    Cow::Owned(
        Scene::from_image(cut)
            .with_frame(frame)
            .expect("the frame lies within"),
    )
}
