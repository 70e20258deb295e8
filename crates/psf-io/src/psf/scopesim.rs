//! PSFs of ScopeSim that vary over the field or with the wavelength.
//!
//! # Layout
//!
//! | HDU | content |
//! |---|---|
//! | 0, primary | `ECAT` = number of the map's HDU (negative: there is no map, the PSF is the same everywhere), `EDATA` = number of the first HDU with PSFs (both counted from 0, the primary); `ETYPE` = `FVPSF`, which may be missing |
//! | the map, an image | `[y, x]`: the number of the layer (counted from 0) that applies in each pixel; linear world coordinates `CRPIXn`, `CDELTn`, `CRVALn`, measured from the centre of the field in `CUNITn` (degrees by default) |
//! | the map, a binary table | columns `x`, `y` (arcseconds from the centre of the field) and `layer` |
//! | PSFs, one HDU per wavelength | cube `[layer, y, x]`; `WAVE0` = wavelength in micrometres, `CDELT1` = size of a PSF pixel in `CUNIT1` (degrees by default) |
//!
//! A constant PSF of one wavelength is an image like any other. Only several wavelengths make it a file of
//! this kind.
//!
//! # Interpretation
//!
//! - **The field** is piecewise constant: at each position the layer of the nearest pixel (or row)
//!   of the map applies. A pixel or row of the map is called a node. It is at
//!   `field_centre + offset / pixel_scale` in pixels of the frame, where `offset` is its coordinate
//!   in the map. x and y of the frame increase with x and y of the map, which must not be rotated.
//!   Celestial projections are treated as linear, as in ScopeSim.
//! - **Stamps** have `s = pixel_scale / CDELT1` pixels per frame pixel. `s` is rounded to a whole
//!   number if the difference is due only to the limited number of digits in headers. The values of
//!   the stamps are the values in the file times `s^2`, so that a kernel of unit sum holds unit
//!   flux. ScopeSim itself scales every kernel to unit sum, after it has set negative values to
//!   zero. This reader keeps negative values. Scale the PSF to unit flux for a comparable result.
//! - **The centre** is the middle of the stamp, `(n - 1) / 2`, as ScopeSim assumes when it rescales
//!   kernels. Neither ScopeSim nor this reader uses `CRPIX1` of the PSFs.
//! - **The pixel response** is assumed to be part of the PSFs. The file does not state it, and
//!   ScopeSim itself adds none.

use std::collections::BTreeMap;
use std::path::Path;

use ndarray::{Axis, concatenate};
use psf_types::{DataError, Position, PsfSamples, SamplePositions, StateKind};

use crate::error::{IoError, IoErrorKind, invalid};
use crate::fits::columns::Table;
use crate::fits::hdu::{Hdu, HduKind};
use crate::fits::image::{read_stack, squeezed};
use crate::fits::structure::FitsStructure;
use crate::psf::gridded::{LibraryCards, centred_grid, check_flux, cube_shape};
use crate::units::angle_in_deg;

/// A field-varying PSF of ScopeSim: a few layers, and a map that states where each layer applies. A
/// node is a pixel or row of the map.
///
/// At a position the layer of the nearest node applies
/// ([`Interpolation::Nearest`](psf_types::Interpolation::Nearest)). To make a model, fit a basis to
/// [`layers`](Self::layers) and give each node the coefficients of its layer.
#[derive(Debug, Clone, PartialEq)]
pub struct ScopesimPsf {
    layers: PsfSamples,
    nodes: SamplePositions,
    layer_of_node: Vec<usize>,
    wavelengths_um: Vec<f64>,
    notes: Vec<String>,
}

impl ScopesimPsf {
    /// The layers used by the map, each at the position of its first node. If several wavelengths were
    /// read, there is a state for each ([`SamplePositions::in_every_state`]).
    pub fn layers(&self) -> &PsfSamples {
        &self.layers
    }

    /// The nodes of the map, in pixels of the frame.
    pub fn nodes(&self) -> &SamplePositions {
        &self.nodes
    }

