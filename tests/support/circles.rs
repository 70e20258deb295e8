//! The error of the flux in circles about sources, pixel by pixel and star by star.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psfield::conv_core::{ConvError, Engine, Operation, Paths, Plan, PlanOptions, SourcePlan};
use psfield::psf_types::{
    FrameShape, ImageView, NoProgress, PointSource, Position, PsfModel, PsfSource, SourceError, StampGrid,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::slice::from_ref;

/// The largest errors of some PSFs.
#[derive(Debug, Clone, Copy, Default)]
pub struct CircleErrors {
    /// The L2 error over the L2 norm of the PSF.
    pub l2: f64,
    /// The error of the flux in any circle about the source, over the flux of the PSF.
    pub circle: f64,
    /// The number of PSFs measured.
    pub count: usize,
    /// The mean number of modes per block of the plan.
    pub modes: f64,
}

impl CircleErrors {
    /// Adds a PSF: its image, and the exact PSF. `rings` is from [`rings_of`].
    fn add(&mut self, image: ArrayView2<'_, f64>, exact: ArrayView2<'_, f64>, rings: &[Vec<usize>]) {
        let error = &image - &exact;
        let norm = |values: ArrayView2<'_, f64>| values.iter().map(|v| v * v).sum::<f64>().sqrt();
        self.l2 = self.l2.max(norm(error.view()) / norm(exact));
        let nx = error.ncols();
        let (mut sum, mut most) = (0.0, 0.0_f64);
        for ring in rings {
            sum += ring.iter().map(|&i| error[[i / nx, i % nx]]).sum::<f64>();
            most = most.max(sum.abs());
        }
        self.circle = self.circle.max(most / exact.sum().abs());
        self.count += 1;
    }
}

/// The pixels of a stamp by their distance from its centre, the nearest first. Pixels of equal
/// distance share a ring.
fn rings_of(grid: StampGrid) -> Vec<Vec<usize>> {
    let squared = |i: usize| {
        let (x, y) = ((i % grid.nx()) as f64, (i / grid.nx()) as f64);
        (x - grid.centre_x()).powi(2) + (y - grid.centre_y()).powi(2)
    };
    let mut pixels: Vec<usize> = (0..grid.pixel_count()).collect();
    pixels.sort_by(|&a, &b| squared(a).total_cmp(&squared(b)));
    let rings = pixels.chunk_by(|&a, &b| squared(b) - squared(a) < 1e-9);
    rings.map(<[usize]>::to_vec).collect()
}

/// Measures the PSFs of `count` random positions whose stamps lie inside the frame: half of them as
/// lit pixels of a plan, half of them as stars at the centres of pixels. In f64. Stamps must have
/// the frame's sampling.
///
/// # Errors
/// [`ConvError`] if there is no plan or a PSF has no value.
///
/// # Panics
/// If the stamps have no central pixel, or are larger than the frame.
pub fn circle_errors(
    model: &PsfModel,
    frame: FrameShape,
    options: PlanOptions,
    count: usize,
) -> Result<CircleErrors, ConvError> {
    let grid = model.grid();
    let rings = rings_of(grid);
    let (cx, cy) = grid.whole_centre().expect("a central pixel");
    let engines = [Paths::Cheapest, Paths::Transforms].map(|paths| {
        let options = options.with_paths(paths);
        Plan::<f64>::new(model, frame, frame.region(), options).map(Engine::new)
    });
    let [cheapest, transforms] = engines;
    let engines = [cheapest?, transforms?];
    let stars = SourcePlan::<f64>::new(model, options, None)?;
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut errors = CircleErrors {
        modes: engines[0].plan().summary().mean_modes(),
        ..CircleErrors::default()
    };
    let mut turn = 0;
    while errors.count < count {
        // Sources so far apart that their stamps do not overlap. One image shows all of them.
        let offset = |rng: &mut ChaCha8Rng, length: usize, stamp: usize| {
            rng.random_range(0..=(length - stamp).min(stamp - 1))
        };
        let first = (
            offset(&mut rng, frame.nx(), grid.nx()),
            offset(&mut rng, frame.ny(), grid.ny()),
        );
        let corners: Vec<(usize, usize)> = (first.1..=frame.ny() - grid.ny())
            .step_by(grid.ny())
            .flat_map(|y| {
                let columns = (first.0..=frame.nx() - grid.nx()).step_by(grid.nx());
                columns.map(move |x| (x, y))
            })
            .collect();
        let mut image = engines[0].plan().zeros();
        if turn % 2 == 0 {
            let mut light = Array2::zeros((frame.ny(), frame.nx()));
            for &(x, y) in &corners {
                light[[y + cy, x + cx]] = 1.0;
            }
            let light = ImageView::new(light.view()).map_err(ConvError::Result)?;
            engines[turn / 2 % 2].execute(
                Operation::Convolve,
                from_ref(&light),
                vec![image.view_mut()],
                &NoProgress,
            )?;
        } else {
            let at = |&(x, y): &(usize, usize)| {
                PointSource::new(Position::of_pixel((x + cx) as i64, (y + cy) as i64), 1.0)
            };
            let catalogue: Vec<PointSource> = corners
                .iter()
                .map(at)
                .collect::<Result<_, _>>()
                .map_err(ConvError::Result)?;
            let whole = frame.region();
            stars.draw_stars_into(&catalogue, whole, whole, image.view_mut(), &NoProgress)?;
        }
        for &(x, y) in corners.iter().take(count - errors.count) {
            let exact = model.psf_at(Position::of_pixel((x + cx) as i64, (y + cy) as i64))?;
            let image = image.slice(s![y..y + grid.ny(), x..x + grid.nx()]);
            errors.add(image, exact.values(), &rings);
        }
        turn += 1;
    }
    Ok(errors)
}

/// A PSF with a core that widens along x and a wide halo with 5 % of the flux that varies over the
/// field. The halo is so faint that it hardly counts in the L2 norm.
#[derive(Debug, Clone, Copy)]
pub struct Halo {
    /// Columns and rows of the stamps.
    pub side: usize,
    /// Columns and rows of the field.
    pub field: usize,
}

impl PsfSource for Halo {
    fn grid(&self) -> StampGrid {
        StampGrid::new(self.side, self.side).expect("not empty")
    }

    fn field(&self) -> FrameShape {
        FrameShape::new(self.field, self.field).expect("not empty")
    }

    fn draw_into(&self, position: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        let (x, y) = (position.x() / self.field as f64, position.y() / self.field as f64);
        let (width, halo_width) = (1.5 + 0.3 * x, self.side as f64 * (0.1 + 0.1 * y + 0.05 * x * x));
        let (halo_x, halo_y) = (0.2 * halo_width * (x - 0.5), 0.3 * halo_width * (y - 0.5) * x);
        let centre = (self.side / 2) as f64;
        let mut core = Array2::zeros(stamp.dim());
        let mut halo = Array2::zeros(stamp.dim());
        for ((j, i), core) in core.indexed_iter_mut() {
            let (dx, dy) = (i as f64 - centre, j as f64 - centre);
            *core = (1.0 + (dx * dx + dy * dy) / (width * width)).powi(-4);
            let r2 = (dx - halo_x).powi(2) + (dy - halo_y).powi(2);
            halo[[j, i]] = (-r2 / (2.0 * halo_width * halo_width)).exp();
        }
        let (core_flux, halo_flux): (f64, f64) = (core.sum(), halo.sum());
        stamp.assign(&(core * (0.95 / core_flux) + halo * (0.05 / halo_flux)));
        Ok(())
    }
}
