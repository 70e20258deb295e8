//! The power of PSFs by wavenumber, and the wavenumbers at which a galaxy's image has light.
//!
//! The transform of an interpolated stamp nearly vanishes in most of the plane. If the stamp is
//! under-sampled, there is light around its sampling frequency and little between, so a circle would
//! hold more than twice the wavenumbers that matter.

use std::f64::consts::{PI, SQRT_2};

use ndarray::Array2;
use psf_types::{LightProfile, StampGrid};

use super::spectrum::{ALIASES, kernel_transform};

/// The power of some PSFs by wavenumber `(|kx|, |ky|)`, in square cells.
#[derive(Debug)]
pub(super) struct PowerSpectrum {
    /// The side of a cell in radians per pixel.
    width: f64,
    /// An upper limit of the power of any PSF. `[i, j]` is the sum over the cells `(i, j)`, `(i, j +
    /// 1)` and so on.
    largest: Array2<f64>,
    /// An upper limit of the power outside all cells.
    outside: f64,
    /// The power of a typical PSF in rings of the width of a cell.
    typical: Vec<f64>,
}

/// The most cells along an axis.
const MOST_CELLS: usize = 64;
/// Wavenumbers with less than this fraction of the power that the accuracy allows are left out.
const NEGLIGIBLE: f64 = 1e-3;
/// An outline leaves out at most this part of the power that the accuracy allows, as seen at the
/// wavenumbers of the coarse transform. Between them there may be more power: up to a quarter more in
/// the cases of the test.
const LEFT_OUT: f64 = 0.7;
/// The part of the allowed power that lies outside all cells. It counts in [`LEFT_OUT`].
const OUTSIDE: f64 = 0.3;

impl PowerSpectrum {
    /// `limit` is an upper limit of the power of any PSF at the [`AliasedPower`]'s wavenumbers, and
    /// `typical` the power of one of them. Outlines are made for an `accuracy` of at least this.
    pub(super) fn new(aliases: &AliasedPower, limit: &[f64], typical: &[f64], accuracy: f64) -> Self {
        let least = typical.iter().sum::<f64>() * NEGLIGIBLE * accuracy * accuracy / typical.len() as f64;
        let mut rings = vec![0.0; (aliases.cells as f64 * SQRT_2) as usize + 1];
        aliases.for_each(typical, least, |i, j, power| {
            rings[((i * i + j * j) as f64).sqrt() as usize] += power;
        });
        let mut fine = Array2::<f64>::zeros((aliases.cells, aliases.cells));
        aliases.for_each(limit, least, |i, j, power| fine[[i, j]] += power);
        // The power outside the first cells along each axis.
        let mut outside = vec![0.0; aliases.cells + 1];
        for ((i, j), power) in fine.indexed_iter() {
            outside[i.max(j)] += power;
        }
        for i in (0..aliases.cells).rev() {
            outside[i] += outside[i + 1];
        }
        let allowed = OUTSIDE * accuracy * accuracy * rings.iter().sum::<f64>();
        let count = outside.partition_point(|&power| power > allowed).max(1);
        // Joins cells.
        let joined = count.div_ceil(MOST_CELLS);
        let cells = count.div_ceil(joined);
        let mut largest = Array2::zeros((cells, cells));
        for ((i, j), power) in fine.indexed_iter().filter(|((i, j), _)| *i.max(j) < count) {
            largest[[i / joined, j / joined]] += power;
        }
        for mut line in largest.outer_iter_mut() {
            for j in (1..cells).rev() {
                line[j - 1] += line[j];
            }
        }
        Self {
            width: aliases.step * joined as f64,
            largest,
            outside: outside[count.min(aliases.cells)],
            typical: rings.chunks(joined).map(|rings| rings.iter().sum()).collect(),
        }
    }

