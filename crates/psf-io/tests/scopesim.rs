//! Reading ScopeSim's field-varying PSFs.

mod support;

use psf_io::{FileKind, IoError, ScopesimOptions, ScopesimPsf, detect, read_scopesim};
use psf_types::Position;
use support::libraries::{SIZE, scopesim, scopesim_kernels, scopesim_map, scopesim_primary, stamp};
use support::mutations::{
    assert_refused, cut, huge_sizes, not_finite, replaced, with_value, without, wrong_types,
};
use support::{SIMPLE, Scratch, chain, f64s, image, table};

/// The largest error of a node in frame pixels of 0.25 arcseconds, due to coordinates in degrees.
const ROUNDING: f64 = 1e-9;

fn options() -> ScopesimOptions {
    ScopesimOptions::new(0.25)
        .unwrap()
        .with_field_centre(Position::new(100.0, 200.0).unwrap())
}

fn read(bytes: &[u8], options: &ScopesimOptions) -> Result<ScopesimPsf, IoError> {
    read_scopesim(Scratch::new().put("a.fits", bytes), options)
}

/// A map with three rows: x and y in arcseconds, and the layer.
fn table_map(layers: [f64; 3]) -> Vec<u8> {
    let rows: Vec<f64> = [(-10.0, 5.0), (0.0, 0.0), (7.5, -2.0)]
        .iter()
        .zip(layers)
        .flat_map(|(&(x, y), layer)| [x, y, layer])
        .collect();
    table(
        "MAP",
        &[("x", "D"), ("y", "D"), ("layer", "D")],
        3,
        &[],
        &f64s(&rows),
    )
}

#[test]
fn a_map_image_becomes_nodes_that_name_their_layer() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &scopesim());
    assert_eq!(detect(&path).unwrap(), FileKind::Scopesim);
    let psf = read_scopesim(&path, &options().with_wavelength_um(2.0).unwrap()).unwrap();
    assert_eq!(psf.wavelengths_um(), [2.25]);
    // Map pixels of 4 frame pixels around (100, 200). CRVAL2 = 360 degrees means 0.
    let expected = [
        (96.0, 198.0),
        (100.0, 198.0),
        (104.0, 198.0),
        (96.0, 202.0),
        (100.0, 202.0),
        (104.0, 202.0),
    ];
    for (node, (x, y)) in psf.nodes().as_slice().iter().zip(expected) {
        let apart = node.distance(Position::new(x, y).unwrap());
        assert!(apart < ROUNDING, "{node} is not ({x}, {y})");
    }
    // Layer 1 is not in the map.
    assert_eq!(psf.layer_of_node(), [1, 0, 0, 0, 1, 1]);
    let layers = psf.layers();
    assert_eq!(
        (layers.len(), layers.positions().as_slice()[1]),
        (2, psf.nodes().as_slice()[0])
    );
    let grid = layers.grid();
    // PSF pixels have 0.5 arcseconds, frame pixels 0.25.
    assert_eq!(
        (grid.oversampling(), grid.centre_x(), grid.centre_y()),
        (0.5, 2.0, 2.0)
    );
    assert!(grid.pixel_response_included());
    for (sample, layer) in [(0, 0), (1, 2)] {
        let sum: f64 = stamp(layer).iter().sum();
        assert!((layers.flux(sample) - sum).abs() < 1e-12 * sum);
        assert_eq!(
            layers.stamps()[[sample, SIZE / 2, SIZE / 2]],
            0.25 * (layer + 1) as f64
        );
    }
    let notes = psf.notes().join("; ");
    assert!(
        notes.contains("2.25 micrometres") && notes.contains("pixel response"),
        "{notes}"
    );
}

#[test]
fn a_map_table_is_in_arcseconds() {
    let file = [
        scopesim_primary(),
        table_map([1.0, 0.0, 1.0]),
        scopesim_kernels(2, 1.5),
    ]
    .concat();
    let psf = read(&file, &options()).unwrap();
    let nodes: Vec<(f64, f64)> = psf.nodes().as_slice().iter().map(|p| (p.x(), p.y())).collect();
    assert_eq!(nodes, [(60.0, 220.0), (100.0, 200.0), (130.0, 192.0)]);
    assert_eq!(psf.layer_of_node(), [1, 0, 1]);
}