    /// For each node, the index of its layer among those of one wavelength in [`layers`](Self::layers).
    pub fn layer_of_node(&self) -> &[usize] {
        &self.layer_of_node
    }

    /// The wavelengths of the PSFs that were read, in micrometres, ascending.
    pub fn wavelengths_um(&self) -> &[f64] {
        &self.wavelengths_um
    }

    /// Notes for the user on how the file was read, in plain sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// Returns whether a file is marked as a PSF of ScopeSim that varies over the field or with the wavelength.
pub(crate) fn is_scopesim(structure: &FitsStructure) -> bool {
    let Some(primary) = structure.hdus.first() else {
        return false;
    };
    let kind = primary.text("ETYPE");
    if kind.is_some_and(|kind| kind.trim().eq_ignore_ascii_case("FVPSF")) {
        return true;
    }
    let numbers = ["ECAT", "EDATA"].map(|keyword| primary.value::<i64>(keyword));
    let images = |hdu: &&Hdu| hdu.kind == HduKind::Image && hdu.header.get("WAVE0").is_some();
    let count = structure.hdus.iter().filter(images).count();
    match numbers {
        [Some(map), Some(_)] if map < 0 => count > 1,
        [Some(_), Some(_)] => count > 0,
        _ => false,
    }
}

/// A ratio this close to a whole number is rounded to it, because headers state arcseconds as
/// degrees with a limited number of digits. (ScopeSim itself rounds to five decimals.)
const NEAR_WHOLE: f64 = 1e-6;

fn near_whole(ratio: f64) -> f64 {
    let whole = ratio.round();
    if whole >= 1.0 && (ratio - whole).abs() <= NEAR_WHOLE {
        whole
    } else {
        ratio
    }
}

/// Reads a field-varying PSF of ScopeSim. See the [layout](self).
///
/// ```no_run
/// use psf_io::{ScopesimOptions, read_scopesim};
/// use psf_types::Position;
/// let centre = Position::new(2047.5, 2047.5)?;
/// let options = ScopesimOptions::new(0.004)?.with_field_centre(centre).with_wavelength_um(2.15)?;
/// let psf = read_scopesim("MAORY_MCAO_FVPSF_4mas.fits", &options)?;
/// println!("{} layers at {} nodes", psf.layers().len(), psf.nodes().len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`IoErrorKind::Header`] with the keyword that is missing, malformed or not supported
/// - [`IoErrorKind::Setting`] for several wavelengths without a choice, if their PSFs have different
///   pixels
/// - [`IoErrorKind::Data`] for a layer number in the map that does not exist, a layer whose flux is
///   not positive, or two nodes at one position
/// - [`IoErrorKind::Format`] or [`IoErrorKind::Axes`] if the map or the PSFs are missing or have
///   the wrong axes
/// - [`IoErrorKind::Table`] for a column of the map that is missing or has another format
/// - the [errors of any FITS file](crate#bad-files)
pub fn read_scopesim(path: impl AsRef<Path>, options: &ScopesimOptions) -> Result<ScopesimPsf, IoError> {
    const MAP: &str = "the number of the HDU with the map of layers, counted from 0";
    const DATA: &str = "the number of the first HDU with PSFs, counted from 0";
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    if !is_scopesim(&structure) {
        return Err(structure.missing(
            "keywords ECAT and EDATA of a PSF of ScopeSim in its primary header, and an image with WAVE0",
        ));
    }
    let primary = &LibraryCards::new(&structure.hdus[0]);
    let is_constant = structure.hdus[0].value::<i64>("ECAT").is_some_and(|map| map < 0);
    let map_index = if is_constant {
        None
    } else {
        Some(primary.required_count("ECAT", 0, MAP)?)
    };
    let first = primary.required_count("EDATA", 1, DATA)?;
    if !is_constant && options.field_centre.is_none() {
        const CENTRE: &str = "this is a PSF of ScopeSim, which does not state where its field lies on the frame: give the centre \
                              of the field (x, y) in 0-based pixels";
        let error = IoError::new(path, IoErrorKind::Setting, CENTRE);
        return Err(error.with_setting("field_centre"));
    }
    let kernels = Kernels::choose(&structure, first, map_index, options)?;
    let (layer_count, ny, nx) = kernels[0].shape;
    let map = match map_index {
        Some(number) => {
            let hdu = structure.hdus.get(number).ok_or_else(|| {
                let count = structure.hdus.len();
                primary
                    .hdu
                    .wrong_value("ECAT", MAP, format!("{number}, but there are {count} HDUs"))
            })?;
            LayerMap::read(&structure, hdu, layer_count)?
        }
        None if layer_count == 1 => LayerMap {
            offsets_arcsec: vec![(0.0, 0.0)],
            layers: vec![0],
        },
        None => {
            return Err(kernels[0]
                .hdu
                .axes_error("a PSF [y, x], because the file has no map of layers"));
        }
    };

    let nodes = map
        .offsets_arcsec
        .iter()
        .map(|&(x, y)| options.position(x, y).map_err(invalid(path)))
        .collect::<Result<Vec<Position>, _>>()?;
    // For each layer that the map uses, its first node.
    let mut used = BTreeMap::new();
    for (node, &layer) in map.layers.iter().enumerate() {
        used.entry(layer).or_insert(node);
    }
    let numbers: Vec<usize> = used.keys().copied().collect();
    let listed = |layer| {
        numbers
            .binary_search(layer)
            .expect("every layer of the map is listed")
    };
    let layer_of_node = map.layers.iter().map(listed).collect();
    let oversampling = near_whole(options.pixel_scale_arcsec / kernels[0].pixel_arcsec);
    let grid = centred_grid(nx, ny, oversampling).map_err(invalid(path))?;
    let of_wavelengths: Vec<_> = kernels
        .iter()
        .map(|of| Ok(read_stack::<f64>(of.hdu, of.shape)?.select(Axis(0), &numbers)))
        .collect::<Result<_, IoError>>()?;
    let views: Vec<_> = of_wavelengths.iter().map(|stamps| stamps.view()).collect();
    let mut stamps = concatenate(Axis(0), &views).expect("equal shapes");
    stamps *= oversampling * oversampling;
    check_flux(path, &stamps, grid, |stamp| numbers[stamp % numbers.len()])?;
    let first_nodes: Vec<Position> = used.values().map(|&node| nodes[node]).collect();
    let wavelengths_um: Vec<f64> = kernels.iter().map(|of| of.wavelength_um).collect();
    let (shown, listed) = match &wavelengths_um[..] {
        [one] => (SamplePositions::new(first_nodes, None), one.to_string()),
        several => (
            SamplePositions::in_every_state(&first_nodes, None, StateKind::Wavelength, several),
            several.iter().map(f64::to_string).collect::<Vec<_>>().join(", "),
        ),
    };
    let layers = shown.and_then(|positions| PsfSamples::new(stamps, positions, grid));
    Ok(ScopesimPsf {
        layers: layers.map_err(invalid(path))?,
        nodes: SamplePositions::new(nodes, None).map_err(invalid(path))?,
        layer_of_node,
        wavelengths_um,
        notes: vec![
            format!("wavelength: the PSFs for {listed} micrometres were read"),
            "pixel response: assumed to be part of the PSFs, since ScopeSim itself adds none".to_owned(),
        ],
    })
}

/// The settings that place a [ScopeSim PSF](crate::scopesim) on a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScopesimOptions {
    pixel_scale_arcsec: f64,
    field_centre: Option<Position>,
    wavelength_um: Option<f64>,
}

