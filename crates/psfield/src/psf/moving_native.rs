//! The native PSF of exposures during which the light moves, each in its own way.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array1, Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use psf_types::{Position, PsfModelRecord, SampleCoefficients, SamplePositions, StampGrid};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::motion::{Motion, Moving};
use super::resample::{native_grid_of, native_picks, on_basis};
use super::{Origin, Psf};
use crate::error::PsfieldError;
use crate::stack_size::check_stack;
use crate::stamp_plane::StampPlane;

/// A PSF whose light moves differently in each exposure, for images. The transforms of its stamps are
/// made once. Only the native pixels of moved stamps are computed.
///
/// An exposure has a mixture of the PSF's states. It has as many stamps as the basis has components or,
/// if this is less, as there are positions of samples ([`OwnStamps`]).
#[derive(Debug)]
pub(crate) struct MovingNative {
    psf: Psf,
    /// The longest motion along x and y, in frame pixels.
    reach: [f64; 2],
    moving: Moving,
    native: StampGrid,
    /// The transforms of native stamps.
    native_plane: StampPlane,
    mean: Option<Array2<Complex64>>,
    /// For each state, or once if all states share their stamps: two stamps in each transform.
    transforms: Vec<Vec<Array2<Complex64>>>,
    own: Option<OwnStamps>,
}

/// The longest motion for which there is room, in frame pixels along each axis. More room would make all
/// exposures slower.
const MOST_ROOM: f64 = 8.0;

impl MovingNative {
    /// Prepares a PSF for these motions, one for each exposure. `None` if its native pixels are not some
    /// of the pixels of its stamps, if the caller implements its coefficient field, or if the transforms
    /// are too large for the memory.
    pub(crate) fn new(psf: &Psf, motions: &[Motion]) -> Result<Option<Self>, PsfieldError> {
        if matches!(psf.0.origin, Origin::Model(..)) {
            return Ok(None);
        }
        let psf = psf.with_pixel_response()?;
        let grid = psf.grid();
        if !native_picks(grid) {
            return Ok(None);
        }
        let reach = [0, 1].map(|axis| {
            let of_motions = motions.iter().map(|motion| motion.reach()[axis]);
            of_motions.fold(0.0, f64::max).min(MOST_ROOM)
        });
        let moving = Moving::new(grid, reach)?;
        let native = native_grid_of(moving.target, 1.0, 0.0, || 0)?;
        let step = moving.oversampling as usize;
        let [ny, nx] = moving.plane.shape().map(|n| n / step);
        let record = psf.record_without_wings()?;
        let basis = record.basis();
        let fits = |stamps: usize| check_stack(2 * (stamps + 1), moving.target).is_ok();
        // For fewer exposures than states, to make the stamps of all states would take longer.
        let pays = record.coefficients().positions().state_count() <= motions.len();
        let own = pays.then(|| OwnStamps::new(record)).flatten();
        let own = own.filter(|own| fits(own.stamp_count()));
        if own.is_none() && !fits(basis.rank()) {
            return Ok(None);
        }
        let two = |two: &[ArrayView2<'_, f64>]| moving.plane.forward(two, moving.margin);
        let pairs = |stamps: ArrayView3<'_, f64>| {
            let stamps: Vec<_> = stamps.outer_iter().collect();
            stamps.par_chunks(2).map(two).collect::<Vec<_>>()
        };
        let transforms = match &own {
            Some(own) => own.of_states(record).map(|stamps| pairs(stamps.view())).collect(),
            None => vec![pairs(basis.components())],
        };
        Ok(Some(Self {
            native_plane: StampPlane::new((ny, nx), 1),
            mean: basis.mean().map(|mean| two(&[mean.view()])),
            transforms,
            own,
            native,
            moving,
            psf,
            reach,
        }))
    }

