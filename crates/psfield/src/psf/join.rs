//! Joins wings to a PSF that is known only near the source.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use conv_core::StampInterpolator;
use ndarray::{Array2, Array3, ArrayView2, s};
use psf_types::{
    FrameShape, Normalisation, Position, SampleCoefficients, StampGrid, Wings, WingsRecord, read_text_file,
};
use serde::{Deserialize, Serialize};

use super::Psf;
use super::resample::on_basis;
use crate::error::{ErrorKind, PsfieldError};
use crate::fit::{Window, joined, radius};
use crate::stack_size::check_stack;

/// The wings that are joined to a PSF. Their brightness follows from that of the PSF where both meet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum WingsSource {
    /// A file: a PSF of any format, such as one with a large stamp, or a text file with a radial profile. Each line
    /// of a profile has a radius in pixels of the frame and the light there, in any unit.
    File(PathBuf),
    /// Light that falls as a power of the radius.
    PowerLaw {
        /// The light is proportional to the radius to the power of minus this.
        exponent: f64,
        /// It ends at this radius, in pixels of the frame.
        radius_px: f64,
    },
}

/// The file formats of radial profiles.
const PROFILES: [&str; 4] = ["csv", "txt", "dat", "ecsv"];
/// The largest radius of wings, in pixels of the frame.
const LARGEST_RADIUS: f64 = 16384.0;

/// The form of a power law.
const FORM: &str = "a power law is given as power=EXPONENT,RADIUS, such as power=3,2000: both above 0, the radius in \
                    pixels and at most 16384";
/// The rows of a profile.
const TWO_NUMBERS: &str = "a row of a profile has two numbers, the radius in pixels and the light there";
const ORDER: &str =
    "radii must increase from row to row, and radii and light must be finite and not negative";

impl FromStr for WingsSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(numbers) = text.strip_prefix("power=") else {
            return Ok(Self::File(text.into()));
        };
        let number = |text: &str| {
            text.trim()
                .parse::<f64>()
                .ok()
                .filter(|v| *v > 0.0 && v.is_finite())
        };
        let numbers = numbers
            .split_once(',')
            .and_then(|(a, b)| Some((number(a)?, number(b)?)));
        let (exponent, radius_px) = numbers.ok_or(FORM)?;
        if radius_px > LARGEST_RADIUS {
            return Err(FORM.to_owned());
        }
        Ok(Self::PowerLaw { exponent, radius_px })
    }
}

impl TryFrom<String> for WingsSource {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<WingsSource> for String {
    fn from(source: WingsSource) -> Self {
        source.to_string()
    }
}

impl fmt::Display for WingsSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::PowerLaw { exponent, radius_px } => write!(f, "power={exponent},{radius_px}"),
        }
    }
}

/// A radial profile, by radius in pixels of the frame.
struct Profile(Vec<(f64, f64)>);

impl Profile {
    fn read(path: &Path) -> Result<Self, PsfieldError> {
        let wrong = |line: usize, problem: &str| {
            let message = format!("{}, line {line}: {problem}", path.display());
            PsfieldError::new(ErrorKind::Data, message)
        };
        let text = read_text_file(path).map_err(|error| {
            PsfieldError::new(
                ErrorKind::Io,
                format!("{}: the profile cannot be read", path.display()),
            )
            .because(error)
        })?;
        let mut points: Vec<(f64, f64)> = Vec::new();
        for (line, row) in (1..).zip(text.lines()) {
            let row = row.trim();
            let fields: Vec<&str> = row
                .split([',', ';', ' ', '\t'])
                .filter(|field| !field.is_empty())
                .collect();
            let is_header = points.is_empty() && fields.iter().any(|field| field.parse::<f64>().is_err());
            if row.is_empty() || row.starts_with('#') || is_header {
                continue;
            }
            let numbers: Result<Vec<f64>, _> = fields.iter().map(|field| field.parse()).collect();
            let Ok([radius, light]) = numbers.as_deref() else {
                return Err(wrong(line, TWO_NUMBERS));
            };
            let follows = points.last().is_none_or(|(before, _)| before < radius);
            if !(follows && *radius >= 0.0 && *light >= 0.0 && radius.max(*light).is_finite()) {
                return Err(wrong(line, ORDER));
            }
            points.push((*radius, *light));
        }
        if points.len() < 2 {
            return Err(wrong(text.lines().count(), "a profile needs two rows at least"));
        }
        Ok(Self(points))
    }

