//! Stars and galaxies over the frame, and their true images.

use std::time::Instant;

use ndarray::{Array2, ArrayView2, Zip, s};
use psf_types::{FrameShape, NoProgress, Position, PsfModel, PsfSource, SersicProfile, SersicSource};
use psfield::{Device, Method, Psf, Scene};
use rayon::prelude::*;

use crate::LabError;
use crate::report::{Evaluation, ObjectKind, ToleranceRow};

/// Half-light radius in pixels, Sersic index, axis ratio, and angle in degrees of every galaxy.
pub(super) const GALAXY: [f64; 4] = [3.0, 1.0, 0.7, 30.0];
/// Pixels along each side of the array that holds a galaxy. The true image and the simulated scene
/// use this array.
const GALAXY_SIDE: usize = 32;

/// Objects and their true images.
#[derive(Debug)]
pub(super) struct Scenes {
    frame: FrameShape,
    columns: usize,
    pixels: Vec<(usize, usize)>,
    pub(super) positions: Vec<Position>,
    galaxy: Array2<f64>,
    pub(super) star_truth: Vec<Array2<f64>>,
    galaxy_truth: Vec<Array2<f64>>,
}

impl Scenes {
    /// Makes a grid of `across` by `across` positions, and computes the true image of a star and of
    /// a galaxy at each from the telescope's optics.
    ///
    /// # Errors
    /// [`LabError::ObjectsTooClose`] if the frame has no room for the objects,
    /// [`ErrorKind::Sampling`](psfield::ErrorKind::Sampling) if the telescope cannot draw a PSF.
    pub(super) fn new(telescope: &dyn PsfSource, across: usize) -> Result<Self, LabError> {
        let (frame, grid) = (telescope.field(), telescope.grid());
        let margin = grid.nx().max(grid.ny());
        let pixels = object_pixels(frame, across, margin, margin + GALAXY_SIDE)?;
        let of_pixel = |&(x, y): &(usize, usize)| Position::of_pixel(x as i64, y as i64);
        let positions: Vec<Position> = pixels.iter().map(of_pixel).collect();
        let galaxy = galaxy_light()?;
        Ok(Self {
            star_truth: true_psfs(telescope, &positions)?,
            galaxy_truth: pixels
                .par_iter()
                .map(|&at| true_galaxy(telescope, at, galaxy.view()))
                .collect::<Result<_, _>>()?,
            frame,
            columns: across,
            pixels,
            positions,
            galaxy,
        })
    }

    /// Draws stars and galaxies at a tolerance, measures them, and adds a row for each kind to
    /// `rows`. One plan in single precision convolves the scenes of both kinds, with Fourier
    /// transforms for all tiles.
    ///
    /// # Errors
    /// [`LabError`] if the plan cannot be made or a convolution fails.
    pub(super) fn drawn(
        &self,
        model: &PsfModel,
        tolerance: f64,
        rows: &mut Vec<ToleranceRow>,
    ) -> Result<(Evaluation, Evaluation), LabError> {
        let simulator = Psf::from(model.clone())
            .simulator((self.frame.ny(), self.frame.nx()))
            .method(Method::LowRank)
            .tolerance(tolerance)
            .device(Device::Cpu)
            .build::<f32>()?;
        simulator.prepare(&Scene::streamed(), &NoProgress)?;
        let (grid, frame) = (model.grid(), Some(self.frame));
        let centre = grid.whole_centre().unwrap_or((grid.nx() / 2, grid.ny() / 2));
        // Copies the window around an object. It has the size of a stamp.
        let window = |image: ArrayView2<'_, f32>, &(x, y): &(usize, usize)| {
            let (x0, y0) = (x - centre.0, y - centre.1);
            let window = image.slice(s![y0..y0 + grid.ny(), x0..x0 + grid.nx()]);
            window.mapv(f64::from)
        };
        let mut measured = |kind, light, truth: &[Array2<f64>]| -> Result<Evaluation, LabError> {
            let scene = Scene::new(scattered(self.frame, &self.pixels, light))?;
            let clock = Instant::now();
            let image = simulator.simulate(&scene)?;
            let seconds = clock.elapsed().as_secs_f64();
            let windows = self.pixels.iter().map(|at| window(image.pixels(), at));
            let windows: Vec<Array2<f64>> = windows.collect();
            let objects =
                Evaluation::measure(&self.positions, &windows, truth, 1.0, frame, Some(self.columns));
            rows.push(ToleranceRow {
                tolerance,
                kind,
                summary: objects.summary.clone(),
                seconds,
            });
            Ok(objects)
        };
        let star = Array2::from_elem((1, 1), 1.0);
        let stars = measured(ObjectKind::Point, star.view(), &self.star_truth)?;
        let galaxies = measured(ObjectKind::Extended, self.galaxy.view(), &self.galaxy_truth)?;
        Ok((stars, galaxies))
    }
}