impl ScopesimOptions {
    /// Sets the size of a frame pixel in arcseconds.
    ///
    /// # Errors
    /// [`DataError::Setting`] unless the scale is a finite number above 0.
    pub fn new(pixel_scale_arcsec: f64) -> Result<Self, DataError> {
        Ok(Self {
            pixel_scale_arcsec: positive("pixel scale in arcseconds", pixel_scale_arcsec)?,
            field_centre: None,
            wavelength_um: None,
        })
    }

    /// Sets the position of the centre of the field in 0-based pixels of the frame. A PSF that varies over
    /// the field needs it.
    #[must_use]
    pub fn with_field_centre(self, field_centre: Position) -> Self {
        Self {
            field_centre: Some(field_centre),
            ..self
        }
    }

    /// Chooses the PSFs whose wavelength is nearest to this one, in micrometres. Without a choice, the
    /// PSFs of all wavelengths are read.
    ///
    /// # Errors
    /// [`DataError::Setting`] unless the wavelength is a finite number above 0.
    pub fn with_wavelength_um(self, wavelength_um: f64) -> Result<Self, DataError> {
        Ok(Self {
            wavelength_um: Some(positive("wavelength in micrometres", wavelength_um)?),
            ..self
        })
    }

    /// Size of a frame pixel in arcseconds.
    pub fn pixel_scale_arcsec(&self) -> f64 {
        self.pixel_scale_arcsec
    }

