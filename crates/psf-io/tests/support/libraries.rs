//! Small PSF libraries with distinguishable planes.

use super::{IMAGE, SIMPLE, f32s, f64s, image};

/// Pixels along a side of the stamps.
pub(crate) const SIZE: usize = 5;

/// A stamp with `plane + 1` in its middle and half of this elsewhere.
pub(crate) fn stamp(plane: usize) -> Vec<f64> {
    let mut values = vec![(plane + 1) as f64 / 2.0; SIZE * SIZE];
    values[SIZE * SIZE / 2] *= 2.0;
    values
}

fn cube(planes: usize) -> Vec<f64> {
    (0..planes).flat_map(stamp).collect()
}

/// An STPSF library of 2 x 3 PSFs (columns x rows). Its cards have x as the slow coordinate, as in
/// WebbPSF: `(y, x)` of 0, 10, 20 and 0, 100.
pub(crate) fn stpsf(more: &[&str]) -> Vec<u8> {
    let positions = (0..6).map(|i| {
        let text = format!("({}.0, {}.0)", i % 3 * 10, i / 3 * 100);
        format!("{:<8}= '{text}'", format!("DET_YX{i}"))
    });
    let mut cards = vec![
        "OVERSAMP= 2".to_owned(),
        "DET_SAMP= 2".to_owned(),
        "NUM_PSFS= 6".to_owned(),
        "DETECTOR= 'NRCA1'".to_owned(),
        "VERSION = '1.2.1'".to_owned(),
        "DATE    = '2023-11-10T01:27:18'".to_owned(),
    ];
    cards.extend(positions);
    cards.extend(more.iter().map(ToString::to_string));
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    image(SIMPLE, -64, &[SIZE, SIZE, 6], &cards, &f64s(&cube(6)))
}

/// An STDPSF library of this grid: x = 1, 101, 201 ..., y = 1, 51, 101 ... Each position has a
/// card, and a card with 9999 follows.
pub(crate) fn stdpsf(columns: usize, rows: usize) -> Vec<u8> {
    let mut cards = vec![format!("NXPSFs  = {columns}"), format!("NYPSFs  = {rows}")];
    for (stem, count, step) in [("IPSFX", columns, 100), ("JPSFY", rows, 50)] {
        cards.extend((0..count).map(|i| format!("{stem}{:02} = {}", i + 1, i * step + 1)));
        cards.push(format!("{stem}{:02} = 9999", count + 1));
    }
    stdpsf_of(columns * rows, &cards)
}

/// An STDPSF library with these cards.
pub(crate) fn stdpsf_of(planes: usize, cards: &[String]) -> Vec<u8> {
    let values: Vec<f32> = cube(planes).iter().map(|&v| v as f32).collect();
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    image(SIMPLE, -32, &[SIZE, SIZE, planes], &cards, &f32s(&values))
}

/// The primary HDU of a ScopeSim PSF.
pub(crate) fn scopesim_primary() -> Vec<u8> {
    image(
        SIMPLE,
        8,
        &[],
        &["ETYPE   = 'FVPSF'", "ECAT    = 1", "EDATA   = 2"],
        &[],
    )
}

/// PSFs of several layers for a wavelength in micrometres, with 0.5 arcseconds per pixel.
pub(crate) fn scopesim_kernels(layers: usize, wavelength_um: f64) -> Vec<u8> {
    let wavelength = format!("WAVE0   = {wavelength_um:?}");
    let cards = [
        wavelength.as_str(),
        "WAVEUNIT= 'um'",
        "CDELT1  = 0.5",
        "CDELT2  = 0.5",
        "CUNIT1  = 'arcsec'",
        "CUNIT2  = 'arcsec'",
    ];
    image(IMAGE, -64, &[SIZE, SIZE, layers], &cards, &f64s(&cube(layers)))
}

/// A map of 3 x 2 pixels of one arcsecond around the centre of the field.
pub(crate) fn scopesim_map(layers: [f64; 6]) -> Vec<u8> {
    let cards = [
        "CRPIX1  = 2.0",
        "CRPIX2  = 1.5",
        "CDELT1  = 0.000277777777777778",
        "CDELT2  = 0.000277777777777778",
        "CRVAL1  = 0.0",
        "CRVAL2  = 360.0",
        "CUNIT1  = 'deg'",
        "CUNIT2  = 'deg'",
    ];
    image(IMAGE, -64, &[3, 2], &cards, &f64s(&layers))
}

/// A ScopeSim PSF with an image as map, two of three layers in use, and two wavelengths.
pub(crate) fn scopesim() -> Vec<u8> {
    [
        scopesim_primary(),
        scopesim_map([2.0, 0.0, 0.0, 0.0, 2.0, 2.0]),
        scopesim_kernels(3, 1.5),
        scopesim_kernels(3, 2.25),
    ]
    .concat()
}