    /// The wavenumbers beyond which at most the square of the accuracy times the power of a galaxy's
    /// image lies: the light there is at most `accuracy` of the image through the typical PSF, in the L2 norm.
    pub(super) fn outline(&self, light: &dyn LightProfile, accuracy: f64) -> Outline {
        let cells = self.largest.nrows();
        // The transform of the light is largest at the inner edge of a ring.
        let rings = (cells as f64 * SQRT_2) as usize + 2;
        let (mut smallest, mut largest) = (vec![0.0; rings], vec![0.0; rings]);
        light.transform_limits(self.width, &mut smallest, &mut largest);
        // Below an index of 0.5 the transform oscillates around 0.
        for ring in (1..rings).rev() {
            largest[ring - 1] = largest[ring - 1].abs().max(largest[ring].abs());
        }
        let square = |factor: f32| f64::from(factor) * f64::from(factor);
        let typical = self.typical.iter().zip(&smallest[1..]);
        let total: f64 = typical.map(|(power, &factor)| power * square(factor)).sum();
        let mut rest = LEFT_OUT * accuracy * accuracy * total - self.outside * square(largest[cells - 1]);
        // Each line may leave out its share of the power that the lines before have not used.
        let mut ends = vec![0; cells];
        let mut end = 0;
        for line in (0..cells).rev() {
            let share = rest / (line + 1) as f64;
            let beyond = |end: usize| {
                let ring = ((line * line + end * end) as f64).sqrt() as usize;
                self.largest[[line, end]] * square(largest[ring])
            };
            while end < cells && beyond(end) > share {
                end += 1;
            }
            while end > 0 && beyond(end - 1) <= share {
                end -= 1;
            }
            if end < cells {
                rest -= beyond(end);
            }
            ends[line] = end as u8;
        }
        // Wavenumbers between two lines of the discrete transform have light if one of them has.
        for line in 1..cells {
            ends[line - 1] = ends[line - 1].max(ends[line]);
        }
        ends.truncate(cells - ends.iter().rev().take_while(|&&end| end == 0).count());
        Outline {
            width: self.width,
            ends,
        }
    }
}

/// The wavenumbers at which a galaxy's image has light that matters.
#[derive(Debug, Default)]
pub(super) struct Outline {
    /// The width of a line in radians per pixel.
    width: f64,
    /// For each line of wavenumbers with similar `|kx|`, the largest `|ky|` in units of the width.
    ends: Vec<u8>,
}

impl Outline {
    /// The largest `|ky|` in radians per pixel at some `|kx|`. `None` if there is no light.
    pub(super) fn end(&self, kx: f64) -> Option<f64> {
        let &end = self.ends.get((kx / self.width) as usize)?;
        (end > 0).then(|| f64::from(end) * self.width)
    }

    /// The largest `|kx|` and the largest `|ky|`.
    pub(super) fn extent(&self) -> [f64; 2] {
        let most = self.ends.iter().max().copied().unwrap_or(0);
        [self.ends.len() as f64, f64::from(most)].map(|cells| cells * self.width)
    }

    /// The largest wavenumber.
    pub(super) fn radius(&self) -> f64 {
        let of_line = |(line, &end): (usize, &u8)| (line as f64 + 1.0).hypot(f64::from(end));
        self.ends.iter().enumerate().map(of_line).fold(0.0, f64::max) * self.width
    }
}

/// The wavenumbers `kx = 0 ... radius` and `ky = -radius ... radius`, in units of `step` radians per
/// frame pixel, and the factors by which interpolation multiplies the power of their aliases.
#[derive(Debug)]
pub(super) struct AliasedPower {
    pub(super) step: f64,
    pub(super) radius: usize,
    /// For each alias along an axis, the cell and the factor at `-radius ... radius`.
    along: Vec<Vec<(usize, f64)>>,
    /// The number of cells along an axis. The cells are as wide as a step.
    cells: usize,
}

impl AliasedPower {
    pub(super) fn new(grid: StampGrid) -> Self {
        let s = grid.oversampling();
        let step = 2.0 * PI * s / grid.nx().max(grid.ny()) as f64;
        // The wavenumbers up to the Nyquist frequency of the stamps.
        let nyquist = PI * s;
        let radius = (nyquist / step).floor() as usize;
        let kernel = |m: i64, alias: i64| {
            let k = m as f64 * step + 2.0 * nyquist * alias as f64;
            let cell = (k.abs() / step) as usize;
            (cell, kernel_transform(grid.interpolation(), k / s).powi(2))
        };
        Self {
            step,
            radius,
            along: (-ALIASES..=ALIASES)
                .map(|alias| {
                    (-(radius as i64)..=radius as i64)
                        .map(|m| kernel(m, alias))
                        .collect()
                })
                .collect(),
            cells: ((2 * ALIASES + 1) as f64 * nyquist / step) as usize + 2,
        }
    }