    /// The PSF of an exposure during which all light moves, with native stamps. `weights` are those of
    /// the PSF's states, `[1, state]`, if it has states. `None` for a motion that is too long.
    pub(crate) fn psf(
        &self,
        motion: &Motion,
        weights: Option<&Array2<f64>>,
    ) -> Result<Option<Psf>, PsfieldError> {
        if motion
            .reach()
            .iter()
            .zip(self.reach)
            .any(|(&reach, most)| reach > most)
        {
            return Ok(None);
        }
        let record = self.psf.record()?;
        let of_mixture;
        let (nodes, of_states) = match (&self.own, weights) {
            (Some(own), Some(weights)) => (&own.coefficients, weights.row(0).to_vec()),
            (None, Some(weights)) => {
                let method = (record.interpolation(), record.outside());
                of_mixture = coeff_field::mix_states(record.coefficients(), method, weights.view(), None)?;
                (&of_mixture, vec![1.0])
            }
            (_, None) => (record.coefficients(), vec![1.0]),
        };
        let (fine, native, s) = (self.moving.target, self.native, self.moving.oversampling);
        // The stamp pixel of the first native pixel.
        let first = [
            fine.centre_x() - s * native.centre_x(),
            fine.centre_y() - s * native.centre_y(),
        ];
        let factor = self.moving.factor(motion, first.map(|at| -at));
        let moved = |parts: &[(f64, &Array2<Complex64>)]| {
            let thinned = self.moving.plane.thinned(parts, &factor, s as usize);
            self.native_plane.inverse(thinned)
        };
        let mean = self.mean.as_ref().map(|mean| {
            let [mean, _] = moved(&[(1.0, mean)]);
            mean.slice_move(s![..native.ny(), ..native.nx()])
        });
        let mut stamps = Array3::zeros((nodes.component_count(), native.ny(), native.nx()));
        let mut pairs: Vec<_> = stamps.axis_chunks_iter_mut(Axis(0), 2).collect();
        pairs.par_iter_mut().enumerate().for_each(|(pair, stamps)| {
            let of_states = of_states.iter().zip(&self.transforms);
            let parts = of_states.map(|(&weight, state)| (weight, &state[pair]));
            let parts: Vec<_> = parts.filter(|(weight, _)| *weight != 0.0).collect();
            for (mut stamp, moved) in stamps.outer_iter_mut().zip(moved(&parts)) {
                stamp.assign(&moved.slice(s![..native.ny(), ..native.nx()]));
            }
        });
        let made = psf_basis::orthonormal_in_order(mean, stamps, nodes.values(), native)?;
        let moved = on_basis(record, made, nodes.positions().clone())?;
        Ok(Some(self.psf.with_record(moved)))
    }
}

/// Stamps of each state, fewer than the components of the basis. The PSF of state `p` at the position of
/// sample `j`, without the mean, is `sum_i U_ji Z_pi`. The matrix `U` is orthogonal and the same for all
/// states, so a mixture of the states has the mixed stamps `Z` and the same `U`. Their order is that of
/// their squared norms, added up over the states: the largest first.
#[derive(Debug)]
struct OwnStamps {
    /// `U`, `[position, stamp]`.
    coefficients: SampleCoefficients,
    /// For each state, the coefficients of the basis in its stamps, `[stamp, component]`.
    of_components: Vec<Array2<f64>>,
}

/// Stamps below this fraction of the first are rounding errors.
const ROUNDING: f64 = 1e-15;

impl OwnStamps {
    /// `None` without states, if the states' samples are not at the same positions, or if there are not
    /// fewer stamps than components.
    fn new(record: &PsfModelRecord) -> Option<Self> {
        let all = record.coefficients();
        let states = all.positions().state_count();
        let count = all.positions().len() / states;
        let first = all.positions().samples_of_state(0);
        let at: Vec<_> = first
            .iter()
            .map(|&sample| all.positions().as_slice()[sample])
            .collect();
        if states < 2 || count >= all.component_count() {
            return None;
        }
        let of_state = |state| {
            let samples = all.positions().samples_of_state(state);
            let is_equal =
                |(&sample, position): (&usize, &Position)| all.positions().as_slice()[sample] == *position;
            (samples.len() == count && samples.iter().zip(&at).all(is_equal))
                .then(|| all.values().select(Axis(0), &samples))
        };
        let values: Vec<Array2<f64>> = (0..states).map(of_state).collect::<Option<_>>()?;
        let mut products = Array2::zeros((count, count));
        for values in &values {
            products += &values.dot(&values.t());
        }
        let eigen = SymmetricEigen::new(DMatrix::from_fn(count, count, |i, j| products[(i, j)]));
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let turn = Array2::from_shape_fn((count, count), |(j, i)| eigen.eigenvectors[(j, order[i])]);
        let of_components: Vec<_> = values.iter().map(|values| turn.t().dot(values)).collect();
        let size = |i: usize| {
            let of_state = |of_state: &Array2<f64>| of_state.row(i).dot(&of_state.row(i));
            of_components.iter().map(of_state).sum::<f64>().sqrt()
        };
        let sizes: Array1<f64> = (0..count).map(size).collect();
        let kept: Vec<_> = (0..count).filter(|&i| sizes[i] > ROUNDING * sizes[0]).collect();
        let positions = SamplePositions::new(at, all.positions().field()).ok()?;
        Some(Self {
            coefficients: SampleCoefficients::new(turn.select(Axis(1), &kept), positions).ok()?,
            of_components: of_components
                .iter()
                .map(|all| all.select(Axis(0), &kept))
                .collect(),
        })
    }

    /// The number of stamps of all states.
    fn stamp_count(&self) -> usize {
        self.of_components.len() * self.coefficients.component_count()
    }

