//! From a frame to PSF samples.

use ndarray::Array2;
use psf_types::{Image, Real};
use rayon::prelude::*;

use crate::collected::Registered;
use crate::epsf::Epsf;
use crate::frame_view::FrameView;
use crate::own_stamps::own_stamp;
use crate::ownership::Ownership;
use crate::registration::FineGrid;
use crate::selection::{Candidate, most_frequent_width};
use crate::star::Star;
use crate::{
    BackgroundMesh, Camera, Detection, Registration, RegistrationMethod, RegistrationReport, Rejection,
    Selection, StarError, StarSamples,
};

/// Makes PSF samples from the stars of a frame.
///
/// The steps, each with its own settings: background and its noise ([`BackgroundMesh`]); sources ([`Detection`], a second time with a
/// wider kernel where the stars turn out wide); centre and shape of each by a Gaussian fit; signal-to-noise and saturation
/// ([`Camera`]); cuts ([`Selection`]); registration on a common grid ([`Registration`]); coverage ([`CoverageMap`](crate::CoverageMap)). The
/// result does not depend on the number of threads.
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
}

/// A stamp of unit flux and the star's flux.
type StampAndFlux = (Array2<f64>, f64);

/// The smallest frame along each axis.
const LEAST_PIXELS: usize = 24;
/// Stars this much wider than the kernel are looked for again with a wider one.
const WIDER: f64 = 1.5;

impl StarSampling {
    /// With other settings of the background.
    #[must_use]
    pub fn with_background(self, background: BackgroundMesh) -> Self {
        Self { background, ..self }
    }

    /// With other settings of the detection.
    #[must_use]
    pub fn with_detection(self, detection: Detection) -> Self {
        Self { detection, ..self }
    }

    /// With what is known of the camera.
    #[must_use]
    pub fn with_camera(self, camera: Camera) -> Self {
        Self { camera, ..self }
    }

    /// With other cuts.
    #[must_use]
    pub fn with_selection(self, selection: Selection) -> Self {
        Self { selection, ..self }
    }

    /// With another registration.
    #[must_use]
    pub fn with_registration(self, registration: Registration) -> Self {
        Self { registration, ..self }
    }

    /// Samples of the PSF from the stars of `frame`.
    ///
    /// # Errors
    /// [`StarError`] when the frame is too small or without noise, no source is found, none can serve, or too few for an oversampled
    /// PSF that was asked for by name.
    pub fn run<T: Real>(&self, frame: &Image<T>) -> Result<StarSamples, StarError> {
        let shape = frame.shape();
        if shape.nx().min(shape.ny()) < LEAST_PIXELS {
            return Err(StarError::FrameTooSmall {
                frame: shape,
                need: LEAST_PIXELS,
            });
        }
        let pixels = frame.pixels().mapv(T::as_f64);
        let background = self.background.estimate(pixels.view())?;
        let excess = &pixels - &background.level();
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
        let mut candidates = view.measured(&view.peaks(&detection)?, detection.kernel_fwhm_px());
        let mut fwhm_px = self.typical_fwhm(&candidates, detection.kernel_fwhm_px());
        if fwhm_px > WIDER * detection.kernel_fwhm_px() {
            detection = detection.with_kernel_fwhm_px(fwhm_px.min(50.0))?;
            candidates = view.measured(&view.peaks(&detection)?, fwhm_px);
            fwhm_px = self.typical_fwhm(&candidates, fwhm_px);
        }
        candidates = view.measured(&view.peaks(&detection)?, fwhm_px);
        fwhm_px = self.typical_fwhm(&candidates, fwhm_px);

        let reach = self.registration.reach(fwhm_px);
        self.selection.check_edge(reach)?;
        self.selection.apply(&mut candidates, shape, reach, fwhm_px);
        let accepted = candidates.iter().filter(|c| c.rejected.is_empty()).count();
        let grid = self.registration.grid(fwhm_px, accepted);
        let registered = self.register(&view, &mut candidates, grid, fwhm_px)?;
        view.collected(&candidates, registered, fwhm_px)
    }

    /// The most frequent FWHM of bright sources.
    fn typical_fwhm(&self, candidates: &[Candidate], otherwise: f64) -> f64 {
        let good = |c: &&Candidate| c.rejected.is_empty() && c.snr > self.selection.snr();
        // The most significant ones come first.
        let widths = candidates.iter().filter(good).filter_map(Candidate::fwhm_px);
        most_frequent_width(widths.collect()).unwrap_or(otherwise)
    }

    fn register(
        &self,
        view: &FrameView,
        candidates: &mut [Candidate],
        grid: FineGrid,
        fwhm_px: f64,
    ) -> Result<Registered, StarError> {
        let ownership = Ownership::new(candidates, fwhm_px);
        let stars: Vec<Star> = candidates
            .iter()
            .enumerate()
            .filter(|(_, c)| c.rejected.is_empty())
            .map(|(k, c)| view.star(k, c, &ownership, grid))
            .collect();
        let method = self.registration.resolve(fwhm_px, stars.len(), grid.scale)?;
        let mut report = RegistrationReport {
            method,
            oversampling: grid.scale,
            stamp_pixels: grid.side(),
            undersampled: Registration::is_undersampled(fwhm_px),
            field_degree: None,
            median_chi: None,
        };
        let (stars, stamps): (Vec<Star>, Vec<Option<StampAndFlux>>) = if method == RegistrationMethod::Epsf {
            let epsf = Epsf::fit(stars, grid, fwhm_px, view.shape(), &self.camera);
            report.field_degree = Some(epsf.terms.degree());
            report.median_chi = Some(epsf.median_chi);
            for &source in &epsf.mismatched {
                candidates[source].rejected.insert(Rejection::PsfMismatch);
            }
            let own_shapes = self.registration.own_shapes();
            let stamps = epsf
                .stars
                .par_iter()
                .map(|star| epsf.sample(star, own_shapes))
                .collect();
            (epsf.stars, stamps)
        } else {
            let stamps = stars
                .par_iter()
                .map(|star| {
                    let own = &candidates[star.source];
                    own_stamp(
                        view.excess.view(),
                        star,
                        |x, y| ownership.allows(star.source, own.flux, x as f64, y as f64),
                        grid,
                    )
                })
                .collect();
            (stars, stamps)
        };
        let mut samples = Vec::new();
        for (star, stamp) in stars.into_iter().zip(stamps) {
            match stamp {
                Some((stamp, flux)) => samples.push((star, stamp, flux)),
                None => candidates[star.source].rejected.insert(Rejection::LowSnr),
            }
        }
        Ok(Registered {
            samples,
            grid,
            report,
        })
    }
}
