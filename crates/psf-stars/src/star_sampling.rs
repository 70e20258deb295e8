//! All steps from a frame to PSF samples.

use ndarray::{Array2, Axis, stack};
use psf_types::{FrameShape, Image, Position, PsfSamples, Real, SamplePositions, StampGrid};
use rayon::prelude::*;

use crate::background::{Spline, median};
use crate::epsf::Epsf;
use crate::frame::{FrameView, Neighbours, Ownership, Star, aperture_px};
use crate::registration::{FineGrid, own_stamp};
use crate::selection::most_frequent_width;
use crate::{
    Background, BackgroundMesh, Camera, CoverageMap, Detection, Registration, RegistrationMethod,
    RegistrationReport, Rejection, Saturation, Selection, Source, StarError,
};

/// Makes PSF samples from the stars of a frame.
///
/// The steps, each with its own settings:
///
/// 1. background and its noise ([`BackgroundMesh`]),
/// 2. sources ([`Detection`]), repeated with a wider kernel if the stars are wide,
/// 3. centre and shape of each source by a Gaussian fit,
/// 4. signal-to-noise ratio and saturation ([`Camera`]),
/// 5. cuts ([`Selection`]),
/// 6. registration on a common grid ([`Registration`]),
/// 7. coverage ([`CoverageMap`]).
///
/// The result does not depend on the number of threads.
///
/// ```
/// use ndarray::Array2;
/// use psf_stars::StarSampling;
/// use psf_types::Image;
/// let mut frame = Array2::from_shape_fn((128, 128), |(y, x)| 100.0 + ((x * 7919 + y * 104_729) % 13) as f64);
/// for (x, y) in [(30.2, 40.7), (80.5, 25.1), (64.0, 90.3), (100.8, 100.4)] {
///     for ((row, column), value) in frame.indexed_iter_mut() {
///         let r2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
///         *value += 3000.0 * (-0.5 * r2 / 1.2_f64.powi(2)).exp();
///     }
/// }
/// let found = StarSampling::default().run(&Image::new(frame)?)?;
/// assert_eq!(found.samples.len(), 4);
/// assert!((found.fwhm_px - 2.355 * 1.2).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StarSampling {
    background: BackgroundMesh,
    detection: Detection,
    camera: Camera,
    selection: Selection,
    registration: Registration,
    hold_out: (usize, u64),
    cross_validation: bool,
}

/// The number of groups into which the stars are divided for a cross-validation. Each group is left
/// out once, so that four fifths of the stars make the PSF.
const FOLDS: usize = 5;
/// With fewer samples there is no cross-validation.
const LEAST_FOR_FOLDS: usize = 2 * FOLDS;

/// A star's light divided by its flux, and this flux.
type StampAndFlux = (Array2<f64>, f64);
/// The position of a star, and its stamp.
type StampAt = ((f64, f64), Array2<f64>);

/// The smallest size of a frame along each axis, in pixels.
const LEAST_PIXELS: usize = 24;
/// If stars are wider than the kernel by this factor, the detection is repeated with a wider
/// kernel.
const WIDER: f64 = 1.5;

impl StarSampling {
    /// Sets the estimation of the background.
    #[must_use]
    pub fn with_background(self, background: BackgroundMesh) -> Self {
        Self { background, ..self }
    }

    /// Sets the detection.
    #[must_use]
    pub fn with_detection(self, detection: Detection) -> Self {
        Self { detection, ..self }
    }

    /// Sets the known properties of the camera.
    #[must_use]
    pub fn with_camera(self, camera: Camera) -> Self {
        Self { camera, ..self }
    }

    /// Sets the cuts.
    #[must_use]
    pub fn with_selection(self, selection: Selection) -> Self {
        Self { selection, ..self }
    }

    /// Sets the registration.
    #[must_use]
    pub fn with_registration(self, registration: Registration) -> Self {
        Self { registration, ..self }
    }

    /// Holds `count` of the accepted stars out of the samples, to check a model of the samples.
    /// `seed` chooses the stars. [`StarSamples::held_out`] has their stamps, which are made from
    /// each star's own pixels. A chosen star whose flux is not positive gives no stamp, and is also
    /// rejected as [`Rejection::LowSnr`].
    #[must_use]
    pub fn with_hold_out(self, count: usize, seed: u64) -> Self {
        Self {
            hold_out: (count, seed),
            ..self
        }
    }

