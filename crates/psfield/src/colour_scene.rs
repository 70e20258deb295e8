//! Scenes in colour: the light of each spectrum.

use std::collections::HashMap;
use std::path::Path;

use conv_core::ConvReal;
use ndarray::Array2;
use psf_io::{Catalog, SourceColours};
use psf_types::{DataError, Image, PointSource, SersicSource};
use spectra::{Bandpass, SpectraError, Spectrum};

use crate::{
    ColourSimulator, Dispersion, ErrorKind, Psf, PsfieldError, Scene, SimulateOptions, open_spectrum,
    spectrum_in,
};

/// Light of several spectra, each with its name ([`open_spectrum`]): images, stars and galaxies.
///
/// ```
/// use ndarray::Array2;
/// use psfield::ColourScene;
/// let mut scene = ColourScene::<f32>::new();
/// scene.add_image("blackbody:4000", Array2::ones((20, 30)))?;
/// scene.add_image("blackbody:9000", Array2::ones((20, 30)))?;
/// assert_eq!(scene.names(), ["blackbody:4000", "blackbody:9000"]);
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct ColourScene<T> {
    names: Vec<String>,
    /// The number of each name.
    numbers: HashMap<String, usize>,
    light: Vec<Light<T>>,
}

/// The light of one spectrum.
#[derive(Debug, Clone)]
struct Light<T> {
    image: Option<Array2<T>>,
    stars: Vec<PointSource>,
    galaxies: Vec<SersicSource>,
}

/// Sources with more temperatures than this are divided between black bodies at this number of
/// temperatures.
const MOST_TEMPERATURES: usize = 16;

impl<T: ConvReal> ColourScene<T> {
    /// A scene without light.
    pub fn new() -> Self {
        Self {
            names: Vec::new(),
            numbers: HashMap::new(),
            light: Vec::new(),
        }
    }

    /// The names of the spectra, in the order in which they were added.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Adds a spectrum, unless it was added before. Returns its number in [`names`](Self::names). For an
    /// image that is read row by row ([`ColourSimulator::stream`]).
    pub fn add_spectrum(&mut self, name: &str) -> usize {
        let known = self.numbers.get(name).copied();
        known.unwrap_or_else(|| {
            self.numbers.insert(name.to_owned(), self.names.len());
            self.names.push(name.to_owned());
            self.light.push(Light {
                image: None,
                stars: Vec::new(),
                galaxies: Vec::new(),
            });
            self.names.len() - 1
        })
    }

    /// Adds an image `[y, x]` to the light of a spectrum.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for an image of another shape than those before.
    pub fn add_image(&mut self, spectrum: &str, image: Array2<T>) -> Result<(), PsfieldError> {
        let known = self.light.iter().find_map(|light| light.image.as_ref());
        if let Some(known) = known.filter(|known| known.dim() != image.dim()) {
            let (expected, got) = (known.dim(), image.dim());
            return Err(DataError::ImageShape { expected, got }.into());
        }
        let light = self.light_of(spectrum);
        match &mut light.image {
            Some(sum) => sum.zip_mut_with(&image, |sum, &value| *sum += value),
            none => *none = Some(image),
        }
        Ok(())
    }