    /// The stamps of each state, `[stamp, y, x]`.
    fn of_states(&self, record: &PsfModelRecord) -> impl Iterator<Item = Array3<f64>> {
        let components = record.basis().components();
        let (rank, ny, nx) = components.dim();
        self.of_components.iter().map(move |factors| {
            let flat = components.to_shape((rank, ny * nx)).expect("as many values");
            let stamps = factors.dot(&flat);
            stamps
                .into_shape_with_order((factors.nrows(), ny, nx))
                .expect("row-major")
        })
    }
}

#[cfg(test)]
mod tests {
    use std::slice::from_ref;

    use ndarray::array;
    use psf_types::{SampleStates, StateKind};

    use super::*;

    /// Rounding of transforms, relative to the peak.
    const ROUNDING: f64 = 1e-12;
    const AT: [(f64, f64); 3] = [(0.0, 0.0), (90.0, 10.0), (30.0, 70.0)];

    /// Samples of Gaussians at the first positions, in some states.
    fn psf((oversampling, side): (f64, usize), positions: usize, states: usize) -> Psf {
        let count = positions * states;
        let stamps = Array3::from_shape_fn((count, side, side + 3), |(j, y, x)| {
            let (u, v) = (x as f64 - 20.0, y as f64 - 19.0 + (j % positions) as f64);
            (-(u * u + 0.6 * u * v + v * v) / (4.0 + 1.3 * j as f64) / oversampling).exp()
        });
        let grid = StampGrid::new(side + 3, side)
            .unwrap()
            .with_oversampling(oversampling)
            .unwrap()
            .with_centre(20.0, 19.0)
            .unwrap()
            .with_pixel_response_included(true);
        let at = (0..count).map(|j| AT[j % positions]);
        let at = at.map(|(x, y)| Position::new(x, y).unwrap()).collect();
        let times: Vec<f64> = (0..count).map(|j| (j / positions) as f64).collect();
        let states = (states > 1).then(|| SampleStates::new(StateKind::Time, &times).unwrap());
        let positions = SamplePositions::with_states(at, None, states).unwrap();
        let psf = Psf::from(psf_types::PsfSamples::new(stamps, positions, grid).unwrap());
        psf.fitted().unwrap()
    }

    #[test]
    fn native_stamps_are_pixels_of_the_moved_stamps() {
        let motions = [([-0.3, 0.1], [0.9, 0.4]), ([0.2, -4.0], [0.2, -0.4])].map(|(from, to)| {
            let line = Motion::along_line(from, to).unwrap();
            line.with_jitter_px(0.4).unwrap()
        });
        let [along_x, none] = [[0.5, 0.0], [0.0, 0.0]].map(Motion::fixed);
        for (sampling, positions, states) in [
            ((1.0, 21), 3, 1),
            ((2.0, 40), 3, 1),
            ((3.0, 45), 1, 1),
            ((3.0, 45), 3, 3),
            ((2.0, 40), 2, 3),
            ((1.0, 21), 1, 3),
        ] {
            let psf = psf(sampling, positions, states);
            let weights = (states == 3).then(|| array![[0.25, 0.0, 0.75]]);
            let mixed = match &weights {
                Some(weights) => psf.mixed(weights.view(), None).unwrap(),
                None => psf.clone(),
            };
            for motions in [&motions[..], from_ref(&along_x), from_ref(&none)] {
                let exposures: Vec<_> = motions.iter().cycle().take(3).cloned().collect();
                let moving = MovingNative::new(&psf, &exposures).unwrap().unwrap();
                let has_own = moving.own.as_ref().map(OwnStamps::stamp_count);
                assert_eq!(has_own, (states > 1).then_some(positions * states), "{states}");
                for motion in motions {
                    let found = moving.psf(motion, weights.as_ref()).unwrap().unwrap();
                    let room = Moving::new(psf.grid(), moving.reach).unwrap();
                    let expected = mixed.moved_in(&room, motion).unwrap().native(None).unwrap();
                    for (x, y) in AT {
                        let at = Position::new(x + 1.0, y + 2.0).unwrap();
                        let [found, expected] =
                            [&found, &expected].map(|psf| psf.model().unwrap().psf_at(at).unwrap());
                        let peak = expected.values().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
                        assert_eq!(found.grid(), expected.grid());
                        for (value, other) in expected.values().iter().zip(found.values()) {
                            let difference = (value - other).abs();
                            assert!(difference < ROUNDING * peak, "{sampling:?}: {value} {other}");
                        }
                    }
                }
                let few = MovingNative::new(&psf, &exposures[..1]).unwrap().unwrap();
                assert!(few.own.is_none());
                let long = Motion::along_line([0.0, 0.0], [9.0, 0.0]).unwrap();
                assert!(moving.psf(&long, weights.as_ref()).unwrap().is_none());
            }
        }
    }
}