    /// The light at a radius: a power law between neighbouring rows, or linear where one of them is 0 or at the
    /// centre. 0 beyond the last row.
    fn at(&self, radius: f64) -> f64 {
        let points = &self.0;
        let after = points.partition_point(|(r, _)| *r < radius);
        if after == points.len() {
            return 0.0;
        }
        let ((r1, v1), (r2, v2)) = (points[after.max(1) - 1], points[after.max(1)]);
        if r1 > 0.0 && v1 > 0.0 && v2 > 0.0 && radius > 0.0 {
            return v1 * ((radius / r1).ln() * (v2 / v1).ln() / (r2 / r1).ln()).exp();
        }
        (v1 + (v2 - v1) * (radius - r1) / (r2 - r1)).max(0.0)
    }
}

impl Psf {
    /// Joins wings to this PSF, which is its core. Between half of the core's radius and its edge, the PSF passes
    /// smoothly from one to the other. At every sample, the wings are scaled so that both have equal light there on
    /// average. PSFs keep their flux. Samples are fitted first.
    ///
    /// ```
    /// # use ndarray::Array3;
    /// # use psfield::Psf;
    /// # let at = |v: usize| v as f64 - 30.0;
    /// # let stamps = Array3::from_shape_fn((1, 61, 61), |(_, y, x)| (1.0 + at(x).powi(2) + at(y).powi(2)).powf(-1.5));
    /// # let psf = Psf::from_samples(stamps.view(), &[(50.0, 50.0)])?;
    /// let psf = psf.joined_to(&"power=3,300".parse()?)?;
    /// assert_eq!(psf.model()?.whole_grid().nx(), 601);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Io`] and the errors of [`open`](Self::open) for a file that cannot be read,
    /// [`ErrorKind::Data`] for wings that are not larger than the core, hold no light where they meet it, or are too
    /// bright to be wings, and the errors of [`record`](Self::record).
    pub fn joined_to(&self, source: &WingsSource) -> Result<Self, PsfieldError> {
        let refused =
            |problem: &str| PsfieldError::new(ErrorKind::Data, format!("wings {source}: {problem}"));
        let record = self.record()?;
        if record.wings().is_some() {
            return Err(refused("the PSF has wings already"));
        }
        let (basis, nodes) = (record.basis(), record.coefficients());
        let core = basis.grid();
        let room = |centre: f64, pixels: usize| centre.min((pixels - 1) as f64 - centre).floor();
        let half = room(core.centre_x(), core.nx()).min(room(core.centre_y(), core.ny()));
        let window = Window::on(core, half);
        let wings = stamp(source, core)?;
        let (stamp, grid) = (wings.0, wings.1);
        if core.place_in(grid).is_none() || grid.nx().min(grid.ny()) < core.nx().max(core.ny()) + 2 {
            return Err(refused("they are not larger than the stamps of the PSF"));
        }
        let of_core = window.values(core);
        let outer = window.values(grid).mapv_into(|w| 1.0 - w);
        // The mean light where both meet.
        let [from, to] = window.radii;
        let ring = |values: ArrayView2<'_, f64>, grid: StampGrid| {
            let meets = |(j, i): (usize, usize)| (from..=to).contains(&radius(grid, j, i));
            values
                .indexed_iter()
                .filter(|(at, _)| meets(*at))
                .map(|(_, v)| v)
                .sum::<f64>()
        };
        let of_ring = ring(stamp.view(), grid);
        if of_ring.is_nan() || of_ring <= 0.0 {
            return Err(refused("they hold no light where they meet the PSF"));
        }
        let stamp = stamp * outer;
        let flux = |values: ArrayView2<'_, f64>| core.flux_of_sum(values.sum());
        let flux_of_wings = flux(stamp.view());
        // The flux, the light in the ring and the flux in the window, of the mean and of each component.
        let sums = |values: ArrayView2<'_, f64>| {
            let within = &values * &of_core;
            [flux(values), ring(values, core), flux(within.view())]
        };
        let of_mean = basis.mean().map_or([0.0; 3], sums);
        let of_components: Vec<[f64; 3]> = basis.components().outer_iter().map(sums).collect();
        let (rank, samples) = (basis.rank(), nodes.values().nrows());
        let has_mean = basis.mean().is_some();
        let mut values = Array2::zeros((samples, rank + usize::from(has_mean)));
        let (mut amplitudes, mut fluxes) = (Array2::zeros((samples, 1)), Vec::with_capacity(samples));
        for (sample, row) in nodes.values().outer_iter().enumerate() {
            let sum = |k: usize| {
                let terms = row.iter().zip(&of_components).map(|(a, sums)| a * sums[k]);
                of_mean[k] + terms.sum::<f64>()
            };
            let [whole, light, within] = [0, 1, 2].map(sum);
            let wanted = if record.normalisation() == Normalisation::Keep {
                whole
            } else {
                1.0
            };
            let amplitude = light / of_ring;
            let scale = wanted / (within + amplitude * flux_of_wings);
            if !(scale > 0.0 && scale.is_finite() && amplitude > 0.0) {
                return Err(refused(&format!(
                    "the PSF of sample {sample} (0-based) holds no light where it meets them"
                )));
            }
            for (to, a) in values.row_mut(sample).iter_mut().zip(row) {
                *to = scale * a;
            }
            if has_mean {
                values[(sample, rank)] = scale - 1.0;
            }
            amplitudes[(sample, 0)] = scale * amplitude;
            fluxes.push(wanted);
        }
        let mut stamps = Array3::zeros((values.ncols(), core.ny(), core.nx()));
        for (mut to, from) in stamps.outer_iter_mut().zip(basis.components().outer_iter()) {
            to.assign(&(&from * &of_core));
        }
        let mean = basis.mean().map(|mean| &mean * &of_core);
        if let Some(mean) = &mean {
            stamps.slice_mut(s![rank, .., ..]).assign(mean);
        }
        let norm = |values: ArrayView2<'_, f64>| values.iter().map(|v| v * v).sum::<f64>().sqrt();
        let of_first = match &mean {
            Some(mean) => norm(mean.view()),
            None => norm(values.slice(s![..1, ..])),
        };
        let brightest = amplitudes.iter().copied().fold(0.0, f64::max);
        if brightest * norm(stamp.view()) > Wings::LARGEST_NORM * of_first {
            return Err(refused(
                "they are too bright to be wings where they meet the PSF: take larger stamps for the PSF",
            ));
        }
        let made = psf_basis::orthonormal(mean, stamps, values.view(), core)?;
        let positions = nodes.positions();
        let record = on_basis(record, made, positions.clone())?;
        let stamp = stamp.mapv(|v| v as f32).insert_axis(ndarray::Axis(0));
        let wings = WingsRecord::new(
            stamp,
            SampleCoefficients::new(amplitudes, positions.clone())?,
            grid,
        )?;
        Ok(self.with_record(joined(&record, wings, fluxes.into_iter())?))
    }
}

