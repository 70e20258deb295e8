//! Catalogues.

use psf_io::{
    CatalogOptions, HduChoice, HeaderCards, SkyCoordinates, read_catalog_with, read_columns, read_positions,
};

use super::case::Case;

/// A frame of half a degree around (10, 20) degrees.
fn frame() -> SkyCoordinates {
    let numbers = [
        ("CRPIX1", 500.5),
        ("CRPIX2", 500.5),
        ("CRVAL1", 10.0),
        ("CRVAL2", 20.0),
        ("CDELT1", -5e-4),
        ("CDELT2", 5e-4),
    ];
    let texts = [("CTYPE1", "RA---TAN"), ("CTYPE2", "DEC--TAN")];
    let numbers = numbers.map(|(keyword, value)| psf_io::Card::new(keyword, value, "").expect("valid cards"));
    let texts = texts.map(|(keyword, value)| psf_io::Card::new(keyword, value, "").expect("valid cards"));
    let header: HeaderCards = numbers.into_iter().chain(texts).collect();
    SkyCoordinates::from_header(&header).expect("a tangential projection")
}

/// Catalogues in text and FITS, with many options.
pub fn catalog(data: &[u8]) -> usize {
    let mut case = Case::new("catalog", data);
    let columns = |text: &str| text.parse().expect("roles and columns");
    for options in [
        CatalogOptions::new(),
        CatalogOptions::new().with_invalid_skipped(true),
        CatalogOptions::new()
            .with_columns(columns("x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO"))
            .with_one_based(true),
        CatalogOptions::new()
            .with_columns(columns("ra=ra,dec=dec,mag=mag"))
            .with_zero_point(25.0)
            .expect("a finite zero point")
            .with_sky(frame())
            .with_invalid_skipped(true),
        CatalogOptions::new().with_table(HduChoice::Number(1)),
    ] {
        let Some(catalog) = case.read(|path| read_catalog_with(path, &options)) else {
            continue;
        };
        for star in catalog.stars() {
            assert!(star.flux().is_finite(), "{star:?}");
        }
    }
    case.read(|path| read_positions(path));
    case.read(|path| read_columns(path, ["flux", "x"]));
    case.reads()
}