    /// Divides the stars that serve as samples into five groups. For each group, samples are made
    /// without its stars ([`StarSamples::folds`]). There are no groups if there are fewer than ten
    /// samples.
    #[must_use]
    pub fn with_cross_validation(self) -> Self {
        Self {
            cross_validation: true,
            ..self
        }
    }

    /// Makes PSF samples from the stars of `frame`.
    ///
    /// # Errors
    /// [`StarError`] when the frame is too small or without noise, when no source is found or
    /// suitable, when the requested distance from the edge is less than half a stamp, when there
    /// are too few stars for an oversampled PSF that was requested explicitly, or when stars cannot
    /// be held out because there are too few or the method is [`Epsf`](RegistrationMethod::Epsf).
    pub fn run<T: Real>(&self, frame: &Image<T>) -> Result<StarSamples, StarError> {
        self.run_masked(frame.pixels().mapv(T::as_f64))
    }

    /// Works like [`run`](Self::run) for the pixels `[y, x]` of a frame in which NaN stands for a
    /// masked pixel. The background and its noise ignore masked pixels. A star with a masked pixel
    /// near its core is rejected ([`Rejection::Masked`]). Farther out, stamps do not use masked
    /// pixels.
    ///
    /// # Errors
    /// The errors of [`run`](Self::run), and [`StarError`] for an infinite pixel or if all pixels
    /// are masked.
    pub fn run_masked(&self, pixels: Array2<f64>) -> Result<StarSamples, StarError> {
        let (ny, nx) = pixels.dim();
        if nx.min(ny) < LEAST_PIXELS {
            return Err(StarError::NoSamples(format!(
                "a frame of {nx} x {ny} pixels is too small: at least {LEAST_PIXELS} pixels along each axis are needed"
            )));
        }
        if pixels.iter().all(|v| v.is_nan()) || pixels.iter().any(|v| v.is_infinite()) {
            const UNUSABLE: &str = "every pixel of the frame is masked, or a pixel is infinite: unmask the good pixels, and mask infinite pixels";
            return Err(StarError::NoSamples(UNUSABLE.to_owned()));
        }
        let background = self.background.estimate(pixels.view())?;
        let excess = background.subtracted_from(pixels.view());
        let view = FrameView {
            saturation: self
                .camera
                .saturation_of(pixels.view(), background.typical_level()),
            pixels,
            excess,
            background,
            camera: self.camera,
        };

        let mut detection = self.detection;
        let mut sources = view.measured(&view.peaks(&detection)?, detection.kernel_fwhm_px());
        let mut fwhm_px = self.typical_fwhm(&sources, detection.kernel_fwhm_px());
        if fwhm_px > WIDER * detection.kernel_fwhm_px() {
            detection = detection.with_kernel_fwhm_px(fwhm_px.min(50.0))?;
            sources = view.measured(&view.peaks(&detection)?, fwhm_px);
            fwhm_px = self.typical_fwhm(&sources, fwhm_px);
        }
        sources = view.measured(&view.peaks(&detection)?, fwhm_px);
        fwhm_px = self.typical_fwhm(&sources, fwhm_px);

        let reach = self.registration.reach(fwhm_px);
        self.selection.check_edge(reach)?;
        self.selection.apply(&mut sources, view.shape(), reach, fwhm_px);
        // Stars that are held out also count for the choice of the grid and the method.
        let accepted = sources.iter().filter(|s| s.rejected.is_empty()).count();
        self.hold_out(&mut sources)?;
        let registered = self.register(&view, &mut sources, accepted, fwhm_px)?;
        let folds = self.folds(&view, &registered, fwhm_px);
        view.collected(sources, registered, folds, fwhm_px)
    }

