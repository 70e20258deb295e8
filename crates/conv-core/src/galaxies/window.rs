//! Draws one galaxy on a square window, in Fourier space.

use std::sync::Arc;

use psf_types::LightProfile;
use realfft::{ComplexToReal, RealFftPlanner};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::spectrum::Wavenumbers;
use crate::ConvReal;
use crate::simd::{Lanes, WithIsa};

/// The transformed stamps from which the PSFs of some galaxies are combined.
#[derive(Debug)]
pub(super) struct Spectra<T> {
    pub(super) wavenumbers: Wavenumbers,
    /// `[stamp][wavenumber]`.
    pub(super) stamps: Vec<Vec<Complex<T>>>,
}

impl<T> Spectra<T> {
    pub(super) fn bytes(&self) -> usize {
        self.stamps
            .iter()
            .map(|stamp| size_of_val(stamp.as_slice()))
            .sum()
    }
}

/// Draws galaxies on windows of one side. Keeps the memory between galaxies.
pub(super) struct WindowDrawer<T: ConvReal> {
    side: usize,
    along_y: Arc<dyn Fft<T>>,
    along_x: Arc<dyn ComplexToReal<T>>,
    work: Work<T>,
}

/// Memory of a [`WindowDrawer`].
struct Work<T> {
    /// The transform of the window, folded: `[kx, ky]` with `kx = 0 ... side / 2`.
    folded: Vec<Complex<T>>,
    psf: Vec<Complex<T>>,
    transform: Vec<f64>,
    /// `exp(-i ky y)` for the galaxy's row `y`.
    turns: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
    lines: Vec<Complex<T>>,
}

/// Number of rows that are copied together from the transform's columns.
const ROWS_AT_ONCE: usize = 8;

/// A galaxy on a window: its light, its centre counted from the window's first pixel, and the
/// coefficients of the stamps that make its PSF, times its flux.
pub(super) struct Drawn<'a, T> {
    pub(super) spectra: &'a Spectra<T>,
    pub(super) light: &'a dyn LightProfile,
    pub(super) centre: (f64, f64),
    pub(super) coefficients: &'a [f64],
    /// Light at wavenumbers beyond this one, in radians per pixel, is left out.
    pub(super) band: f64,
}

impl<T: ConvReal> WindowDrawer<T> {
    pub(super) fn new(side: usize) -> Self {
        let zero = Complex::new(T::zero(), T::zero());
        let along_y = FftPlanner::new().plan_fft_inverse(side);
        let along_x = RealFftPlanner::new().plan_fft_inverse(side);
        let scratch = along_y.get_inplace_scratch_len().max(along_x.get_scratch_len());
        let half = side / 2 + 1;
        Self {
            side,
            along_y,
            along_x,
            work: Work {
                folded: vec![zero; half * side],
                psf: Vec::new(),
                transform: Vec::new(),
                turns: Vec::new(),
                scratch: vec![zero; scratch],
                lines: vec![zero; half * ROWS_AT_ONCE],
            },
        }
    }

    /// Computes the rows `rows` of a galaxy's image, which repeats with the period of the window.
    /// Gives the number of each row and its values to `take`.
    pub(super) fn draw(
        &mut self,
        galaxy: &Drawn<'_, T>,
        rows: std::ops::Range<usize>,
        mut take: impl FnMut(usize, &mut [T]),
    ) {
        T::dispatch(Fold {
            side: self.side,
            galaxy,
            work: &mut self.work,
        });
        let (side, half) = (self.side, self.side / 2 + 1);
        let Work {
            folded,
            scratch,
            lines,
            ..
        } = &mut self.work;
        let radius = (galaxy.band / galaxy.spectra.wavenumbers.step()).ceil() as usize;
        let columns = galaxy.spectra.wavenumbers.most_ky.len().min(radius + 1).min(half);
        self.along_y
            .process_with_scratch(&mut folded[..columns * side], scratch);
        let mut values = vec![T::zero(); side];
        for first in rows.clone().step_by(ROWS_AT_ONCE) {
            let count = ROWS_AT_ONCE.min(rows.end - first);
            for (kx, column) in folded.chunks_exact(side).enumerate() {
                for (line, &value) in column[first..first + count].iter().enumerate() {
                    lines[line * half + kx] = value;
                }
            }
            for (row, line) in lines.chunks_exact_mut(half).take(count).enumerate() {
                // The first and the last value of a real line's transform are real.
                line[0].im = T::zero();
                line[half - 1].im = T::zero();
                self.along_x
                    .process_with_scratch(line, &mut values, scratch)
                    .expect("the lengths of the plan");
                take(first + row, &mut values);
            }
        }
    }
}

