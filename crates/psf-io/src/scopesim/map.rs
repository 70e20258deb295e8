//! The map of layers.

use super::units::arcsec_in_unit;
use crate::columns::Table;
use crate::error::unsuitable;
use crate::hdu::{Hdu, HduKind};
use crate::image::squeezed;
use crate::library_cards::LibraryCards;
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{GriddedError, IoError};

/// Half a turn in arcseconds: coordinates beyond it are negative ones.
const HALF_TURN_ARCSEC: f64 = 180.0 * 3600.0;

/// Where which layer applies.
#[derive(Debug)]
pub(super) struct LayerMap {
    /// Offsets of the nodes from the centre of the field.
    pub(super) offsets_arcsec: Vec<(f64, f64)>,
    /// The layer at each.
    pub(super) layers: Vec<usize>,
}

/// Reads the map, an image or a table, of a PSF with so many layers.
pub(super) fn read(structure: &FitsStructure, hdu: &Hdu, layer_count: usize) -> Result<LayerMap, IoError> {
    match hdu.kind {
        HduKind::BinaryTable => of_table(structure, hdu, layer_count),
        HduKind::Image if !hdu.axes.is_empty() => of_image(structure, hdu, layer_count),
        _ => Err(structure.missing(&format!(
            "map of layers: HDU {} (ECAT) is neither an image with pixels nor a binary table",
            hdu.index
        ))),
    }
}

fn of_table(structure: &FitsStructure, hdu: &Hdu, layer_count: usize) -> Result<LayerMap, IoError> {
    let table = Table::new(structure, hdu)?;
    let (x, y, layers) = (table.read("x", 1)?, table.read("y", 1)?, table.read("layer", 1)?);
    let layers = layers
        .into_iter()
        .enumerate()
        .map(|(row, value)| layer(structure, hdu, || vec![row], value, layer_count))
        .collect::<Result<_, _>>()?;
    Ok(LayerMap {
        offsets_arcsec: x.into_iter().zip(y).collect(),
        layers,
    })
}

fn of_image(structure: &FitsStructure, hdu: &Hdu, layer_count: usize) -> Result<LayerMap, IoError> {
    let cards = &LibraryCards::new(&structure.path, hdu);
    let &[_, nx] = squeezed(hdu).as_slice() else {
        return Err(hdu.axes_error("a map of layers [y, x]"));
    };
    let (along_x, along_y) = (Axis::new(cards, 1)?, Axis::new(cards, 2)?);
    let values: Vec<f64> = read_pixels(&structure.path, hdu)?;
    let layers = values
        .iter()
        .enumerate()
        .map(|(i, &value)| layer(structure, hdu, || vec![i / nx, i % nx], value, layer_count))
        .collect::<Result<_, _>>()?;
    let offset = |i: usize| (along_x.offset_arcsec(i % nx), along_y.offset_arcsec(i / nx));
    Ok(LayerMap {
        offsets_arcsec: (0..values.len()).map(offset).collect(),
        layers,
    })
}

/// The layer that a value of the map names.
fn layer(
    structure: &FitsStructure,
    hdu: &Hdu,
    index: impl Fn() -> Vec<usize>,
    value: f64,
    layer_count: usize,
) -> Result<usize, IoError> {
    if value.fract() == 0.0 && value >= 0.0 && value < layer_count as f64 {
        return Ok(value as usize);
    }
    Err(unsuitable(&structure.path)(GriddedError::Layer {
        hdu: hdu.index,
        index: index(),
        got: value,
        last: layer_count.saturating_sub(1),
    }))
}

/// Linear coordinates along an axis.
struct Axis {
    reference_pixel: f64,
    reference_arcsec: f64,
    step_arcsec: f64,
}

impl Axis {
    fn new(cards: &LibraryCards<'_>, axis: usize) -> Result<Self, IoError> {
        const ROTATED: &str = "0: a rotated map is not understood";
        const PIXEL: &str = "the reference pixel of the map, a number";
        const STEP: &str = "the size of a pixel of the map, a number other than 0";
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
                return Err(cards.bad_value(&keyword, ROTATED, value.to_string()));
            }
        }
        let unit = arcsec_in_unit(cards, &format!("CUNIT{axis}"))?;
        let matrix = format!("CD{axis}_{axis}");
        let (keyword, factor) = if cards.has(&matrix) {
            (matrix, 1.0)
        } else {
            let scale = cards.number(&format!("PC{axis}_{axis}"), STEP)?;
            (format!("CDELT{axis}"), scale.unwrap_or(1.0))
        };
        let step_arcsec = cards.required_number(&keyword, STEP)? * factor * unit;
        if step_arcsec == 0.0 || !step_arcsec.is_finite() {
            return Err(cards.bad_value(&keyword, STEP, step_arcsec.to_string()));
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
