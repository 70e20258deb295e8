//! Field-varying PSFs of ScopeSim.
//!
//! # Layout
//!
//! | HDU | what |
//! |---|---|
//! | 0, primary | `ETYPE` = `FVPSF`, `ECAT` = number of the map's HDU, `EDATA` = number of the first HDU with PSFs (both counted from 0, the primary) |
//! | the map, an image | `[y, x]`: the number of the layer that applies in each pixel; linear world coordinates `CRPIXn`, `CDELTn`, `CRVALn` in `CUNITn` (degrees unless said) from the centre of the field |
//! | the map, a binary table | columns `x`, `y` (arcseconds from the centre of the field) and `layer` |
//! | PSFs, one HDU a wavelength | cube `[layer, y, x]`; `WAVE0` = wavelength in micrometres, `CDELT1` = size of a PSF pixel in `CUNIT1` (degrees unless said) |
//!
//! # What becomes of it
//!
//! * **The field** is piecewise constant: at each position the layer of the nearest pixel (or row) of the map applies. Such a node
//!   of the map lies at `field_centre + offset / pixel_scale` in pixels of the frame; x and y of the frame grow with those of the map,
//!   which must not be rotated. Celestial projections are taken as linear, as ScopeSim does.
//! * **Stamps** have `pixel_scale / CDELT1` pixels per frame pixel, a whole number where that is one but for the header's digits.
//!   Their values are those of the file times the square of that, so that a kernel of unit sum holds unit flux. ScopeSim itself scales every kernel to unit sum (after it has set negative
//!   values to zero, which is not done here): scale to unit flux for the same.
//! * **The centre** is the middle of the stamp, `(n - 1) / 2`, as ScopeSim has it where it rescales kernels; it does not look at `CRPIX1` of
//!   the PSFs, and neither is that done here.
//! * **The pixel response** is taken as included: the file does not say, and ScopeSim convolves with its kernels as they are.

mod kernels;
mod map;
mod options;
mod units;

use std::collections::BTreeMap;
use std::path::Path;

use ndarray::Axis;
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};

use crate::IoError;
use crate::error::invalid;
use crate::gridded_psf::{check_flux, middle};
use crate::library_cards::LibraryCards;
use crate::structure::FitsStructure;

pub use options::ScopesimOptions;

/// A field-varying PSF of ScopeSim: a few layers, and the nodes of a map that say where each of them applies.
///
/// At a position the layer of the nearest node applies ([`Interpolation::Nearest`](psf_types::Interpolation::Nearest)). For a model, fit a
/// basis to [`layers`](Self::layers) and give each node the coefficients of its layer.
#[derive(Debug, Clone, PartialEq)]
pub struct ScopesimPsf {
    layers: PsfSamples,
    nodes: SamplePositions,
    layer_of_node: Vec<usize>,
    wavelength_um: f64,
    notes: Vec<String>,
}

impl ScopesimPsf {
    /// The layers that the map uses, each at the position of the first node that shows it.
    pub fn layers(&self) -> &PsfSamples {
        &self.layers
    }

    /// The nodes of the map, in pixels of the frame.
    pub fn nodes(&self) -> &SamplePositions {
        &self.nodes
    }

    /// For each node the index of its layer in [`layers`](Self::layers).
    pub fn layer_of_node(&self) -> &[usize] {
        &self.layer_of_node
    }

    /// The wavelength of the PSFs that were taken, in micrometres.
    pub fn wavelength_um(&self) -> f64 {
        self.wavelength_um
    }

    /// What a user should know of how the file was read, in plain sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// Whether a file says that it is one.
pub(crate) fn is_scopesim(structure: &FitsStructure) -> bool {
    let kind = structure.hdus.first().and_then(|hdu| hdu.text("ETYPE"));
    kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case("FVPSF"))
}

/// A ratio this near a whole number is meant to be one: headers hold arcseconds in degrees, with as many digits as their writers
/// chose. (ScopeSim itself rounds to five decimals.)
const NEAR_WHOLE: f64 = 1e-6;

