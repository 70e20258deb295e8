//! Injects sources into real frames.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use detector::{Detector, DetectorParams, PixelFlags};
use ndarray::Array2;
use psf_io::{Card, Catalog, HduChoice, HeaderCards, IoError, SkyCoordinates, StoredRow};
use psf_stars::{Camera, StarSampling};
use psf_types::{FrameShape, Image, Progress};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::error::{ErrorKind, PsfieldError};
use crate::image_cards::provenance_cards;
use crate::psf::Psf;
use crate::scene::Scene;
use crate::simulate_options::SimulateOptions;
use crate::simulator::SimulationWarning;
use crate::truth_table::TruthTable;

/// A real frame, into which light is injected.
///
/// The light is that of sources through the PSF of the frame, in the unit of the frame. Its photons are counted, with a
/// Poisson deviate of `gain` times the light in each pixel, and added to the frame, whose own noise is
/// there already. Of a frame of whole numbers, the added numbers are rounded up or down at random, so that their mean stays.
///
/// Pixels without light, header cards, storage type, scaling and other extensions stay as they are
/// ([`edit_image`](psf_io::edit_image)).
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let at = |name: &str| directory.path().join(name);
/// use ndarray::{Array2, Array3};
/// use psfield::inject::{InjectOptions, RealFrame};
/// use psfield::psf_io::{Card, Catalog, HeaderCards, read_image, write_image};
/// use psfield::psf_types::{Image, NoProgress, PointSource, Position};
/// use psfield::{Psf, SimulateOptions};
/// let sky = Image::new(Array2::from_elem((20, 30), 100.0_f32))?;
/// write_image(at("real.fits"), &sky, &HeaderCards::new(), &[Card::new("GAIN", 2.0, "")?], false)?;
/// let frame = RealFrame::open(at("real.fits"), None)?;
/// let psf = Psf::from_samples(Array3::from_elem((1, 1, 1), 1.0).view(), &[(0.0, 0.0)])?;
/// let star = PointSource::new(Position::new(12.0, 7.0)?, 1e6)?;
/// let catalog = Catalog::new(vec![star], Vec::new());
/// let light = frame.light_of(&psf, &catalog, SimulateOptions::default(), &NoProgress)?;
/// let report = frame.inject(&light, at("with_star.fits"), &InjectOptions::default())?;
/// assert!((report.electrons / 2e6 - 1.0).abs() < 0.01);
/// let made = read_image::<f32>(at("with_star.fits"))?;
/// assert_eq!(made.image().pixels()[[7, 11]], 100.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RealFrame {
    path: PathBuf,
    extension: Option<HduChoice>,
    header: HeaderCards,
    shape: FrameShape,
    /// The level of the card `SATURATE`, if it is above the sky. Found when it is first needed.
    header_saturation: OnceLock<Option<f64>>,
}

/// The light of sources in a frame ([`RealFrame::light_of`]).
#[derive(Debug)]
pub struct InjectedLight {
    image: Image<f64>,
    table: TruthTable,
    warnings: Vec<SimulationWarning>,
}

impl InjectedLight {
    /// Where the sources are in the frame.
    pub fn table(&self) -> &TruthTable {
        &self.table
    }

    /// Warnings about the sources and the PSF at them.
    pub fn warnings(&self) -> &[SimulationWarning] {
        &self.warnings
    }
}

/// The settings of an injection.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct InjectOptions {
    /// Electrons per unit of the frame. None: the card `EGAIN` or `GAIN`.
    pub gain: Option<f64>,
    /// The value at which pixels saturate. None: the card `SATURATE`, if there is one above the sky.
    pub saturation: Option<f64>,
    /// The seed of the photon noise.
    pub seed: u64,
    /// A table of the sources to write, too.
    pub truth_table: Option<PathBuf>,
    /// Replace a file that exists.
    pub overwrite: bool,
}

/// The result of an injection.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InjectReport {
    /// Electrons per unit of the frame.
    pub gain: f64,
    /// The value at which pixels saturate, if it is known.
    pub saturation: Option<f64>,
    /// The seed.
    pub seed: u64,
    /// The electrons that were added, before pixels saturate.
    pub electrons: f64,
    /// Pixels that hold injected light.
    pub pixels: usize,
    /// Pixels that hold injected light and are saturated now.
    pub saturated_pixels: usize,
}

/// The random numbers that round differ from those of the photons of the same seed.
const OF_ROUNDING: u64 = 0x5EED_0F00_80D1_D500;

impl RealFrame {
    /// Opens a frame.
    ///
    /// # Errors
    /// The errors of [`ImageReader::open_hdu`](psf_io::ImageReader::open_hdu).
    pub fn open(path: impl AsRef<Path>, extension: Option<HduChoice>) -> Result<Self, PsfieldError> {
        let path = path.as_ref();
        let reader = psf_io::ImageReader::open_hdu(path, extension.as_ref())?;
        Ok(Self {
            path: path.to_owned(),
            extension,
            header: reader.header().clone(),
            shape: reader.shape(),
            header_saturation: OnceLock::new(),
        })
    }

