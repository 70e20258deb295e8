//! The light of a scene before it is divided into layers: images, and sources with their spectra.

use std::collections::HashMap;
use std::path::Path;

use conv_core::ConvReal;
use ndarray::Array2;
use psf_io::{Catalog, SourceColours};
use psf_types::{DataError, Image, PointSource, Position, SersicProfile, SersicSource};
use spectra::{Bandpass, SpectraError, Spectrum};

use crate::colours::{open_spectrum, spectrum_in};
use crate::dispersion::Dispersion;
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Psf;
use crate::scene::Scene;

/// The light of a scene: images, and the sources of a catalogue. If the PSF depends on the wavelength, all
/// light has spectra ([`open_spectrum`]), and each spectrum is a layer of the [`Scene`].
///
/// ```
/// use ndarray::Array2;
/// use psfield::SceneLight;
/// let mut light = SceneLight::<f32>::new();
/// light.add_image(Some("blackbody:4000"), Array2::ones((20, 30)))?;
/// light.add_image(Some("blackbody:9000"), Array2::ones((20, 30)))?;
/// assert_eq!(light.spectra(), ["blackbody:4000", "blackbody:9000"]);
/// assert_eq!(light.into_scene()?.layers().len(), 2);
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug, Clone)]
pub struct SceneLight<T> {
    /// The names of the spectra, one for each layer. Empty: light without a spectrum, in one layer.
    spectra: Vec<String>,
    /// The number of each name.
    numbers: HashMap<String, usize>,
    /// One for each layer.
    images: Vec<LayerImage<T>>,
    /// There is light without a spectrum.
    plain: bool,
    catalog: Catalog,
    /// For each source of the catalogue, its layers and the parts of its flux. Empty: all sources are in the
    /// first layer.
    parts: Vec<Vec<(usize, f64)>>,
}

/// The image of a layer.
#[derive(Debug, Clone)]
enum LayerImage<T> {
    None,
    InMemory(Array2<T>),
    Streamed,
}

/// Sources with more temperatures than this are divided between black bodies at this number of
/// temperatures.
const MOST_TEMPERATURES: usize = 16;

impl<T: ConvReal> Default for SceneLight<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: ConvReal> SceneLight<T> {
    /// No light.
    pub fn new() -> Self {
        Self {
            spectra: Vec::new(),
            numbers: HashMap::new(),
            images: vec![LayerImage::None],
            plain: false,
            catalog: Catalog::default(),
            parts: Vec::new(),
        }
    }

    /// The names of the spectra, in the order in which they were added. Empty for light without a spectrum.
    pub fn spectra(&self) -> &[String] {
        &self.spectra
    }

    /// The catalogue.
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// Returns whether there is an image, in memory or streamed.
    pub fn has_image(&self) -> bool {
        !self.images.iter().all(|image| matches!(image, LayerImage::None))
    }

    /// The number of a spectrum's layer. Adds the spectrum, unless it is known.
    fn layer(&mut self, spectrum: Option<&str>) -> usize {
        let Some(name) = spectrum else {
            self.plain = true;
            return 0;
        };
        if let Some(&number) = self.numbers.get(name) {
            return number;
        }
        let number = self.spectra.len();
        self.numbers.insert(name.to_owned(), number);
        self.spectra.push(name.to_owned());
        self.images.resize(number + 1, LayerImage::None);
        number
    }

    /// Returns an error if only some of the light has spectra.
    fn check_spectra(&self) -> Result<(), PsfieldError> {
        if self.plain && !self.spectra.is_empty() {
            const SOME: &str = "some of the light has a spectrum, and some has none";
            return Err(PsfieldError::new(ErrorKind::Data, SOME));
        }
        Ok(())
    }

    /// Adds an image `[y, x]` to the light of a spectrum.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for an image of another shape than those before.
    pub fn add_image(&mut self, spectrum: Option<&str>, image: Array2<T>) -> Result<(), PsfieldError> {
        let known = self.images.iter().find_map(|known| match known {
            LayerImage::InMemory(known) => Some(known.dim()),
            _ => None,
        });
        if let Some(expected) = known.filter(|&known| known != image.dim()) {
            let got = image.dim();
            return Err(DataError::ImageShape { expected, got }.into());
        }
        let layer = self.layer(spectrum);
        match &mut self.images[layer] {
            LayerImage::InMemory(sum) => sum.zip_mut_with(&image, |sum, &value| *sum += value),
            other => *other = LayerImage::InMemory(image),
        }
        Ok(())
    }

    /// Adds an image that is read row by row ([`Simulator::stream`](crate::Simulator::stream)) to the light
    /// of a spectrum. Returns the number of its layer. None if that layer has an image already.
    pub fn add_streamed(&mut self, spectrum: Option<&str>) -> Option<usize> {
        let layer = self.layer(spectrum);
        if !matches!(self.images[layer], LayerImage::None) {
            return None;
        }
        self.images[layer] = LayerImage::Streamed;
        Some(layer)
    }

    /// Sets the sources, without spectra.
    pub fn set_catalog(&mut self, catalog: Catalog) {
        self.plain |= !catalog.rows().is_empty();
        (self.catalog, self.parts) = (catalog, Vec::new());
    }

