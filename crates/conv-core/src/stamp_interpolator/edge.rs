//! The light at the edges of stamps, and how far beyond its stamp an interpolated PSF is needed.

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, ArrayView3, Axis, s};
use psf_types::{PsfModel, StampGrid};

use super::kernel::{Kernel, MOST_REACH, POLE};

/// At most this fraction of a PSF's flux lies farther out than the reach, for any sub-pixel
/// position.
const NEGLIGIBLE: f64 = 5e-7;
/// The most PSFs of a model that are examined. They are evenly spread over the rows of weights.
const MOST_PSFS: usize = 512;
/// A spline's coefficient at the edge depends on this many lines of pixels: `POLE^30` is 7e-18.
const DEPTH: usize = 30;
/// A Lanczos kernel reaches this many pixels.
const LANCZOS: usize = 3;

/// The distance beyond the outermost pixels of stamps, in stamp pixels, up to which interpolated
/// PSFs hold light. At most 5e-7 of the flux of a PSF lies farther out. The distance is 0 if the
/// edges of all stamps are dark.
///
/// The PSFs are `mean + sum_k weights[n, k] stamps[k]` for the rows `n` of `weights`. If there are
/// more than 512 rows, 512 of them are used. Without weights, each of the `stamps` `[k, y, x]` is a
/// PSF.
///
/// # Panics
/// If the stamps do not have the grid's shape, or if there is not one weight per stamp.
pub fn edge_reach(
    mean: Option<ArrayView2<'_, f64>>,
    stamps: ArrayView3<'_, f64>,
    weights: Option<ArrayView2<'_, f64>>,
    grid: StampGrid,
) -> usize {
    let kernel = Kernel::of(grid.interpolation(), 0);
    let edges = |stamp: ArrayView2<'_, f64>| EdgeLines::new(stamp, kernel);
    let Some(weights) = weights else {
        let reaches = stamps.outer_iter().map(|stamp| {
            let lines = edges(stamp);
            reach(kernel, light(lines.lines.view()), lines.flux, grid.oversampling())
        });
        return reaches.max().unwrap_or(0);
    };
    let all: Vec<EdgeLines> = stamps.outer_iter().map(edges).collect();
    let mean = mean.map(edges);
    let length = all.first().map_or(0, |edges| edges.lines.len());
    let mut flat = Array2::zeros((all.len(), length));
    for (mut row, edges) in flat.outer_iter_mut().zip(&all) {
        row.assign(&edges.lines);
    }
    let (of_mean, flux_of_mean) = mean.map_or(([0.0; 2], 0.0), |m| (light(m.lines.view()), m.flux));
    let step = weights.nrows().div_ceil(MOST_PSFS).max(1);
    let (mut brightest, mut flux) = (of_mean, flux_of_mean.abs());
    for some in weights.slice(s![..;step, ..]).axis_chunks_iter(Axis(0), 64) {
        for (psf, weights) in some.dot(&flat).outer_iter().zip(some.outer_iter()) {
            let sums = light(psf);
            brightest = [0, 1].map(|i| brightest[i].max(of_mean[i] + sums[i]));
            let sum: f64 = weights.iter().zip(&all).map(|(w, e)| w * e.flux).sum();
            flux = flux.max((flux_of_mean + sum).abs());
        }
    }
    reach(kernel, brightest, flux, grid.oversampling())
}

/// The [`edge_reach`] of a model's PSFs.
pub fn edge_reach_of(model: &PsfModel) -> usize {
    let first = usize::from(model.is_mean_centred());
    let mean = model.is_mean_centred().then(|| model.stamp(0));
    let components = model.stamps().slice_move(s![first.., .., ..]);
    let nodes = model.some_coefficients();
    edge_reach(mean, components, Some(nodes.view()), model.grid())
}

/// The lines of a stamp that determine the light beyond its edges.
struct EdgeLines {
    /// Two halves, each for all four sides. For a spline: the outermost pixels, and the
    /// coefficients at the outermost pixels. For a Lanczos kernel: the three outermost lines of
    /// pixels, and 0.
    lines: Array1<f64>,
    /// The sum over the stamp.
    flux: f64,
}

impl EdgeLines {
    fn new(stamp: ArrayView2<'_, f64>, kernel: Kernel) -> Self {
        let (mut pixels, mut coefficients) = (Vec::new(), Vec::new());
        for axis in [Axis(0), Axis(1)] {
            let count = stamp.len_of(axis);
            for from_end in [false, true] {
                let line = |d: usize| stamp.index_axis(axis, if from_end { count - 1 - d } else { d });
                if kernel == Kernel::Lanczos3 {
                    pixels.extend((0..LANCZOS.min(count)).flat_map(|d| line(d).to_vec()));
                } else {
                    pixels.extend(line(0));
                    let mut sum = line(0).to_owned();
                    for d in 1..DEPTH.min(count) {
                        sum.scaled_add(POLE.powi(d as i32), &line(d));
                    }
                    coefficients.extend(sum.iter().map(|v| 3_f64.sqrt() * v));
                }
            }
        }
        coefficients.resize(pixels.len(), 0.0);
        pixels.extend(coefficients);
        Self {
            lines: pixels.into(),
            flux: stamp.sum(),
        }
    }
}

/// The sums of the absolute values of both halves of [`EdgeLines::lines`].
fn light(lines: ArrayView1<'_, f64>) -> [f64; 2] {
    let (pixels, coefficients) = lines.split_at(Axis(0), lines.len() / 2);
    [pixels, coefficients].map(|half| half.iter().map(|v| v.abs()).sum())
}

/// The largest absolute value of a spline less than a pixel beyond the outermost pixel, where the
/// coefficient is 1 and the value is small. Then also the largest value one pixel farther out,
/// divided by [`POLE`].
const NEAR: f64 = 0.4;
const FAR: f64 = 0.295;

/// Returns the reach of PSFs with these sums over their edges ([`EdgeLines::lines`]).
fn reach(kernel: Kernel, [pixels, coefficients]: [f64; 2], flux: f64, oversampling: f64) -> usize {
    // A star uses about every `oversampling`-th line, and its flux is the stamp's flux divided by
    // `oversampling^2`. So a line counts `oversampling` times as much as in the stamp.
    let scale = oversampling.max(1.0);
    let limit = NEGLIGIBLE * flux.abs();
    if kernel == Kernel::Lanczos3 {
        return if scale * pixels <= limit { 0 } else { LANCZOS };
    }
    let light = |reach: usize| match reach {
        0 => pixels.max(NEAR * coefficients),
        _ => FAR * coefficients * POLE.abs().powi(reach as i32),
    };
    (0..MOST_REACH)
        .find(|&reach| scale * light(reach) <= limit)
        .unwrap_or(MOST_REACH)
}