    /// Columns and rows.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// The header.
    pub fn header(&self) -> &HeaderCards {
        &self.header
    }

    /// The world coordinates. `None` if the header has none that are supported.
    pub fn sky(&self) -> Option<SkyCoordinates> {
        SkyCoordinates::from_header(&self.header).ok()
    }

    /// Electrons per unit of the frame: the given number, or that of the card `EGAIN` or `GAIN`. (`EGAIN` comes first,
    /// because some cameras write the number of a setting to `GAIN`.)
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a gain that is missing or not above 0.
    pub fn gain(&self, given: Option<f64>) -> Result<f64, PsfieldError> {
        let is_gain = |gain: &f64| *gain > 0.0 && gain.is_finite();
        let file = self.path.display();
        if let Some(gain) = given {
            let problem = || format!("{file}: the gain must be above 0, got {gain}");
            return given
                .filter(is_gain)
                .ok_or_else(|| PsfieldError::of_setting("gain", problem()));
        }
        let in_header = ["EGAIN", "GAIN"]
            .into_iter()
            .filter_map(|keyword| self.header.number(keyword));
        in_header.into_iter().find(is_gain).ok_or_else(|| {
            let problem = format!(
                "{file}: the header states no gain (GAIN or EGAIN): give the electrons per unit of the frame"
            );
            PsfieldError::of_setting("gain", problem)
        })
    }

    /// The value at which pixels saturate: the given number, or that of the card `SATURATE`, which is ignored if it is
    /// not above the median of the frame.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] for a given level that is not finite, and the errors of reading the frame.
    pub fn saturation(&self, given: Option<f64>) -> Result<Option<f64>, PsfieldError> {
        if let Some(level) = given {
            let problem = || format!("the saturation must be a finite number, got {level}");
            let level = given.filter(|level| level.is_finite());
            return level
                .map(Some)
                .ok_or_else(|| PsfieldError::of_setting("saturation", problem()));
        }
        if let Some(known) = self.header_saturation.get() {
            return Ok(*known);
        }
        let level = match self.header.number("SATURATE") {
            Some(level) => (level > self.median()?).then_some(level),
            None => None,
        };
        Ok(*self.header_saturation.get_or_init(|| level))
    }