    /// Sets the sources. Each has the spectrum of its row, or `default` if the catalogue
    /// has no spectra. Relative paths in the rows begin in `folder`, that of the catalogue's file.
    ///
    /// If the rows have more than 16 different temperatures, the flux of each source is divided between
    /// black bodies at the two nearest of 16 temperatures, so that its PSF is interpolated linearly in
    /// `1 / T` between theirs.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] if the catalogue has no spectra, and there is no default.
    pub fn set_catalog_with_spectra(
        &mut self,
        catalog: Catalog,
        default: Option<&str>,
        folder: &Path,
    ) -> Result<(), PsfieldError> {
        let count = catalog.rows().len();
        self.parts = match (catalog.colours(), default) {
            _ if count == 0 => Vec::new(),
            (Some(SourceColours::Names(names)), _) => {
                let layer = |name: &String| vec![(self.layer(Some(&spectrum_in(folder, name))), 1.0)];
                names.iter().map(layer).collect()
            }
            (Some(SourceColours::Temperatures(all)), _) => {
                let nodes = temperatures(all);
                let layers: Vec<usize> = nodes
                    .iter()
                    .map(|t| self.layer(Some(&format!("blackbody:{t}"))))
                    .collect();
                let divided = |&t: &f64| {
                    parts(&nodes, t)
                        .into_iter()
                        .map(|(node, part)| (layers[node], part))
                };
                all.iter().map(|t| divided(t).collect()).collect()
            }
            (_, Some(default)) => vec![vec![(self.layer(Some(default)), 1.0)]; count],
            _ => {
                const NEEDED: &str = "the catalogue says nothing of the spectra of its sources: add a column sed (names) or teff \
                                      (kelvin), or give one spectrum for all of them";
                return Err(PsfieldError::new(ErrorKind::Data, NEEDED).with_setting("sed"));
            }
        };
        self.catalog = catalog;
        Ok(())
    }

    /// Puts the spectra in the order of their names. Light of the same spectra then has equal PSFs
    /// ([`psf_of`](Self::psf_of)), and can have the same simulator, however it was added.
    pub fn sort_spectra(&mut self) {
        let mut order: Vec<usize> = (0..self.spectra.len()).collect();
        order.sort_by(|&a, &b| self.spectra[a].cmp(&self.spectra[b]));
        let mut place = vec![0; order.len()];
        for (new, &old) in order.iter().enumerate() {
            place[old] = new;
        }
        if !order.is_empty() {
            let image = |&old: &usize| std::mem::replace(&mut self.images[old], LayerImage::None);
            self.images = order.iter().map(image).collect();
        }
        self.spectra = order.iter().map(|&old| self.spectra[old].clone()).collect();
        for number in self.numbers.values_mut() {
            *number = place[*number];
        }
        for (layer, _) in self.parts.iter_mut().flatten() {
            if let Some(&new) = place.get(*layer) {
                *layer = new;
            }
        }
    }

    /// The PSFs of the spectra, one state for each, in their order. `psf` depends
    /// on the wavelength. `dispersion` is that of the atmosphere, if it matters.
    ///
    /// # Errors
    /// The errors of [`open_spectrum`] and [`Psf::for_dispersed_spectra`], and
    /// [`ErrorKind::Data`] for light without spectra.
    pub fn psf_of(
        &self,
        psf: &Psf,
        bandpass: &Bandpass,
        dispersion: Option<&Dispersion>,
    ) -> Result<Psf, PsfieldError> {
        self.check_spectra()?;
        if self.spectra.is_empty() {
            const NO_LIGHT: &str = "the scene has no light: add an image or sources";
            return Err(PsfieldError::new(ErrorKind::Data, NO_LIGHT));
        }
        let spectra: Vec<_> = self
            .spectra
            .iter()
            .map(|name| open_spectrum(name))
            .collect::<Result<_, _>>()?;
        let mixed = match dispersion {
            Some(dispersion) => psf.for_dispersed_spectra(bandpass, &spectra, dispersion),
            None => psf.for_spectra(bandpass, &spectra),
        };
        mixed.map_err(|error| name_spectrum(error, (&self.spectra, &spectra), psf, bandpass))
    }

    /// The scene, with a layer for each spectrum.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for an image with a value that is not finite, and if only some of the light has
    /// spectra.
    pub fn into_scene<'a>(self) -> Result<Scene<'a, T>, PsfieldError>
    where
        T: 'a,
    {
        self.check_spectra()?;
        let mut sources = LayerSources::new(self.images.len());
        for (place, source) in sources_of(&self.catalog).enumerate() {
            for (layer, part) in self.layers_of(place) {
                let flux = part * source.flux;
                sources.push(layer, Source { flux, ..source })?;
            }
        }
        let scenes = self.images.into_iter().zip(sources.0).map(|(image, sources)| {
            let scene = match image {
                LayerImage::None => Scene::dark(),
                LayerImage::InMemory(image) => Scene::from(Image::new(image)?),
                LayerImage::Streamed => Scene::streamed(),
            };
            Ok(scene.with_stars(sources.0).with_galaxies(sources.1))
        });
        Ok(Scene::of_layers(
            scenes.collect::<Result<Vec<_>, PsfieldError>>()?,
        ))
    }