#[test]
fn angles_are_degrees_unless_the_file_says_otherwise() {
    let good = scopesim();
    let oversampling = |bytes: &[u8]| {
        let psf = read(bytes, &options().with_wavelength_um(1.5).unwrap()).unwrap();
        psf.layers().grid().oversampling()
    };
    let unit = |unit: &str| {
        let bytes = with_value(&good, "CDELT1", "0.001").bytes;
        // The first CDELT1 and CUNIT1 belong to the map, which may have any units.
        with_value(&bytes, "CUNIT1", unit).bytes
    };
    for name in ["'deg'", "'arcmin'", "'ARCSEC'", "'mas'", "'rad'"] {
        assert_eq!(oversampling(&unit(name)), 0.5, "{name}");
    }
    let kernels = scopesim_kernels(3, 1.5);
    let kernels = replaced(&kernels, "CUNIT1", "COMMENT").bytes;
    let kernels = replaced(&kernels, "CUNIT2", "COMMENT").bytes;
    let kernels = with_value(&kernels, "CDELT1", "-1.0E-5").bytes;
    let kernels = with_value(&kernels, "CDELT2", "1.0E-5").bytes;
    let file = [scopesim_primary(), scopesim_map([0.0; 6]), kernels.clone()].concat();
    assert!((oversampling(&file) - 0.25 / 0.036).abs() < 1e-12);
    // The PSF pixel is a twelfth of a frame pixel, to the precision of the header.
    let kernels = with_value(&kernels, "CDELT1", "5.7870370E-6").bytes;
    let kernels = with_value(&kernels, "CDELT2", "5.7870370E-6").bytes;
    let file = [scopesim_primary(), scopesim_map([0.0; 6]), kernels].concat();
    assert_eq!(oversampling(&file), 12.0);
}

#[test]
fn several_wavelengths_are_states_if_their_pixels_agree() {
    let one = [
        scopesim_primary(),
        scopesim_map([0.0; 6]),
        scopesim_kernels(1, 0.8),
    ]
    .concat();
    assert_eq!(read(&one, &options()).unwrap().wavelengths_um(), [0.8]);
    let all = read(&scopesim(), &options()).unwrap();
    assert_eq!(all.wavelengths_um(), [1.5, 2.25]);
    assert_eq!(all.layers().positions().state_count(), 2);
    for (state, wavelength) in [1.5, 2.25].into_iter().enumerate() {
        let one = read(&scopesim(), &options().with_wavelength_um(wavelength).unwrap()).unwrap();
        assert_eq!(one.layer_of_node(), all.layer_of_node());
        for layer in 0..2 {
            assert_eq!(one.layers().stamp(layer), all.layers().stamp(2 * state + layer));
        }
    }
    let wide = with_value(&scopesim_kernels(2, 3.0), "CDELT1", "2.0E-4").bytes;
    let wide = with_value(&wide, "CDELT2", "2.0E-4").bytes;
    let error = read(&[scopesim(), wide].concat(), &options()).unwrap_err();
    assert_eq!(error.setting(), Some("wavelength_um"));
    let error = chain(&error);
    assert!(
        error.contains("[1.5, 2.25, 3.0]") && error.contains("choose one"),
        "{error}"
    );
}

#[test]
fn options_are_checked() {
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(ScopesimOptions::new(bad).is_err());
        assert!(
            ScopesimOptions::new(1.0)
                .unwrap()
                .with_wavelength_um(bad)
                .is_err()
        );
    }
    let error = read(&scopesim(), &ScopesimOptions::new(1.0).unwrap()).unwrap_err();
    assert_eq!(error.setting(), Some("field_centre"));
}

/// ScopeSim reads the map that ECAT names, whatever ETYPE says.
#[test]
fn a_map_needs_no_type() {
    let scratch = Scratch::new();
    let plain = replaced(&scopesim(), "ETYPE", "COMMENT").bytes;
    let path = scratch.put("plain.fits", &plain);
    assert_eq!(detect(&path).unwrap(), FileKind::Scopesim);
    let (found, known) = (read(&plain, &options()), read(&scopesim(), &options()));
    assert_eq!(found.unwrap(), known.unwrap());
}