fn near_whole(ratio: f64) -> f64 {
    let whole = ratio.round();
    if whole >= 1.0 && (ratio - whole).abs() <= NEAR_WHOLE {
        whole
    } else {
        ratio
    }
}

/// Reads a field-varying PSF of ScopeSim; see the [layout](self).
///
/// ```no_run
/// use psf_io::{ScopesimOptions, read_scopesim};
/// use psf_types::Position;
/// let options = ScopesimOptions::new(0.004, Position::new(2047.5, 2047.5)?)?.with_wavelength_um(2.15)?;
/// let psf = read_scopesim("MAORY_MCAO_FVPSF_4mas.fits", &options)?;
/// println!("{} layers at {} nodes", psf.layers().len(), psf.nodes().len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::Library`] with the card in question where one is missing or malformed, where there are several wavelengths and none is
/// chosen, where the map names a layer that is not there, or where a layer has no flux; [`IoError::MissingHdu`] and
/// [`IoError::Axes`] where map or PSFs are not; [`IoError::NonFinitePixels`]; and the errors of any FITS file.
pub fn read_scopesim(path: impl AsRef<Path>, options: &ScopesimOptions) -> Result<ScopesimPsf, IoError> {
    const MAP: &str = "the number of the HDU with the map of layers, counted from 0";
    const DATA: &str = "the number of the first HDU with PSFs, counted from 0";
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    if !is_scopesim(&structure) {
        return Err(structure
            .missing("card ETYPE = 'FVPSF' in its primary header, as a field-varying PSF of ScopeSim has"));
    }
    let primary = &LibraryCards::new(path, &structure.hdus[0]);
    let map_index = primary.required_count("ECAT", 0, MAP)?;
    let first = primary.required_count("EDATA", 1, DATA)?;
    let map_hdu = structure.hdus.get(map_index).ok_or_else(|| {
        primary.bad_value(
            "ECAT",
            MAP,
            format!("{map_index}, there are {} HDUs", structure.hdus.len()),
        )
    })?;
    let kernels = kernels::choose(&structure, first, map_index, options)?;
    let (layer_count, ny, nx) = kernels.shape();
    let map = map::read(&structure, map_hdu, layer_count)?;

    let nodes = map
        .offsets_arcsec
        .iter()
        .map(|&(x, y)| options.position(x, y).map_err(invalid(path)))
        .collect::<Result<Vec<Position>, _>>()?;
    // Layer of the file to the first node that shows it.
    let mut used = BTreeMap::new();
    for (node, &layer) in map.layers.iter().enumerate() {
        used.entry(layer).or_insert(node);
    }
    let numbers: Vec<usize> = used.keys().copied().collect();
    let layer_of_node = map
        .layers
        .iter()
        .map(|layer| {
            numbers
                .binary_search(layer)
                .expect("every layer of the map is listed")
        })
        .collect();
    let oversampling = near_whole(options.pixel_scale_arcsec() / kernels.pixel_arcsec());
    let grid = StampGrid::new(nx, ny)
        .and_then(|grid| grid.with_centre(middle(nx), middle(ny)))
        .and_then(|grid| grid.with_oversampling(oversampling))
        .map_err(invalid(path))?;
    let mut stamps = kernels.read()?.select(Axis(0), &numbers);
    stamps *= oversampling * oversampling;
    check_flux(path, &stamps, grid, |layer| numbers[layer])?;
    let shown = SamplePositions::new(used.values().map(|&node| nodes[node]).collect(), None);
    let layers = shown.and_then(|positions| PsfSamples::new(stamps, positions, grid));
    Ok(ScopesimPsf {
        layers: layers.map_err(invalid(path))?,
        nodes: SamplePositions::new(nodes, None).map_err(invalid(path))?,
        layer_of_node,
        wavelength_um: kernels.wavelength_um(),
        notes: vec![
            format!(
                "wavelength: the PSFs for {} micrometres were taken",
                kernels.wavelength_um()
            ),
            "pixel response: taken as included, since ScopeSim convolves with its kernels as they are"
                .to_owned(),
        ],
    })
}