    /// The images of all layers, for scenes that differ in their sources.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for an image with a value that is not finite, and for one that is read row by row.
    pub(crate) fn take_images(&mut self) -> Result<Vec<Option<Image<T>>>, PsfieldError> {
        self.check_spectra()?;
        let images = self.images.drain(..).map(|image| match image {
            LayerImage::None => Ok(None),
            LayerImage::InMemory(image) => Ok(Some(Image::new(image)?)),
            LayerImage::Streamed => {
                const IN_MEMORY: &str = "the images of a series are in memory, not read row by row";
                Err(PsfieldError::new(ErrorKind::Data, IN_MEMORY))
            }
        });
        images.collect()
    }

    /// The layers of the source at a place in the catalogue, and the parts of its flux.
    pub(crate) fn layers_of(&self, place: usize) -> impl Iterator<Item = (usize, f64)> + use<'_, T> {
        const ALL: &[(usize, f64)] = &[(0, 1.0)];
        self.parts.get(place).map_or(ALL, Vec::as_slice).iter().copied()
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

/// A source of a catalogue.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source {
    pub(crate) position: Position,
    pub(crate) flux: f64,
    /// None for a star.
    pub(crate) profile: Option<SersicProfile>,
}

/// The sources of a catalogue: stars, then galaxies.
pub(crate) fn sources_of(catalog: &Catalog) -> impl Iterator<Item = Source> {
    let stars = catalog.stars().iter().map(|star| Source {
        position: star.position(),
        flux: star.flux(),
        profile: None,
    });
    stars.chain(catalog.galaxies().iter().map(|galaxy| Source {
        position: galaxy.position(),
        flux: galaxy.flux(),
        profile: Some(galaxy.profile()),
    }))
}

/// The stars and galaxies of each layer.
pub(crate) struct LayerSources(pub(crate) Vec<(Vec<PointSource>, Vec<SersicSource>)>);

impl LayerSources {
    pub(crate) fn new(layers: usize) -> Self {
        Self(vec![Default::default(); layers])
    }

    pub(crate) fn push(&mut self, layer: usize, source: Source) -> Result<(), DataError> {
        let Source {
            position,
            flux,
            profile,
        } = source;
        let (stars, galaxies) = &mut self.0[layer];
        match profile {
            None => stars.push(PointSource::new(position, flux)?),
            Some(profile) => galaxies.push(SersicSource::new(position, flux, profile)?),
        }
        Ok(())
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
    fn spectra_are_sorted_with_their_light() {
        let mut light = SceneLight::<f64>::new();
        for (name, value) in [("powerlaw:2", 2.0), ("powerlaw:1", 1.0), ("powerlaw:3", 3.0)] {
            light
                .add_image(Some(name), Array2::from_elem((2, 3), value))
                .unwrap();
        }
        let star = PointSource::new(Position::new(1.0, 1.0).unwrap(), 5.0).unwrap();
        let catalog = Catalog::new(vec![star], Vec::new());
        light
            .set_catalog_with_spectra(catalog, Some("powerlaw:3"), Path::new(""))
            .unwrap();
        light.sort_spectra();
        assert_eq!(light.spectra(), ["powerlaw:1", "powerlaw:2", "powerlaw:3"]);
        light.add_image(Some("powerlaw:1"), Array2::ones((2, 3))).unwrap();
        let scene = light.into_scene().unwrap();
        let first = |layer: &crate::scene::Layer<'_, f64>| layer.image().unwrap().pixels()[(0, 0)];
        let values: Vec<f64> = scene.layers().iter().map(first).collect();
        assert_eq!(values, [2.0, 2.0, 3.0]);
        let stars: Vec<usize> = scene.layers().iter().map(|layer| layer.stars().len()).collect();
        assert_eq!(stars, [0, 0, 1]);
    }

    #[test]
    fn light_with_and_without_a_spectrum_is_refused() {
        let mut light = SceneLight::<f64>::new();
        light.add_image(None, Array2::ones((2, 3))).unwrap();
        light.add_image(Some("powerlaw:1"), Array2::ones((2, 3))).unwrap();
        assert_eq!(light.into_scene().unwrap_err().kind(), ErrorKind::Data);
    }

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
        let mut light = SceneLight::<f64>::new();
        let flat = Some("powerlaw:0");
        light.add_image(flat, Array2::ones((3, 4))).unwrap();
        light.add_image(flat, Array2::ones((3, 4))).unwrap();
        assert!(light.add_image(Some("powerlaw:1"), Array2::ones((4, 3))).is_err());
        assert_eq!(light.spectra(), ["powerlaw:0"]);
        assert_eq!(light.add_streamed(flat), None);
        let scene = light.into_scene().unwrap();
        let image = scene.layers()[0].image().unwrap().pixels();
        assert_eq!((scene.layers().len(), image[(2, 3)]), (1, 2.0));
    }
}