    /// Gives the cell along x, the cell along y, and the power of the aliases of each wavenumber to
    /// `take`. Wavenumbers whose power is at most `least` are left out.
    fn for_each(&self, power: &[f64], least: f64, mut take: impl FnMut(usize, usize, f64)) {
        let row = 2 * self.radius + 1;
        for (index, &power) in power.iter().enumerate().filter(|&(_, &power)| power > least) {
            let (kx, at) = (index / row, index % row);
            for by_x in &self.along {
                let (i, fx) = by_x[kx + self.radius];
                for by_y in &self.along {
                    let (j, fy) = by_y[at];
                    take(i, j, power * fx * fy);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use psf_types::{Position, SersicProfile, SersicSource, StampInterpolation};
    use rustfft::num_complex::Complex64;
    use sersic::SersicLight;

    use super::*;
    use crate::galaxies::spectrum::discrete_transform;

    /// The light of a PSF and a galaxy at wavenumbers between those of the coarse transform.
    fn check(grid: StampGrid, (re, n, q): (f64, f64, f64), accuracy: f64) {
        const STEP: f64 = 0.047;
        let s = grid.oversampling();
        let stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
            let x = (x as f64 - grid.centre_x() - 0.3) / s;
            let y = (y as f64 - grid.centre_y() + 0.4) / s;
            (1.0 + (x * x + 0.2 * x * y + y * y) / 5.0).powf(-2.5)
        });
        let aliases = AliasedPower::new(grid);
        let coarse = discrete_transform(stamp.view(), grid, aliases.step, aliases.radius);
        let power: Vec<f64> = coarse.iter().map(Complex64::norm_sqr).collect();
        let profile = SersicProfile::new(re, n, q, 30.0).unwrap();
        let light = SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap());
        let outline = PowerSpectrum::new(&aliases, &power, &power, accuracy).outline(&light, accuracy);

        let most = (5.0 * PI * s / STEP) as usize;
        let fine = discrete_transform(stamp.view(), grid, STEP, most);
        let interpolation = |m: usize| kernel_transform(grid.interpolation(), m as f64 * STEP / s);
        let factors: Vec<f64> = (0..=most).map(interpolation).collect();
        let (mut all, mut beyond) = (0.0, 0.0);
        let (mut within, mut in_circle) = (0, 0);
        let mut transform = vec![0.0; 2 * most + 1];
        for (line, values) in fine.outer_iter().enumerate() {
            let kx = line as f64 * STEP;
            light.transform_into(kx, -(most as f64) * STEP, STEP, &mut transform);
            let end = outline.end(kx).unwrap_or(-1.0);
            for (at, (value, &factor)) in values.iter().zip(&transform).enumerate() {
                let m = at.abs_diff(most);
                let ky = m as f64 * STEP;
                let amplitude = value * factors[line] * factors[m] * f64::from(factor);
                let power = amplitude.norm_sqr() * if line == 0 { 0.5 } else { 1.0 };
                all += power;
                if ky > end {
                    beyond += power;
                }
                within += usize::from(ky <= end);
                in_circle += usize::from(kx.hypot(ky) <= outline.radius());
            }
        }
        let error = (beyond / all).sqrt();
        let case = format!("{grid:?}, re = {re}, n = {n}, q = {q}, {accuracy}");
        assert!(error <= accuracy, "{case}: {error:e}");
        // Of a nearly point-like source, under-sampled stamps have light at several sampling
        // frequencies.
        let saved = if s == 1.0 && re < 1.0 && accuracy < 1e-3 {
            2
        } else {
            1
        };
        assert!(saved * within < in_circle, "{case}: {within} of {in_circle}");
    }

    #[test]
    fn light_beyond_an_outline_is_within_the_accuracy() {
        let square = StampGrid::new(41, 41).unwrap();
        let lanczos = StampGrid::new(51, 40).and_then(|grid| grid.with_oversampling(1.7));
        let lanczos = lanczos.unwrap().with_interpolation(StampInterpolation::Lanczos3);
        let fine = StampGrid::new(90, 90)
            .and_then(|grid| grid.with_oversampling(3.0))
            .unwrap();
        for galaxy in [
            (0.1, 0.5, 1.0),
            (1.5, 1.0, 0.3),
            (2.0, 0.3, 0.5),
            (4.0, 4.0, 0.7),
            (8.0, 1.0, 0.01),
        ] {
            for accuracy in [1e-2, 1e-3, 1e-4, 1e-5] {
                check(square, galaxy, accuracy);
            }
            check(lanczos, galaxy, 1e-3);
            check(fine, galaxy, 1e-4);
        }
    }

    /// A PSF without light, and an accuracy of 0.
    #[test]
    fn outlines_may_be_empty_or_whole() {
        let aliases = AliasedPower::new(StampGrid::new(9, 9).unwrap());
        let galaxy = SersicProfile::new(1.0, 1.0, 1.0, 0.0).unwrap();
        let light = SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, galaxy).unwrap());
        let outline = |power: f64, accuracy: f64| {
            let power = vec![power; (aliases.radius + 1) * (2 * aliases.radius + 1)];
            PowerSpectrum::new(&aliases, &power, &power, accuracy).outline(&light, accuracy)
        };
        let empty = outline(0.0, 1e-3);
        assert_eq!(
            (empty.end(0.0), empty.extent(), empty.radius()),
            (None, [0.0; 2], 0.0)
        );
        assert!(outline(1.0, 0.0).radius() > PI);
    }
}