    /// The median of the frame.
    fn median(&self) -> Result<f64, PsfieldError> {
        let mut reader = psf_io::ImageReader::open_hdu(&self.path, self.extension.as_ref())?;
        let pixels = reader.read_rows_with_undefined(0..self.shape.ny())?;
        let mut known: Vec<f64> = pixels.into_iter().filter(|value| value.is_finite()).collect();
        let middle = known.len() / 2;
        if known.is_empty() {
            return Ok(f64::NEG_INFINITY);
        }
        Ok(*known.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// The PSF of the frame's stars, found with the default settings of [`StarSampling`].
    ///
    /// # Errors
    /// [`ErrorKind::Stars`] for a frame with too few stars, [`ErrorKind::Io`] for undefined pixels.
    pub fn psf_of_stars(&self, options: &InjectOptions) -> Result<Psf, PsfieldError> {
        let mut reader = psf_io::ImageReader::open_hdu(&self.path, self.extension.as_ref())?;
        let pixels = reader.read_rows::<f64>(0..self.shape.ny())?;
        let mut camera = Camera::new();
        if let Some(gain) = options.gain {
            camera = camera.with_gain(gain)?;
        }
        if let Some(level) = options.saturation {
            camera = camera.with_saturation(level)?;
        }
        if let Some(level) = self.header.number("SATURATE").filter(|level| level.is_finite()) {
            camera = camera.with_header_saturation(level)?;
        }
        let found = StarSampling::default().with_camera(camera).run_masked(pixels)?;
        Ok(Psf::from(found.samples))
    }

    /// The light of a catalogue's sources through a PSF. Positions are pixels of the frame.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for a source of negative flux, which has no photons, and the errors of
    /// [`Simulator::simulate`](crate::Simulator::simulate).
    pub fn light_of(
        &self,
        psf: &Psf,
        catalog: &Catalog,
        options: SimulateOptions,
        progress: &dyn Progress,
    ) -> Result<InjectedLight, PsfieldError> {
        let stars = catalog.stars().iter().map(|star| star.flux());
        let fluxes = stars.chain(catalog.galaxies().iter().map(|galaxy| galaxy.flux()));
        if let Some((&row, _)) = catalog.rows().iter().zip(fluxes).find(|(_, flux)| *flux < 0.0) {
            let problem = format!("row {row} (0-based) has a negative flux, which has no photons: remove it");
            return Err(PsfieldError::new(ErrorKind::Data, problem));
        }
        let simulator = psf.simulator((self.shape.ny(), self.shape.nx())).options(options);
        let simulator = simulator.build::<f64>()?;
        let scene = Scene::dark()
            .with_stars(catalog.stars())
            .with_galaxies(catalog.galaxies());
        simulator.prepare(&scene, progress)?;
        Ok(InjectedLight {
            image: simulator.simulate(&scene)?,
            table: TruthTable::new(catalog, simulator.shown_region(), self.sky().as_ref()),
            warnings: simulator.warnings(&scene, None),
        })
    }

    /// Checks that no output replaces the frame or the other output.
    fn check_outputs(&self, output: &Path, table: Option<&Path>) -> Result<(), PsfieldError> {
        let is = |path: &Path, other: &Path| match (path.canonicalize(), other.canonicalize()) {
            (Ok(path), Ok(other)) => path == other,
            _ => path == other,
        };
        for (name, path) in [("output", Some(output)), ("truth_table", table)] {
            let Some(path) = path else { continue };
            if is(path, &self.path) || (name == "truth_table" && is(path, output)) {
                let problem = format!("{} would replace another file of the injection", path.display());
                return Err(PsfieldError::of_setting(name, problem + ": choose another name"));
            }
        }
        Ok(())
    }

    /// Writes the frame with light in it. Light below 0, such as the rounding of a dark pixel, adds nothing.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for light of another frame, [`ErrorKind::Setting`] for a missing gain and for an output that
    /// is the frame itself, and those of [`edit_image`](psf_io::edit_image).
    pub fn inject(
        &self,
        light: &InjectedLight,
        output: impl AsRef<Path>,
        options: &InjectOptions,
    ) -> Result<InjectReport, PsfieldError> {
        let output = output.as_ref();
        let InjectedLight { image, table, .. } = light;
        if image.shape() != self.shape {
            let message = format!(
                "the light has {} pixels, but the frame has {}",
                image.shape(),
                self.shape
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        self.check_outputs(output, options.truth_table.as_deref())?;
        let gain = self.gain(options.gain)?;
        let saturation = self.saturation(options.saturation)?;
        let photons = Detector::new(DetectorParams {
            photon_noise: true,
            electrons_per_flux: gain,
            ..DetectorParams::default()
        })?;
        let electrons = photons.expose(image, options.seed)?.into_counts_and_flags().0;
        let mut report = InjectReport {
            gain,
            saturation,
            seed: options.seed,
            electrons: 0.0,
            pixels: 0,
            saturated_pixels: 0,
        };
        let mut flags = Array2::zeros((self.shape.ny(), self.shape.nx()));
        let history = format!(
            "psfield {}: sources injected, gain {gain} electron per unit, seed {}",
            env!("CARGO_PKG_VERSION"),
            options.seed
        );
        let extension = self.extension.as_ref();
        psf_io::write_together(|| {
            let add = |row: StoredRow<'_>| -> Result<bool, IoError> {
                let mut rounding = ChaCha8Rng::seed_from_u64(options.seed ^ OF_ROUNDING);
                rounding.set_stream(row.y as u64);
                let mut changed = false;
                let (scale, zero) = row.scaling;
                let all = electrons.pixels();
                let added = all.row(row.y);
                for (x, (number, &added)) in row.numbers.iter_mut().zip(added).enumerate() {
                    if number.is_nan() {
                        continue;
                    }
                    if added > 0.0 {
                        changed = true;
                        report.electrons += added;
                        report.pixels += 1;
                        let mut sum = *number + added / gain / scale;
                        if let Some((lowest, highest)) = row.whole {
                            sum = (sum + rounding.random::<f64>()).floor().clamp(lowest, highest);
                        }
                        if let Some(level) = saturation {
                            // A pixel that was brighter already stays as it is.
                            let most = (level - zero) / scale;
                            let most = match row.whole {
                                None => most,
                                Some(_) if scale > 0.0 => most.ceil(),
                                Some(_) => most.floor(),
                            };
                            if (sum - most) * scale.signum() > 0.0 {
                                sum = if (*number - most) * scale.signum() > 0.0 {
                                    *number
                                } else {
                                    most
                                };
                            }
                        }
                        *number = sum;
                    }
                    let is_full = saturation.is_some_and(|level| zero + scale * *number >= level);
                    if is_full {
                        flags[[row.y, x]] = PixelFlags::SATURATED;
                        report.saturated_pixels += usize::from(added > 0.0);
                    }
                }
                Ok(changed)
            };
            psf_io::edit_image(&self.path, extension, output, &history, options.overwrite, add)?;
            let Some(path) = &options.truth_table else {
                return Ok(());
            };
            let table = match saturation {
                Some(_) => table.clone().with_flags(flags.view()),
                None => table.clone(),
            };
            let mut cards = provenance_cards("psfield inject");
            cards.push(Card::new(
                "INJSEED",
                options.seed.to_string(),
                "seed of the photon noise",
            )?);
            Ok::<_, PsfieldError>(table.write(path, &cards, options.overwrite)?)
        })?;
        Ok(report)
    }
}