#[test]
fn a_constant_psf_may_have_several_wavelengths() {
    let scratch = Scratch::new();
    let primary = |map: &str| image(SIMPLE, 8, &[], &["ETYPE   = 'CONSTPSF'", map, "EDATA   = 1"], &[]);
    let several = [
        primary("ECAT    = -1"),
        scopesim_kernels(1, 1.5),
        scopesim_kernels(1, 2.25),
    ]
    .concat();
    let path = scratch.put("several.fits", &several);
    assert_eq!(detect(&path).unwrap(), FileKind::Scopesim);
    let psf = read_scopesim(&path, &ScopesimOptions::new(0.25).unwrap()).unwrap();
    assert_eq!((psf.wavelengths_um(), psf.layers().len()), (&[1.5, 2.25][..], 2));
    assert_eq!((psf.nodes().len(), psf.layer_of_node()), (1, &[0][..]));
    // One wavelength is an image like any other.
    let one = [primary("ECAT    = -1"), scopesim_kernels(1, 1.5)].concat();
    assert_ne!(detect(scratch.put("one.fits", &one)).unwrap(), FileKind::Scopesim);
    let layers = [
        primary("ECAT    = -1"),
        scopesim_kernels(2, 1.5),
        scopesim_kernels(2, 2.0),
    ]
    .concat();
    let error = chain(&read(&layers, &options()).unwrap_err());
    assert!(error.contains("no map of layers"), "{error}");
}

#[test]
fn errors_name_what_is_wrong() {
    let good = scopesim();
    let with_map = |layers| [scopesim_primary(), scopesim_map(layers), scopesim_kernels(2, 1.5)].concat();
    let with_table = |layers| [scopesim_primary(), table_map(layers), scopesim_kernels(2, 1.5)].concat();
    let cases = [
        (with_value(&good, "EDATA", "'two'").bytes, "EDATA"),
        (with_value(&good, "ECAT", "9").bytes, "ECAT"),
        (with_value(&good, "ECAT", "0").bytes, "HDU 0, to which"),
        (with_value(&good, "EDATA", "7").bytes, "HDU 7 (EDATA)"),
        (with_value(&good, "WAVEUNIT", "'nm'").bytes, "WAVEUNIT"),
        (with_value(&good, "WAVE0", "0.0").bytes, "WAVE0"),
        (with_value(&good, "CDELT1", "0").bytes, "CDELT1"),
        (with_value(&good, "CUNIT1", "'parsec'").bytes, "CUNIT1"),
        (replaced(&good, "CRVAL1", "CD1_2   = 0.1").bytes, "CD1_2"),
        (replaced(&good, "CRPIX2", "COMMENT").bytes, "CRPIX2"),
        (with_map([0.0, 1.0, 2.0, 0.0, 0.0, 0.0]), "layer 2 at [0, 2]"),
        (with_map([0.0, 1.0, 1.0, 0.5, 0.0, 0.0]), "layer 0.5 at [1, 0]"),
        (with_table([0.0, -1.0, 0.0]), "layer -1 at [1]"),
    ];
    for (bytes, expected) in cases {
        let error = chain(&read(&bytes, &options().with_wavelength_um(1.5).unwrap()).unwrap_err());
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn damaged_files_are_refused_soon() {
    let options = options().with_wavelength_um(1.5).unwrap();
    let good = scopesim();
    let numbers = ["ECAT", "EDATA", "CRPIX1", "CDELT1", "CDELT2", "WAVE0"];
    let mut all = cut(&good);
    // After some of the cuts each remaining HDU is complete, but the PSFs are missing.
    all.extend(without(
        &good,
        &["ECAT", "EDATA", "CRPIX1", "CDELT2", "WAVE0", "XTENSION"],
    ));
    all.extend(wrong_types(&good, &numbers, &["CUNIT1", "WAVEUNIT"]));
    all.extend(huge_sizes(&good));
    // The PSFs of the other wavelength are not read.
    all.extend(
        not_finite(&good)
            .into_iter()
            .filter(|m| !m.name.contains("HDU 3")),
    );
    all.extend(["ECAT", "EDATA"].map(|card| with_value(&good, card, "9007199254740992")));
    assert!(all.len() > 100, "{}", all.len());
    assert_refused(all, |path| read_scopesim(path, &options));

    let tabled = [
        scopesim_primary(),
        table_map([1.0, 0.0, 1.0]),
        scopesim_kernels(2, 1.5),
    ]
    .concat();
    let mut all = cut(&tabled);
    all.extend(without(&tabled, &["TTYPE1", "TTYPE3", "TFORM2", "TFIELDS"]));
    all.extend(wrong_types(&tabled, &["TFIELDS"], &["TTYPE3", "TFORM3"]));
    all.extend(huge_sizes(&tabled));
    assert_refused(all, |path| read_scopesim(path, &options));
}
