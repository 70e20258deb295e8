//! Objects as the fast engine draws them, by transforms alone.

use std::time::Instant;

use conv_core::PlanOptions;
use ndarray::{Array2, ArrayView2, s};
use psf_types::{FrameShape, Image, NoProgress, PsfModel, Scene};

use crate::{Method, PsfieldError, Simulation};

/// One image of the whole frame: objects cut out of it, and how long it took.
#[derive(Debug)]
pub(super) struct Drawn {
    pub(super) windows: Vec<Array2<f64>>,
    pub(super) seconds: f64,
}

/// What is drawn at every pixel of a list: scenes of the kinds, imaged with one plan in single precision by transforms alone, and a window of
/// the stamps' size cut out about each object.
///
/// # Errors
/// [`PsfieldError::Convolution`].
pub(super) fn draw_by_transforms(
    model: &PsfModel,
    frame: FrameShape,
    pixels: &[(usize, usize)],
    kinds: &[ArrayView2<'_, f64>],
    tolerance: f64,
) -> Result<Vec<Drawn>, PsfieldError> {
    let simulation = Simulation::with_model(model.clone());
    let options = PlanOptions::new(tolerance)?;
    let options = Method::LowRank.plan_options(options).unwrap_or(options);
    let shape = Scene::<f32>::from_image(Image::zeros(frame));
    let plan = simulation.plan(&shape, options)?;
    drop(shape);
    let mut drawn = Vec::with_capacity(kinds.len());
    for light in kinds {
        let scene = Scene::from_image(Image::new(scattered(frame, pixels, *light))?);
        let clock = Instant::now();
        let (image, _) = simulation.run_planned(&plan, &scene, &NoProgress)?;
        let seconds = clock.elapsed().as_secs_f64();
        let grid = model.grid();
        let centre = grid.whole_centre().unwrap_or((grid.nx() / 2, grid.ny() / 2));
        let windows = pixels
            .iter()
            .map(|&(x, y)| {
                let (x0, y0) = (x - centre.0, y - centre.1);
                let window = image.pixels();
                window
                    .slice(s![y0..y0 + grid.ny(), x0..x0 + grid.nx()])
                    .mapv(f64::from)
            })
            .collect();
        drawn.push(Drawn { windows, seconds });
    }
    Ok(drawn)
}

/// The same light about every pixel, its pixel `n / 2` along each axis on it.
fn scattered(frame: FrameShape, pixels: &[(usize, usize)], light: ArrayView2<'_, f64>) -> Array2<f32> {
    let (rows, columns) = light.dim();
    let mut scene = Array2::zeros((frame.ny(), frame.nx()));
    for &(x, y) in pixels {
        let (x0, y0) = (x - columns / 2, y - rows / 2);
        let mut part = scene.slice_mut(s![y0..y0 + rows, x0..x0 + columns]);
        part.zip_mut_with(&light, |p, &v| *p += v as f32);
    }
    scene
}