/// Returns a galaxy of unit flux on its array. The galaxy ends at the edges of the array, in the
/// scene and in the true image.
fn galaxy_light() -> Result<Array2<f64>, LabError> {
    let [radius, index, axis_ratio, angle] = GALAXY;
    let profile = SersicProfile::new(radius, index, axis_ratio, angle)?;
    let middle = Position::of_pixel((GALAXY_SIDE / 2) as i64, (GALAXY_SIDE / 2) as i64);
    let galaxy = SersicSource::new(middle, 1.0, profile)?;
    let shape = FrameShape::new(GALAXY_SIDE, GALAXY_SIDE)?;
    let light = psfield::light_on_pixels::<f64>(&[galaxy], shape)?.into_pixels();
    let sum = light.sum();
    Ok(light / sum)
}

/// Returns the pixels of a grid of `across` by `across` objects, ordered by y, then x. They are at
/// least `margin` pixels from the frame's edges.
///
/// # Errors
/// [`LabError::ObjectsTooClose`] if neighbours would be closer than `least_apart` pixels, or if the
/// margins leave no room.
fn object_pixels(
    frame: FrameShape,
    across: usize,
    margin: usize,
    least_apart: usize,
) -> Result<Vec<(usize, usize)>, LabError> {
    let axis = |length: usize| -> Option<Vec<usize>> {
        let room = length.checked_sub(2 * margin + 1)?;
        let step = room as f64 / across.saturating_sub(1).max(1) as f64;
        (across == 1 || step >= least_apart as f64).then(|| {
            (0..across)
                .map(|k| margin + (k as f64 * step).round() as usize)
                .collect()
        })
    };
    let (Some(columns), Some(rows)) = (axis(frame.nx()), axis(frame.ny())) else {
        return Err(LabError::ObjectsTooClose {
            frame,
            across,
            least_apart,
        });
    };
    Ok(rows
        .iter()
        .flat_map(|&y| columns.iter().map(move |&x| (x, y)))
        .collect())
}

/// Offsets of the nodes from a galaxy's centre along each axis, in units of half the side of the
/// galaxy's array. The optics draw the PSF at the nine nodes. Between the nodes, the PSF is
/// interpolated by a polynomial of degree 2 in x and in y. The error of this interpolation is far
/// below the measured differences, because the nodes are much closer to each other than the
/// samples of the model.
const NODES: [f64; 3] = [-1.0, 0.0, 1.0];

/// Returns the PSF that `source` draws at a position, scaled to unit flux.
///
/// # Errors
/// [`ErrorKind::Sampling`](psfield::ErrorKind::Sampling) if the PSF cannot be drawn.
pub(super) fn true_psf(source: &dyn PsfSource, at: Position) -> Result<Array2<f64>, LabError> {
    let stamp = source.draw(at)?;
    let flux = stamp.flux();
    Ok(stamp.into_values() / flux)
}

/// Returns the PSFs that `source` draws at some positions, scaled to unit flux.
///
/// # Errors
/// [`ErrorKind::Sampling`](psfield::ErrorKind::Sampling) if a PSF cannot be drawn.
pub(super) fn true_psfs(
    source: &dyn PsfSource,
    positions: &[Position],
) -> Result<Vec<Array2<f64>>, LabError> {
    positions.par_iter().map(|&at| true_psf(source, at)).collect()
}