    /// Makes the samples of every fold. A sample with index `k` belongs to fold `k % FOLDS`.
    /// Samples are ordered by significance, so that every fold has bright and faint stars.
    fn folds(&self, view: &FrameView, registered: &Registered, fwhm_px: f64) -> Vec<RegisteredFold> {
        let all = &registered.samples;
        if !self.cross_validation || all.len() < LEAST_FOR_FOLDS {
            return Vec::new();
        }
        let fold = |number: usize| {
            let part = |left_out: bool| {
                let chosen = all.iter().enumerate();
                chosen.filter(move |(k, _)| (k % FOLDS == number) == left_out)
            };
            if registered.report.method != RegistrationMethod::Epsf {
                let left_out = part(true).map(|(k, (star, _, flux))| (k, star.x, star.y, *flux));
                return RegisteredFold {
                    samples: part(false)
                        .map(|(_, (star, stamp, _))| ((star.x, star.y), stamp.clone()))
                        .collect(),
                    left_out: left_out.collect(),
                };
            }
            let others = part(false).map(|(_, (star, ..))| star.clone()).collect();
            // The degree of the fit to all stars is used again, because its choice takes most of
            // the time. That choice already tested predictions of stars left out.
            let degree = registered.report.field_degree;
            let (grid, frame) = (registered.grid, view.shape());
            let epsf = Epsf::fit(others, grid, fwhm_px, frame, &self.camera, degree);
            let left_out = part(true).map(|(k, (star, _, flux))| {
                // A star that the PSF does not fit keeps the values of the fit to all stars.
                let (x, y, flux) = epsf.measure(star).unwrap_or((star.x, star.y, *flux));
                (k, x, y, flux)
            });
            let left_out = left_out.collect();
            let samples = epsf.stars.iter().filter_map(|star| {
                let (stamp, _) = epsf.sample(star, self.registration.own_shapes)?;
                Some(((star.x, star.y), stamp))
            });
            RegisteredFold {
                samples: samples.collect(),
                left_out,
            }
        };
        let folds: Vec<_> = (0..FOLDS).map(fold).collect();
        let is_complete = folds.iter().all(|fold| !fold.samples.is_empty());
        if is_complete { folds } else { Vec::new() }
    }