    /// The position of the centre of the field on the frame.
    pub fn field_centre(&self) -> Option<Position> {
        self.field_centre
    }

    /// The requested wavelength, in micrometres.
    pub fn wavelength_um(&self) -> Option<f64> {
        self.wavelength_um
    }

    /// The position at an offset from the centre of the field.
    fn position(&self, x_arcsec: f64, y_arcsec: f64) -> Result<Position, DataError> {
        let centre = self.field_centre.unwrap_or(Position::of_pixel(0, 0));
        Position::new(
            centre.x() + x_arcsec / self.pixel_scale_arcsec,
            centre.y() + y_arcsec / self.pixel_scale_arcsec,
        )
    }
}

fn positive(name: &'static str, value: f64) -> Result<f64, DataError> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(DataError::setting(name, "a finite number above 0", value))
}

/// The largest relative difference between the two sides of a PSF pixel, enough for rounding in
/// single precision.
const SQUARE: f64 = 1e-6;

/// The PSFs of one wavelength: a cube of which only the header has been read.
#[derive(Debug)]
struct Kernels<'a> {
    hdu: &'a Hdu,
    shape: (usize, usize, usize),
    wavelength_um: f64,
    pixel_arcsec: f64,
}

impl<'a> Kernels<'a> {
    /// Chooses the cube of the requested wavelength among the images from HDU `first` on. Without a
    /// request, returns the cubes of all wavelengths, ascending.
    fn choose(
        structure: &'a FitsStructure,
        first: usize,
        map: Option<usize>,
        options: &ScopesimOptions,
    ) -> Result<Vec<Self>, IoError> {
        let mut cubes = Vec::new();
        for hdu in structure.hdus.iter().skip(first) {
            if hdu.kind == HduKind::Image && Some(hdu.index) != map && !hdu.axes.is_empty() {
                cubes.push((wavelength(&LibraryCards::new(hdu))?, hdu));
            }
        }
        if cubes.is_empty() {
            return Err(structure.missing(&format!("PSF image at HDU {first} (EDATA) or later")));
        }
        if let Some(wanted) = options.wavelength_um {
            let nearest = cubes
                .iter()
                .min_by(|(a, _), (b, _)| (a - wanted).abs().total_cmp(&(b - wanted).abs()));
            cubes = nearest.copied().into_iter().collect();
        }
        cubes.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let kernels: Vec<Self> = cubes
            .iter()
            .map(|&(wavelength_um, hdu)| {
                Ok(Self {
                    hdu,
                    shape: cube_shape(hdu)?,
                    wavelength_um,
                    pixel_arcsec: pixel_arcsec(&LibraryCards::new(hdu))?,
                })
            })
            .collect::<Result<_, IoError>>()?;
        let differs = |pair: &[Self]| {
            let size = pair[0].pixel_arcsec;
            pair[0].shape != pair[1].shape
                || (pair[1].pixel_arcsec - size).abs() > SQUARE * size
                || pair[0].wavelength_um == pair[1].wavelength_um
        };
        if kernels.windows(2).any(differs) {
            let wavelengths_um: Vec<f64> = kernels.iter().map(|of| of.wavelength_um).collect();
            let problem = format!(
                "there are PSFs for the wavelengths {wavelengths_um:?} micrometres, which differ in their number of layers or pixels, in \
                 the size of their pixels, or not in their wavelength: choose one"
            );
            let error = IoError::new(&structure.path, IoErrorKind::Setting, problem);
            return Err(error.with_setting("wavelength_um"));
        }
        Ok(kernels)
    }
}

