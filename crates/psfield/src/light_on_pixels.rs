//! Images of galaxies without a telescope.

use conv_core::ConvReal;
use ndarray::Array3;
use psf_types::{FrameShape, Image, Position, PsfSamples, SamplePositions, SersicSource, StampGrid};

use crate::error::PsfieldError;
use crate::fit::FitOptions;
use crate::psf::Psf;
use crate::scene::Scene;

/// Pixels of the stamp for each pixel of an image of [`light_on_pixels`].
const FINE: usize = 4;

/// The light of galaxies as an image: the flux that falls in each pixel. It is the image of the
/// galaxies through a PSF that is only the response of a pixel, with edges softened over a third of a
/// pixel. For a galaxy much smaller than a pixel, the softened edges matter. If its centre is closer
/// than a sixth of a pixel to an edge, its light is divided between both pixels. Elsewhere the value of
/// a pixel is wrong by up to 17 % of the galaxy's flux, because the edges overshoot, and may be
/// negative. Use the image as a scene whose pixels hold integrated light. To simulate galaxies, give
/// them to [`Scene::with_galaxies`] instead: that blurs them once.
///
/// # Errors
/// [`PsfieldError`] if the image is too large.
pub fn light_on_pixels<T: ConvReal>(
    galaxies: &[SersicSource],
    shape: FrameShape,
) -> Result<Image<T>, PsfieldError> {
    let side = 2 * FINE + 1;
    let grid = StampGrid::new(side, side)?
        .with_oversampling(FINE as f64)?
        .with_pixel_response_included(false);
    let mut stamps = Array3::zeros((1, side, side));
    stamps[[0, FINE, FINE]] = (FINE * FINE) as f64;
    let samples = PsfSamples::new(
        stamps,
        SamplePositions::new(vec![Position::of_pixel(0, 0)], None)?,
        grid,
    )?;
    let simulator = Psf::new(samples, FitOptions::default())
        .simulator((shape.ny(), shape.nx()))
        .build()?;
    simulator.simulate(&Scene::dark().with_galaxies(galaxies))
}

#[cfg(test)]
mod tests {
    use psf_types::SersicProfile;

    use super::*;

    /// At centres up to a third of a pixel from the middle of a pixel.
    #[test]
    fn light_of_a_small_galaxy_falls_in_its_pixel() {
        let shape = FrameShape::new(17, 17).unwrap();
        for (i, j) in (0..=12).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            let [x, y] = [i, j].map(|v| 8.0 + f64::from(v) / 36.0);
            let profile = SersicProfile::new(0.01, 1.0, 1.0, 0.0).unwrap();
            let galaxy = SersicSource::new(Position::new(x, y).unwrap(), 1.0, profile).unwrap();
            let light = light_on_pixels::<f64>(&[galaxy], shape).unwrap().into_pixels();
            let mut worst = 0.0_f64;
            for (place, v) in light.indexed_iter() {
                let truth = if place == (8, 8) { 1.0 } else { 0.0 };
                worst = worst.max((v - truth).abs());
            }
            assert!(
                worst < 0.17 && (light.sum() - 1.0).abs() < 1e-6,
                "{x} {y}: {worst}"
            );
        }
    }
}