    /// Adds the sources of a catalogue. Each has the spectrum of its row, or `default` if the catalogue
    /// has no spectra. Relative paths in the rows begin in `folder`, that of the catalogue's file.
    ///
    /// If the rows have more than 16 different temperatures, the flux of each source is divided between
    /// black bodies at the two nearest of 16 temperatures, so that its PSF is interpolated linearly in
    /// `1 / T` between theirs.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] if the catalogue has no spectra, and there is no default.
    pub fn add_catalog(
        &mut self,
        catalog: Catalog,
        default: Option<&str>,
        folder: &Path,
    ) -> Result<(), PsfieldError> {
        let colours = catalog.colours().cloned();
        let (stars, galaxies) = catalog.into_parts();
        if stars.is_empty() && galaxies.is_empty() {
            return Ok(());
        }
        let sources = stars
            .into_iter()
            .map(Source::Star)
            .chain(galaxies.into_iter().map(Source::Galaxy));
        match (colours, default) {
            (Some(SourceColours::Names(names)), _) => {
                sources
                    .zip(names)
                    .for_each(|(source, name)| self.light_of(&spectrum_in(folder, &name)).push(source));
            }
            (Some(SourceColours::Temperatures(all)), _) => {
                let nodes = temperatures(&all);
                let names: Vec<String> = nodes.iter().map(|t| format!("blackbody:{t}")).collect();
                for (source, &t) in sources.zip(&all) {
                    for (node, part) in parts(&nodes, t) {
                        let part = source.scaled(part)?;
                        self.light_of(&names[node]).push(part);
                    }
                }
            }
            (_, Some(default)) => {
                let light = self.light_of(default);
                sources.for_each(|source| light.push(source));
            }
            _ => {
                const NEEDED: &str = "the catalogue says nothing of the spectra of its sources: add a column sed (names) or teff \
                                      (kelvin), or give one spectrum for all of them";
                return Err(PsfieldError::new(ErrorKind::Data, NEEDED).with_setting("sed"));
            }
        }
        Ok(())
    }

    /// Makes the simulator of this scene, and the scenes for it, one for each spectrum. `psf` depends
    /// on the wavelength, and `shape` is that of the scene `(ny, nx)`, in its own pixels. `dispersion` is
    /// that of the atmosphere, if it matters.
    ///
    /// # Errors
    /// The errors of [`open_spectrum`], [`Psf::for_dispersed_spectra`] and [`ColourSimulator::new`], and
    /// [`ErrorKind::Data`] for a scene without light or an image with a value that is not finite.
    pub fn into_simulator(
        self,
        psf: &Psf,
        (bandpass, dispersion): (&Bandpass, Option<&Dispersion>),
        shape: (usize, usize),
        options: &SimulateOptions,
    ) -> Result<(ColourSimulator<T>, Vec<Scene<'static, T>>), PsfieldError> {
        if self.names.is_empty() {
            return Err(PsfieldError::new(
                ErrorKind::Data,
                "the scene has no light: add an image or sources",
            ));
        }
        let spectra: Vec<_> = self
            .names
            .iter()
            .map(|name| open_spectrum(name))
            .collect::<Result<_, _>>()?;
        let mixed = match dispersion {
            Some(dispersion) => psf.for_dispersed_spectra(bandpass, &spectra, dispersion),
            None => psf.for_spectra(bandpass, &spectra),
        };
        let psf = mixed.map_err(|error| name_spectrum(error, (&self.names, &spectra), psf, bandpass))?;
        let mut scenes = Vec::with_capacity(self.light.len());
        for light in self.light {
            let scene = match light.image {
                Some(image) => Scene::from(Image::new(image)?),
                None => Scene::dark(),
            };
            scenes.push(scene.with_stars(light.stars).with_galaxies(light.galaxies));
        }
        Ok((ColourSimulator::new(&psf, shape, options)?, scenes))
    }

    fn light_of(&mut self, spectrum: &str) -> &mut Light<T> {
        let number = self.add_spectrum(spectrum);
        &mut self.light[number]
    }
}

/// Adds the name of the spectrum to an error of a single spectrum. Other errors are returned unchanged.
fn name_spectrum(
    error: PsfieldError,
    (names, spectra): (&[String], &[Spectrum]),
    psf: &Psf,
    bandpass: &Bandpass,
) -> PsfieldError {
    if psf.wavelengths().is_err() {
        return error;
    }
    let mut failures = names.iter().zip(spectra).filter_map(|(name, spectrum)| {
        let error = psf.photons_of(bandpass, spectrum).err()?;
        // An error of the spectrum alone is not one of the PSF.
        let kind = match error.cause::<SpectraError>() {
            Some(_) => ErrorKind::Setting,
            None => error.kind(),
        };
        Some(PsfieldError::new(kind, format!("the spectrum {name}: {error}")))
    });
    failures.next().unwrap_or(error)
}

