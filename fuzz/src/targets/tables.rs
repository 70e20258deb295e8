//! Catalogues, bandpasses and spectra.

use psf_io::{
    CatalogOptions, HduChoice, HeaderCards, SkyCoordinates, read_catalog_with, read_columns, read_curve,
    read_positions,
};
use spectra::{Bandpass, Curve, FluxDensity, Spectrum, photons};

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
        CatalogOptions::new()
            .with_colours(true)
            .with_velocities(true)
            .with_flux_unit("Jy")
            .with_invalid_skipped(true),
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

/// Bandpasses and spectra: tables of wavelengths and values, and the photons that they give.
pub fn curve(data: &[u8]) -> usize {
    let mut case = Case::new("curve", data);
    for (unit, only) in [
        (None, true),
        (None, false),
        (Some("nm"), true),
        (Some("Angstrom"), false),
    ] {
        let Some((wavelengths_um, values)) = case.read(|path| read_curve(path, unit, only)) else {
            continue;
        };
        let Ok(curve) = Curve::new(wavelengths_um, values) else {
            continue;
        };
        let bandpass = Bandpass::new(curve.clone());
        for spectrum in [
            Spectrum::table(curve, FluxDensity::default()),
            Spectrum::black_body(5000.0).expect("a temperature above 0"),
        ] {
            let Ok(all) = photons(&bandpass, &spectrum, &[0.5, 0.6]) else {
                continue;
            };
            let sum: f64 = all.iter().map(|part| part.weight).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{sum}");
        }
    }
    let mut names = 0;
    if let Ok(text) = std::str::from_utf8(data) {
        for name in text.lines() {
            if let Ok((_, redshift)) = Spectrum::split_redshift(name) {
                let body = Spectrum::black_body(5000.0).expect("a temperature above 0");
                if let Ok(body) = body.with_redshift(redshift) {
                    assert!(body.photon_density(0.5) >= 0.0, "{name:?}");
                }
            }
            if let Ok(spectrum) = name.parse::<Spectrum>() {
                names += 1;
                assert!(spectrum.photon_density(0.5) >= 0.0, "{name:?}");
            }
        }
    }
    case.reads() + names
}