/// The stamp of wings with the sampling of a core, and its grid.
fn stamp(source: &WingsSource, core: StampGrid) -> Result<(Array2<f64>, StampGrid), PsfieldError> {
    let s = core.oversampling();
    let on_grid = |radius_px: f64| -> Result<StampGrid, PsfieldError> {
        let half = (radius_px.min(LARGEST_RADIUS) * s).ceil() as usize;
        let grid = core.about_centre(half)?;
        check_stack(1, grid)?;
        Ok(grid)
    };
    let round = |grid: StampGrid, at: &dyn Fn(f64) -> f64| {
        Array2::from_shape_fn(grid.dim(), |(j, i)| at(radius(grid, j, i) / s))
    };
    match source {
        WingsSource::PowerLaw { exponent, radius_px } => {
            let grid = on_grid(*radius_px)?;
            let light = |r: f64| {
                if r <= *radius_px {
                    r.max(0.5).powf(-exponent)
                } else {
                    0.0
                }
            };
            Ok((round(grid, &light), grid))
        }
        WingsSource::File(path) => {
            let extension = path
                .extension()
                .map(|extension| extension.to_string_lossy().to_lowercase());
            if extension.is_some_and(|extension| PROFILES.contains(&extension.as_str())) {
                let profile = Profile::read(path)?;
                let last = profile.0[profile.0.len() - 1].0;
                if last > LARGEST_RADIUS {
                    let message = format!(
                        "{}: the profile ends at a radius of {last} pixels: leave out rows beyond {LARGEST_RADIUS}",
                        path.display()
                    );
                    return Err(PsfieldError::new(ErrorKind::Data, message));
                }
                let grid = on_grid(last)?;
                return Ok((round(grid, &|r| profile.at(r)), grid));
            }
            let psf = Psf::open(path)?;
            let model = psf.model()?;
            let middle = |field: FrameShape| Position::of_pixel(field.nx() as i64 / 2, field.ny() as i64 / 2);
            let at = psf.field_shape().map_or(psf.positions().as_slice()[0], middle);
            let found = model.psf_at(at)?;
            let own = found.grid();
            let half = |centre: f64, pixels: usize| centre.min((pixels - 1) as f64 - centre);
            let half = half(own.centre_x(), own.nx()).min(half(own.centre_y(), own.ny()));
            let grid = on_grid((half / own.oversampling()).floor())?;
            if own == grid {
                return Ok((found.into_values(), grid));
            }
            Ok((
                StampInterpolator::new(found.values(), own).resample((0.0, 0.0), grid),
                grid,
            ))
        }
    }
}