impl<T> Light<T> {
    fn push(&mut self, source: Source) {
        match source {
            Source::Star(star) => self.stars.push(star),
            Source::Galaxy(galaxy) => self.galaxies.push(galaxy),
        }
    }
}

/// A source of a catalogue.
enum Source {
    Star(PointSource),
    Galaxy(SersicSource),
}

impl Source {
    /// The source with a part of its flux.
    fn scaled(&self, part: f64) -> Result<Self, DataError> {
        Ok(match self {
            Self::Star(star) => Self::Star(PointSource::new(star.position(), part * star.flux())?),
            Self::Galaxy(galaxy) => {
                let flux = part * galaxy.flux();
                Self::Galaxy(SersicSource::new(galaxy.position(), flux, galaxy.profile())?)
            }
        })
    }
}

/// The distinct temperatures, ascending, or fewer ones in even steps of `1 / T`.
fn temperatures(all: &[f64]) -> Vec<f64> {
    let mut distinct = all.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    if distinct.len() <= MOST_TEMPERATURES {
        return distinct;
    }
    let (coldest, hottest) = (distinct[0], distinct[distinct.len() - 1]);
    let steps = (MOST_TEMPERATURES - 1) as f64;
    let node = |i: usize| match i as f64 / steps {
        0.0 => coldest,
        1.0 => hottest,
        part => 1.0 / ((1.0 - part) / coldest + part / hottest),
    };
    (0..MOST_TEMPERATURES).map(node).collect()
}

/// The temperatures next to `t` and their weights, linear in `1 / T`.
fn parts(nodes: &[f64], t: f64) -> Vec<(usize, f64)> {
    let above = nodes.partition_point(|&node| node < t);
    if above == nodes.len() || nodes[above] == t {
        return vec![(above.min(nodes.len() - 1), 1.0)];
    }
    let (low, high) = (1.0 / nodes[above - 1], 1.0 / nodes[above]);
    let part = (low - 1.0 / t) / (low - high);
    vec![(above - 1, 1.0 - part), (above, part)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_temperatures_are_exact_and_many_are_divided() {
        assert_eq!(temperatures(&[6000.0, 3000.0, 6000.0]), [3000.0, 6000.0]);
        assert_eq!(parts(&[3000.0, 6000.0], 6000.0), [(1, 1.0)]);
        let many: Vec<f64> = (0..1000).map(|i| 2500.0 + 17.5 * f64::from(i)).collect();
        let nodes = temperatures(&many);
        assert_eq!((nodes.len(), nodes[0], nodes[15]), (16, 2500.0, many[999]));
        for &t in &many {
            let parts = parts(&nodes, t);
            let total: f64 = parts.iter().map(|(_, part)| part).sum();
            let inverse: f64 = parts.iter().map(|&(node, part)| part / nodes[node]).sum();
            assert!(
                (total - 1.0).abs() < 1e-14 && (inverse * t - 1.0).abs() < 1e-12,
                "{t}"
            );
            assert!(parts.iter().all(|&(_, part)| (0.0..=1.0).contains(&part)));
        }
    }

    #[test]
    fn light_of_one_spectrum_is_added_up() {
        let mut scene = ColourScene::<f64>::new();
        scene.add_image("powerlaw:0", Array2::ones((3, 4))).unwrap();
        scene.add_image("powerlaw:0", Array2::ones((3, 4))).unwrap();
        assert_eq!(scene.names().len(), 1);
        assert_eq!(scene.light[0].image.as_ref().unwrap()[(2, 3)], 2.0);
        assert!(scene.add_image("powerlaw:1", Array2::ones((4, 3))).is_err());
    }
}