    /// Rejects the stars that are held out.
    fn hold_out(&self, sources: &mut [Source]) -> Result<(), StarError> {
        let (count, seed) = self.hold_out;
        let accepted = (0..sources.len()).filter(|&k| sources[k].rejected.is_empty());
        let mut chosen: Vec<usize> = accepted.collect();
        if !chosen.is_empty() && count >= chosen.len() {
            return Err(StarError::NoSamples(format!(
                "the number of stars to hold out is {count}, but must be below {}, the number of stars that can serve as PSF samples",
                chosen.len()
            )));
        }
        // A random order: the stars are sorted by a hash of the seed and their index (SplitMix64).
        chosen.sort_by_key(|&k| {
            let mut hash = seed.wrapping_add((k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
            hash = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            hash = (hash ^ (hash >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            hash ^ (hash >> 31)
        });
        for &k in chosen.iter().take(count) {
            sources[k].rejected.insert(Rejection::HeldOut);
        }
        Ok(())
    }

    /// The most frequent FWHM of bright sources, or `otherwise` if there is none.
    fn typical_fwhm(&self, sources: &[Source], otherwise: f64) -> f64 {
        let good = |s: &&Source| s.rejected.is_empty() && s.snr > self.selection.least_snr();
        // The most significant sources come first.
        let widths = sources.iter().filter(good).filter_map(|s| s.fwhm_px);
        most_frequent_width(widths.collect()).unwrap_or(otherwise)
    }

    /// Makes stamps from the stars. `accepted` is the number of stars that may serve, those that are
    /// held out included.
    fn register(
        &self,
        view: &FrameView,
        sources: &mut [Source],
        accepted: usize,
        fwhm_px: f64,
    ) -> Result<Registered, StarError> {
        let fine = self
            .registration
            .grid(RegistrationMethod::Epsf, fwhm_px, accepted);
        let coarse = self
            .registration
            .grid(RegistrationMethod::Stamps, fwhm_px, accepted);
        let may_be_epsf = self.registration.may_be_epsf(fwhm_px, accepted, fine.scale)?;
        let undersampled = Registration::is_undersampled(fwhm_px);
        if self.hold_out.0 > 0 && may_be_epsf && undersampled {
            return Err(StarError::NoSamples(
                "undersampled stars cannot be held out with the method epsf (which auto uses for them), because the pixels of a single star do not give its oversampled PSF: compare the model with the stars of another frame, or use the method stamps"
                    .to_owned(),
            ));
        }
        let ownership = Ownership::new(sources, fwhm_px);
        let stars = view.stars(sources, |s| s.rejected.is_empty(), &ownership, fine);
        let epsf = Epsf::fit(stars, fine, fwhm_px, view.shape(), &self.camera, None);
        for &source in &epsf.mismatched {
            sources[source].rejected.insert(Rejection::PsfMismatch);
        }
        // A star's own light at the nodes of a grid divided by the star's flux, and this flux. Its
        // centre is that of the Gaussian fit, which does not depend on the oversampled PSF.
        let own = |star: &Star, grid: FineGrid| -> Option<StampAndFlux> {
            let trusted =
                |x, y| !view.is_masked(x, y) && ownership.allows(star.source, star.flux, x as f64, y as f64);
            let light = own_stamp(view.excess.view(), star.start, star.offset, trusted, grid);
            let nodes_per_pixel = (grid.scale * grid.scale) as f64;
            let flux = epsf.flux_with(star, light.sum() / nodes_per_pixel);
            // Noise and the background's error make the sum differ from the flux. The difference is
            // spread evenly: to divide by a sum near 0 would make noise dominate all samples.
            let missing = (flux * nodes_per_pixel - light.sum()) / light.len() as f64;
            (flux > 0.0).then(|| ((light + missing) / flux, flux))
        };
        let own_stamps =
            || -> Vec<Option<StampAndFlux>> { epsf.stars.par_iter().map(|star| own(star, coarse)).collect() };
        let may_be_stamps = !may_be_epsf || self.registration.is_open(fwhm_px);
        let stamps = may_be_stamps
            .then(own_stamps)
            .filter(|found| !may_be_epsf || neighbours_predict_better(&epsf, found, coarse));
        let (method, grid) = match stamps {
            None => (RegistrationMethod::Epsf, fine),
            Some(_) => (RegistrationMethod::Stamps, coarse),
        };
        let stamps = stamps.unwrap_or_else(|| {
            let own_shapes = self.registration.own_shapes;
            let stars = epsf.stars.par_iter();
            stars.map(|star| epsf.sample(star, own_shapes)).collect()
        });
        let mut held_out = Vec::new();
        let chosen = |s: &Source| s.rejected.contains(Rejection::HeldOut);
        for mut star in view.stars(sources, chosen, &ownership, fine) {
            if let Some((x, y, flux)) = epsf.measure(&star) {
                (star.x, star.y, star.flux) = (x, y, flux);
            }
            match own(&star, grid) {
                Some((stamp, _)) => held_out.push((star.start, stamp)),
                None => sources[star.source].rejected.insert(Rejection::LowSnr),
            }
        }
        let is_epsf = method == RegistrationMethod::Epsf;
        let report = RegistrationReport {
            method,
            oversampling: grid.scale,
            stamp_pixels: grid.side(),
            undersampled,
            field_degree: is_epsf.then(|| epsf.field_degree()),
            median_chi: is_epsf.then_some(epsf.median_chi),
            stamp_noise: None,
        };
        let mut samples = Vec::new();
        for (mut star, stamp) in epsf.stars.into_iter().zip(stamps) {
            match stamp {
                Some((stamp, flux)) => {
                    if !is_epsf {
                        (star.x, star.y) = star.start;
                    }
                    samples.push((star, stamp, flux));
                }
                None => sources[star.source].rejected.insert(Rejection::LowSnr),
            }
        }
        let mut registered = Registered {
            samples,
            held_out,
            grid,
            report,
        };
        registered.report.stamp_noise = (!is_epsf).then(|| registered.stamp_noise());
        Ok(registered)
    }
}

impl Registered {
    /// The median over the samples of the noise of their pixels, as a fraction of the sample's norm.
    fn stamp_noise(&self) -> f64 {
        let noise = self.samples.iter().map(|(star, stamp, flux)| {
            let rms: f64 = star.pixels.iter().map(|p| p.rms).sum::<f64>() / star.pixels.len() as f64;
            let variance = stamp.len() as f64 * (rms / flux).powi(2);
            let power: f64 = stamp.iter().map(|v| v * v).sum();
            (variance / (power - variance).max(variance)).sqrt()
        });
        median(noise)
    }
}

/// Returns whether the own pixels of the nearest stars predict a star better than the oversampled
/// PSF does, for stars that had no part in either.
fn neighbours_predict_better(epsf: &Epsf, stamps: &[Option<StampAndFlux>], grid: FineGrid) -> bool {
    let Some(left_out) = &epsf.left_out else {
        return false;
    };
    let known: Vec<(&Star, Spline)> = epsf
        .stars
        .iter()
        .zip(stamps)
        .filter_map(|(star, stamp)| Some((star, Spline::through(stamp.as_ref()?.0.view()))))
        .collect();
    let (middle, scale) = (grid.middle() as f64, grid.scale as f64);
    left_out.is_worse_than(|star| {
        let distance = |k: usize| (known[k].0.x - star.x).hypot(known[k].0.y - star.y);
        let mut others: Vec<usize> = (0..known.len())
            .filter(|&k| known[k].0.source != star.source)
            .collect();
        others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        others.truncate(NEAREST);
        let weights: Vec<f64> = others.iter().map(|&k| distance(k).max(1.0).powi(-2)).collect();
        let sum: f64 = weights.iter().sum();
        let nearest: Vec<(&Spline, f64)> = others
            .iter()
            .zip(weights)
            .map(|(&k, weight)| (&known[k].1, weight / sum))
            .collect();
        move |dx: f64, dy: f64| {
            let at = |offset: f64| middle + scale * offset;
            nearest
                .iter()
                .map(|(spline, weight)| weight * spline.at(at(dx), at(dy)))
                .sum()
        }
    })
}

/// The number of nearest stars whose pixels predict a star. Interpolation between scattered samples
/// mixes about as many.
const NEAREST: usize = 4;

/// The samples made without one group of stars. `left_out` has the stars of this group: index of
/// the sample, x, y, flux.
struct RegisteredFold {
    samples: Vec<StampAt>,
    left_out: Vec<(usize, f64, f64, f64)>,
}

/// The result of the registration. Each sample is a star, its stamp `[y, x]` of unit flux, and its
/// flux.
struct Registered {
    samples: Vec<(Star, Array2<f64>, f64)>,
    /// Positions and stamps of the stars that are held out.
    held_out: Vec<StampAt>,
    grid: FineGrid,
    report: RegistrationReport,
}

/// Samples of these stamps at the positions of their stars.
fn psf_samples<'a>(
    stars: impl Iterator<Item = ((f64, f64), &'a Array2<f64>)>,
    grid: StampGrid,
    frame: FrameShape,
) -> Result<PsfSamples, StarError> {
    let (at, stamps): (Vec<_>, Vec<_>) = stars.map(|(at, stamp)| (at, stamp.view())).unzip();
    let positions = at.into_iter().map(|(x, y)| Position::new(x, y));
    let positions = SamplePositions::new(positions.collect::<Result<_, _>>()?, Some(frame))?;
    let stamps = stack(Axis(0), &stamps).expect("stamps have one shape");
    Ok(PsfSamples::new(stamps, positions, grid)?)
}

impl FrameView {
    /// Collects samples and sources in their final form.
    fn collected(
        self,
        mut sources: Vec<Source>,
        registered: Registered,
        folds: Vec<RegisteredFold>,
        fwhm_px: f64,
    ) -> Result<StarSamples, StarError> {
        let shape = self.shape();
        self.complete(&mut sources);
        if registered.samples.is_empty() {
            let counts = rejection_counts(&sources);
            let reasons: Vec<String> = counts
                .iter()
                .map(|(reason, n)| match reason {
                    Rejection::Saturated => format!("{n} {} at {}", reason.name(), self.saturation),
                    _ => format!("{n} {}", reason.name()),
                })
                .collect();
            return Err(StarError::NoSamples(format!(
                "none of the sources found ({}) can serve as a PSF sample: {}. Relax the cut that rejects most of them",
                sources.len(),
                reasons.join(", ")
            )));
        }
        let side = registered.grid.side();
        let grid = StampGrid::new(side, side)?.with_oversampling(registered.grid.scale as f64)?;
        let own = registered.samples.iter();
        let samples = psf_samples(own.map(|(s, stamp, _)| ((s.x, s.y), stamp)), grid, shape)?;
        let all_of =
            |stars: &[StampAt]| psf_samples(stars.iter().map(|(at, stamp)| (*at, stamp)), grid, shape);
        let held_out = Some(&registered.held_out[..]).filter(|stars| !stars.is_empty());
        let held_out = held_out.map(all_of).transpose()?;
        for (k, (star, _, flux)) in registered.samples.iter().enumerate() {
            let source = &mut sources[star.source];
            (source.x, source.y, source.flux) = (star.x, star.y, *flux);
            source.sample = Some(k);
        }
        self.measure_psf_fluxes(&mut sources, &registered, fwhm_px);
        let fold_of = |fold: RegisteredFold| -> Result<Fold, StarError> {
            let left_out = fold.left_out.into_iter().map(|(k, x, y, flux)| Source {
                x,
                y,
                flux,
                ..sources[registered.samples[k].0.source].clone()
            });
            Ok(Fold {
                samples: all_of(&fold.samples)?,
                left_out: left_out.collect(),
            })
        };
        let folds = folds.into_iter().map(fold_of).collect::<Result<_, _>>()?;
        Ok(StarSamples {
            folds,
            coverage: CoverageMap::new(samples.positions().as_slice(), shape),
            samples,
            held_out,
            sources,
            fwhm_px,
            saturation: self.saturation,
            background: self.background,
            registration: registered.report,
        })
    }

    /// Measures the fluxes of sources that are not samples, by a fit of the nearest sample's PSF.
    fn measure_psf_fluxes(&self, sources: &mut [Source], registered: &Registered, fwhm_px: f64) {
        let splines: Vec<Spline> = registered
            .samples
            .iter()
            .map(|(_, stamp, _)| Spline::through(stamp.view()))
            .collect();
        let nearest = Neighbours::new(registered.samples.iter().map(|(star, ..)| (star.x, star.y)));
        let grid = registered.grid;
        let (middle, scale) = (grid.middle() as f64, grid.scale as f64);
        let aperture = aperture_px(fwhm_px);
        sources
            .par_iter_mut()
            .filter(|source| source.sample.is_none())
            .for_each(|source| {
                let Some((k, _)) = nearest.nearest(source.x, source.y, |_| true) else {
                    return;
                };
                // A saturated star has only its wings left.
                let radius = if source.rejected.contains(Rejection::Saturated) {
                    grid.reach as f64
                } else {
                    aperture.min(grid.reach as f64)
                };
                let (mut product, mut power) = (0.0, 0.0);
                for (column, row) in self.disc(source.x, source.y, radius) {
                    let pixel = self.pixels[[row, column]];
                    if self.is_masked(column, row) || self.saturation.reached_by(pixel) {
                        continue;
                    }
                    let at = |pixel: usize, centre: f64| middle + scale * (pixel as f64 - centre);
                    let psf = splines[k].at(at(column, source.x), at(row, source.y));
                    product += psf * self.excess[[row, column]];
                    power += psf * psf;
                }
                if power > 0.0 {
                    source.flux = product / power;
                }
            });
    }
}

/// One part of a cross-validation ([`StarSampling::with_cross_validation`]).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Fold {
    /// The samples of all stars that are not left out, of unit flux. The stars left out had no part
    /// in them, except in the choice of the grid, the degree and the rejected stars.
    pub samples: PsfSamples,
    /// The stars left out. With an oversampled PSF, the position and the flux of each star come
    /// from a fit of the other stars' PSF to it. Otherwise they come from the star's own pixels.
    pub left_out: Vec<Source>,
}

/// PSF samples from the stars of a frame, with all information about the way they were made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct StarSamples {
    /// The samples, of unit flux, in the order of their sources.
    pub samples: PsfSamples,
    /// The stamps of the stars that were held out ([`StarSampling::with_hold_out`]), of unit flux,
    /// with the noise of the stars. `None` if there are no such stamps.
    pub held_out: Option<PsfSamples>,
    /// The parts of the cross-validation. Empty unless [`StarSampling::with_cross_validation`]
    /// asked for it and there are at least ten samples.
    pub folds: Vec<Fold>,
    /// Every source found, the most significant first. Rejected sources are included with their
    /// reasons.
    pub sources: Vec<Source>,
    /// The coverage of the field by the samples.
    pub coverage: CoverageMap,
    /// The frame's background.
    pub background: Background,
    /// The most frequent FWHM of the stars in pixels.
    pub fwhm_px: f64,
    /// The saturation level that was used.
    pub saturation: Saturation,
    /// The registration that was used.
    pub registration: RegistrationReport,
}

impl StarSamples {
    /// The number of sources rejected for each reason. A source may have several reasons.
    pub fn rejection_counts(&self) -> Vec<(Rejection, usize)> {
        rejection_counts(&self.sources)
    }
}

fn rejection_counts(sources: &[Source]) -> Vec<(Rejection, usize)> {
    Rejection::ALL
        .into_iter()
        .map(|reason| {
            (
                reason,
                sources.iter().filter(|s| s.rejected.contains(reason)).count(),
            )
        })
        .filter(|(_, count)| *count > 0)
        .collect()
}