/// Returns the true image of a galaxy. `galaxy` `[y, x]` is its light, and the middle pixel of this
/// array (`n / 2` along an axis of `n` pixels) is at pixel `(x, y)` of the frame. Each pixel of the
/// galaxy is convolved with the PSF of its own position.
/// The image has the size and the centre of the PSF's stamps.
///
/// # Errors
/// [`ErrorKind::Sampling`](psfield::ErrorKind::Sampling) if a PSF cannot be drawn.
fn true_galaxy(
    source: &dyn PsfSource,
    (x, y): (usize, usize),
    galaxy: ArrayView2<'_, f64>,
) -> Result<Array2<f64>, LabError> {
    let (rows, columns) = galaxy.dim();
    let half = rows.max(columns) as f64 / 2.0;
    let mut nodes = Vec::with_capacity(9);
    for dy in NODES {
        for dx in NODES {
            let at = Position::new(x as f64 + dx * half, y as f64 + dy * half)?;
            nodes.push(true_psf(source, at)?);
        }
    }
    let mut window = Array2::zeros(nodes[0].dim());
    let (ny, nx) = window.dim();
    let mut of_row: [Array2<f64>; 3] = std::array::from_fn(|_| Array2::zeros((ny, nx)));
    let mut psf = Array2::<f64>::zeros((ny, nx));
    for (j, line) in galaxy.outer_iter().enumerate() {
        let dy = j as i64 - (rows / 2) as i64;
        let wy = lagrange(dy as f64 / half);
        for (column, sum) in of_row.iter_mut().enumerate() {
            sum.fill(0.0);
            for (row, w) in wy.iter().enumerate() {
                sum.scaled_add(*w, &nodes[row * 3 + column]);
            }
        }
        for (i, &light) in line.iter().enumerate() {
            if light == 0.0 {
                continue;
            }
            let dx = i as i64 - (columns / 2) as i64;
            let [a, b, c] = lagrange(dx as f64 / half).map(|w| w * light);
            Zip::from(&mut psf)
                .and(&of_row[0])
                .and(&of_row[1])
                .and(&of_row[2])
                .for_each(|p, &l, &m, &r| *p = a * l + b * m + c * r);
            let ((y0, y1), (v0, v1)) = overlap(dy, ny);
            let ((x0, x1), (u0, u1)) = overlap(dx, nx);
            let mut part = window.slice_mut(s![y0..y1, x0..x1]);
            part += &psf.slice(s![v0..v1, u0..u1]);
        }
    }
    Ok(window)
}

/// The values at `t` of three polynomials of degree 2. Each is 1 at one of the [`NODES`] and 0 at
/// the other two.
fn lagrange(t: f64) -> [f64; 3] {
    [0.5 * t * (t - 1.0), (1.0 - t) * (1.0 + t), 0.5 * t * (t + 1.0)]
}

/// Moves a stamp of `n` pixels over a window of `n` pixels by `shift` pixels. Returns the range of
/// the window's pixels that the stamp covers, and the range of the stamp's pixels that cover them.
fn overlap(shift: i64, n: usize) -> ((usize, usize), (usize, usize)) {
    let moved = shift.unsigned_abs().min(n as u64) as usize;
    if shift >= 0 {
        ((moved, n), (0, n - moved))
    } else {
        ((0, n - moved), (moved, n))
    }
}

/// Returns a frame with a copy of `light` at each of `pixels`. The middle pixel of `light` (`n / 2`
/// along an axis of `n` pixels) lies on this pixel of the frame.
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

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::ArrayViewMut2;
    use psf_types::{SourceError, StampGrid};

    #[test]
    fn objects_keep_their_distances() {
        let frame = FrameShape::new(500, 300).unwrap();
        let pixels = object_pixels(frame, 3, 40, 90).unwrap();
        assert_eq!(pixels.len(), 9);
        assert_eq!((pixels[0], pixels[8]), ((40, 40), (459, 259)));
        assert!(matches!(
            object_pixels(frame, 4, 40, 90),
            Err(LabError::ObjectsTooClose { across: 4, .. })
        ));
        assert!(object_pixels(frame, 2, 200, 90).is_err());
    }

    /// A PSF with the fraction `x^2 / 1e4 + y / 1e3` of its light one pixel to the right.
    #[derive(Debug)]
    struct Leaning;
    fn part(x: f64, y: f64) -> f64 {
        x * x / 1e4 + y / 1e3
    }
    impl PsfSource for Leaning {
        fn grid(&self) -> StampGrid {
            StampGrid::new(16, 16).unwrap()
        }
        fn field(&self) -> FrameShape {
            FrameShape::new(100, 100).unwrap()
        }
        fn draw_into(&self, at: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
            stamp.fill(0.0);
            stamp[[8, 8]] = 1.0 - part(at.x(), at.y());
            stamp[[8, 9]] = part(at.x(), at.y());
            Ok(())
        }
    }

    #[test]
    fn each_pixel_has_the_psf_of_its_own_position() {
        let galaxy = Array2::from_shape_fn((5, 5), |(y, x)| (1 + y * 5 + x) as f64);
        let window = true_galaxy(&Leaning, (40, 30), galaxy.view()).unwrap();
        let mut expected = Array2::<f64>::zeros((16, 16));
        for ((j, i), light) in galaxy.indexed_iter() {
            let (x, y) = (40.0 + i as f64 - 2.0, 30.0 + j as f64 - 2.0);
            expected[[8 + j - 2, 8 + i - 2]] += light * (1.0 - part(x, y));
            expected[[8 + j - 2, 9 + i - 2]] += light * part(x, y);
        }
        let largest = (&window - &expected).iter().fold(0.0f64, |m, v| m.max(v.abs()));
        // Only rounding, because the PSF is of degree 2 in x and in y.
        assert!(largest < 1e-12, "{largest}");
    }
}