/// Multiplies the transforms of galaxy and PSF, and folds them into the wavenumbers of the window's
/// pixels.
struct Fold<'a, 'b, T> {
    side: usize,
    galaxy: &'a Drawn<'b, T>,
    work: &'a mut Work<T>,
}

impl<T: ConvReal> WithIsa<T> for Fold<'_, '_, T> {
    type Output = ();
    fn run<S: Lanes<T>>(self, simd: S) {
        let Self { side, galaxy, work } = self;
        let wavenumbers = &galaxy.spectra.wavenumbers;
        let (step, half) = (wavenumbers.step(), side / 2);
        let zero = Complex::new(T::zero(), T::zero());
        let turn = |k: i64, at: f64| {
            let (sin, cos) = (-(k as f64) * step * at).sin_cos();
            Complex::new(T::nearest(cos), T::nearest(sin))
        };
        let most = wavenumbers.most_ky[0];
        work.turns.clear();
        work.turns
            .extend((-(most as i64)..=most as i64).map(|ky| turn(ky, galaxy.centre.1)));
        work.folded.fill(zero);
        work.psf.resize(2 * most + 1, zero);
        work.transform.resize(2 * most + 1, 0.0);
        let area = (side * side) as f64;
        let coefficients: Vec<T> = galaxy.coefficients.iter().map(|c| T::nearest(c / area)).collect();
        let radius = (galaxy.band / step).ceil();
        for (kx, (&stored, &start)) in wavenumbers.most_ky.iter().zip(&wavenumbers.starts).enumerate() {
            let within = radius * radius - (kx * kx) as f64;
            if within < 0.0 {
                break;
            }
            let most_ky = stored.min(within.sqrt() as usize);
            let (start, count) = (start + stored - most_ky, 2 * most_ky + 1);
            let transform = &mut work.transform[..count];
            galaxy
                .light
                .transform_into(kx as f64 * step, -(most_ky as f64) * step, step, transform);
            let psf = &mut work.psf[..count];
            let turns = &work.turns[most - most_ky..=most + most_ky];
            let turn_x = turn(kx as i64, galaxy.centre.0);
            simd.vectorized(
                #[inline(always)]
                || {
                    psf.fill(zero);
                    for (stamp, &c) in galaxy.spectra.stamps.iter().zip(&coefficients) {
                        for (sum, v) in psf.iter_mut().zip(&stamp[start..start + count]) {
                            sum.re += c * v.re;
                            sum.im += c * v.im;
                        }
                    }
                    for ((value, &g), turn) in psf.iter_mut().zip(transform.iter()).zip(turns) {
                        let g = T::nearest(g);
                        let turned = Complex::new(
                            (turn_x.re * turn.re - turn_x.im * turn.im) * g,
                            (turn_x.re * turn.im + turn_x.im * turn.re) * g,
                        );
                        *value = Complex::new(
                            value.re * turned.re - value.im * turned.im,
                            value.re * turned.im + value.im * turned.re,
                        );
                    }
                    // A real image: the value at -k is the conjugate of that at k. Of each pair, one
                    // lies in the columns that are kept, and both if the column is its own opposite.
                    let column = kx % side;
                    if column <= half {
                        let to = &mut work.folded[column * side..(column + 1) * side];
                        add_folded(to, psf, -(most_ky as i64));
                    }
                    if kx > 0 && (column == 0 || column >= half) {
                        let opposite = (side - column) % side;
                        psf.reverse();
                        for v in psf.iter_mut() {
                            v.im = -v.im;
                        }
                        let to = &mut work.folded[opposite * side..(opposite + 1) * side];
                        add_folded(to, psf, -(most_ky as i64));
                    }
                },
            );
        }
    }
}

/// Adds values to a column, the first at index `first`, modulo the length of the column.
#[inline(always)]
fn add_folded<T: ConvReal>(column: &mut [Complex<T>], values: &[Complex<T>], first: i64) {
    let mut rest = values;
    let mut at = first.rem_euclid(column.len() as i64) as usize;
    while !rest.is_empty() {
        let (now, later) = rest.split_at(rest.len().min(column.len() - at));
        for (sum, &v) in column[at..].iter_mut().zip(now) {
            *sum += v;
        }
        (rest, at) = (later, 0);
    }
}