fn wavelength(cards: &LibraryCards<'_>) -> Result<f64, IoError> {
    const EXPECTED: &str = "the wavelength of the PSFs in micrometres, a number above 0";
    const UNIT: &str = "um (wavelengths must be in micrometres)";
    if let Some(unit) = cards.text("WAVEUNIT", UNIT)?
        && !["um", "micron", "microns", "micrometer", ""].contains(&unit.to_ascii_lowercase().as_str())
    {
        return Err(cards.hdu.wrong_value("WAVEUNIT", UNIT, unit));
    }
    let wavelength = cards.required_number("WAVE0", EXPECTED)?;
    if wavelength > 0.0 {
        return Ok(wavelength);
    }
    Err(cards.hdu.wrong_value("WAVE0", EXPECTED, wavelength))
}

/// Size of a PSF pixel in arcseconds. The pixel must be square.
fn pixel_arcsec(cards: &LibraryCards<'_>) -> Result<f64, IoError> {
    const EXPECTED: &str = "the size of a PSF pixel, a number other than 0";
    let size = cards.required_number("CDELT1", EXPECTED)?.abs() * arcsec_in_unit(cards, "CUNIT1")?;
    if !(size > 0.0 && size.is_finite()) {
        return Err(cards.hdu.wrong_value("CDELT1", EXPECTED, size));
    }
    if let Some(other) = cards.number("CDELT2", EXPECTED)? {
        let unit = if cards.has("CUNIT2") { "CUNIT2" } else { "CUNIT1" };
        let other_size = other.abs() * arcsec_in_unit(cards, unit)?;
        if (other_size - size).abs() > SQUARE * size {
            return Err(cards.hdu.wrong_value(
                "CDELT2",
                "as large as CDELT1, because PSF pixels must be square",
                other,
            ));
        }
    }
    Ok(size)
}

/// Half a turn in arcseconds. Larger coordinates stand for negative ones.
const HALF_TURN_ARCSEC: f64 = 180.0 * 3600.0;

/// The layer that applies at each node.
#[derive(Debug)]
struct LayerMap {
    /// Offsets of the nodes from the centre of the field.
    offsets_arcsec: Vec<(f64, f64)>,
    layers: Vec<usize>,
}

impl LayerMap {
    /// Reads the map, an image or a table, of a PSF with `layer_count` layers.
    fn read(structure: &FitsStructure, hdu: &Hdu, layer_count: usize) -> Result<Self, IoError> {
        match hdu.kind {
            HduKind::BinaryTable => {
                let table = Table::new(hdu)?;
                let (x, y) = (table.read("x", 1)?, table.read("y", 1)?);
                let offsets_arcsec = x.into_iter().zip(y).collect();
                let values = table.read("layer", 1)?;
                Self::new(hdu, offsets_arcsec, &values, layer_count, |row| vec![row])
            }
            HduKind::Image if !hdu.axes.is_empty() => {
                let cards = &LibraryCards::new(hdu);
                let &[ny, nx] = squeezed(hdu).as_slice() else {
                    return Err(hdu.axes_error("a map of layers [y, x]"));
                };
                let (along_x, along_y) = (MapAxis::new(cards, 1)?, MapAxis::new(cards, 2)?);
                let values = read_stack::<f64>(hdu, (1, ny, nx))?.into_raw_vec_and_offset().0;
                let offset = |i: usize| (along_x.offset_arcsec(i % nx), along_y.offset_arcsec(i / nx));
                let offsets_arcsec = (0..values.len()).map(offset).collect();
                Self::new(hdu, offsets_arcsec, &values, layer_count, |i| {
                    vec![i / nx, i % nx]
                })
            }
            _ => Err(structure.missing(&format!(
                "map of layers: HDU {}, to which the keyword ECAT points, is neither an image with pixels nor a binary table",
                hdu.index
            ))),
        }
    }

    /// Makes a map of the layers numbered by `values`. `place` returns the row or the pixel of a
    /// value in the file.
    fn new(
        hdu: &Hdu,
        offsets_arcsec: Vec<(f64, f64)>,
        values: &[f64],
        layer_count: usize,
        place: impl Fn(usize) -> Vec<usize>,
    ) -> Result<Self, IoError> {
        let layer = |(i, &value): (usize, &f64)| {
            if value.fract() == 0.0 && value >= 0.0 && value < layer_count as f64 {
                return Ok(value as usize);
            }
            let problem = format!(
                "the map has layer {value} at {:?} (0-based: the row of a table, or [y, x] of an image), but only the layers 0 to {} exist",
                place(i),
                layer_count.saturating_sub(1)
            );
            Err(hdu.error(IoErrorKind::Data, problem))
        };
        let layers = values.iter().enumerate().map(layer).collect::<Result<_, _>>()?;
        Ok(Self {
            offsets_arcsec,
            layers,
        })
    }
}

/// Linear coordinates along an axis of the map.
struct MapAxis {
    reference_pixel: f64,
    reference_arcsec: f64,
    step_arcsec: f64,
}

impl MapAxis {
    fn new(cards: &LibraryCards<'_>, axis: usize) -> Result<Self, IoError> {
        const ROTATED: &str = "0 (rotated maps are not supported)";
        const PIXEL: &str = "the reference pixel of the map, a number";
        const STEP: &str = "the size of a pixel of the map, a number other than 0";
        const FACTOR: &str = "a number other than 0, by which CDELT is multiplied";
        const VALUE: &str = "the coordinate of the reference pixel, a number";
        let other = 3 - axis;
        let rotations = [
            format!("PC{axis}_{other}"),
            format!("CD{axis}_{other}"),
            format!("CROTA{axis}"),
        ];
        for keyword in rotations {
            if let Some(value) = cards.number(&keyword, ROTATED)?
                && value != 0.0
            {
                return Err(cards.hdu.wrong_value(&keyword, ROTATED, value));
            }
        }
        let unit = arcsec_in_unit(cards, &format!("CUNIT{axis}"))?;
        let matrix = format!("CD{axis}_{axis}");
        let (keyword, factor) = if cards.has(&matrix) {
            (matrix, 1.0)
        } else {
            let scale = cards.number(&format!("PC{axis}_{axis}"), FACTOR)?;
            (format!("CDELT{axis}"), scale.unwrap_or(1.0))
        };
        let step_arcsec = cards.required_number(&keyword, STEP)? * factor * unit;
        if step_arcsec == 0.0 || !step_arcsec.is_finite() {
            return Err(cards.hdu.wrong_value(&keyword, STEP, step_arcsec));
        }
        let value = cards.number(&format!("CRVAL{axis}"), VALUE)?.unwrap_or(0.0) * unit;
        Ok(Self {
            reference_pixel: cards.required_number(&format!("CRPIX{axis}"), PIXEL)?,
            reference_arcsec: if value > HALF_TURN_ARCSEC {
                value - 2.0 * HALF_TURN_ARCSEC
            } else {
                value
            },
            step_arcsec,
        })
    }

    /// The coordinate of a pixel, 0-based.
    fn offset_arcsec(&self, pixel: usize) -> f64 {
        self.reference_arcsec + (pixel as f64 + 1.0 - self.reference_pixel) * self.step_arcsec
    }
}

/// Returns how many arcseconds the unit named by a card has. Without the card the unit is a degree.
fn arcsec_in_unit(cards: &LibraryCards<'_>, keyword: &str) -> Result<f64, IoError> {
    const EXPECTED: &str = "an angular unit: deg, arcmin, arcsec, mas or rad";
    let text = cards.text(keyword, EXPECTED)?.filter(|unit| !unit.is_empty());
    text.map_or(Ok(3600.0), |text| match angle_in_deg(&text) {
        Some(degrees) => Ok(3600.0 * degrees),
        None => Err(cards.hdu.wrong_value(keyword, EXPECTED, text)),
    })
}
