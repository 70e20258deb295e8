//! Every release must read the files of earlier releases. `v0.1.0` and `v0.2.0` hold files that these
//! versions of psfield wrote, and the images that they simulated from them (`psfield batch jobs.toml` in
//! the folder, whose comment tells how the files were made). The tests of the command line run the same
//! lists.

use std::path::{Path, PathBuf};

use integration_tests::relative_l2;
use psfield::detector::Detector;
use psfield::psf_io::{CatalogOptions, FileKind, read_catalog_with, read_image};
use psfield::psf_optics::Telescope;
use psfield::psf_types::{Image, Interpolation, PsfSource};
use psfield::{FitOptions, Psf, Scene};

/// psfield 0.1.0 lost light at the edges of stamps. The images differ by this near the stars: the
/// influence of the edges of the stamps, which are 13 pixels away.
const EDGES: f64 = 1e-7;
/// From a star, the compared pixels are at most this far away.
const NEAR: f64 = 3.5;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("compatibility")
        .join(name)
}

/// Relative L2 difference from the image of the release, at the pixels near stars.
fn difference(psf: &Psf, expected: &str) -> f64 {
    let catalog = read_catalog_with(file("v0.1.0/stars.csv"), &CatalogOptions::default()).unwrap();
    let (stars, galaxies) = catalog.into_parts();
    assert_eq!((stars.len(), galaxies.len()), (4, 0));
    let near = |y: usize, x: usize| {
        let far = |at: f64, pixel: usize| (at - pixel as f64).abs() > NEAR;
        let mut positions = stars.iter().map(|star| star.position());
        positions.any(|at| !far(at.x(), x) && !far(at.y(), y))
    };
    let simulator = psf.simulator((80, 96)).tolerance(0.0).build::<f64>().unwrap();
    let image = simulator
        .simulate(&Scene::dark().with_stars(stars.clone()))
        .unwrap();
    let (expected, _) = read_image::<f64>(file(expected)).unwrap().into_parts();
    let cut = |image: &Image<f64>| {
        let mut pixels = image.pixels().to_owned();
        pixels.indexed_iter_mut().for_each(|((y, x), v)| {
            if !near(y, x) {
                *v = 0.0;
            }
        });
        Image::new(pixels).unwrap()
    };
    relative_l2(&cut(&image), &cut(&expected))
}

#[test]
fn a_model_of_0_1_0_gives_the_image_of_0_1_0() {
    let psf = Psf::open(file("v0.1.0/model.fits")).unwrap();
    assert_eq!(psf.kind(), Some(FileKind::PsfModel));
    assert_eq!(psf.model().unwrap().rank(), 4);
    let difference = difference(&psf, "v0.1.0/expected_stars.fits");
    assert!(difference < EDGES, "{difference:e}");
    // The comparison notices a missing component.
    let truncated = psf.record().unwrap().truncated(1).unwrap();
    assert!(self::difference(&truncated.into(), "v0.1.0/expected_stars.fits") > 1e-3);
}

#[test]
fn samples_of_0_1_0_give_the_image_of_0_1_0() {
    let options = FitOptions {
        rank: psfield::psf_basis::RankSelection::Full,
        interpolation: Interpolation::Bilinear,
        ..FitOptions::default()
    };
    let psf = Psf::open(file("v0.1.0/samples.fits"))
        .unwrap()
        .with_fit_options(options);
    let difference = difference(&psf, "v0.1.0/expected_samples.fits");
    assert!(difference < EDGES, "{difference:e}");
}

#[test]
fn a_telescope_and_a_detector_of_0_1_0_are_read() {
    let telescope = Telescope::from_toml_file(file("v0.1.0/telescope.toml")).unwrap();
    let field = telescope.field();
    assert_eq!((field.nx(), field.ny()), (96, 80));
    let detector = Detector::from_toml_file(file("v0.1.0/detector.toml")).unwrap();
    assert_eq!(detector.params().read_noise_e, 3.0);
}

/// The image of the stars of 0.2.0 through a PSF, relative to the expected one (L2).
fn difference_of_0_2_0(psf: &Psf, expected: &str) -> f64 {
    let catalog = read_catalog_with(file("v0.2.0/stars.csv"), &CatalogOptions::default()).unwrap();
    let (stars, _) = catalog.into_parts();
    assert_eq!(stars.len(), 4);
    let simulator = psf.simulator((48, 64)).tolerance(0.0).build::<f64>().unwrap();
    let image = simulator.simulate(&Scene::dark().with_stars(stars)).unwrap();
    let (expected, _) = read_image::<f64>(file(expected)).unwrap().into_parts();
    relative_l2(&image, &expected)
}

/// Rounding of f64, which differs between instruction sets.
const ROUNDING: f64 = 1e-12;

#[test]
fn a_model_with_wavelengths_of_0_2_0_gives_the_image_of_0_2_0() {
    let psf = Psf::open(file("v0.2.0/model.fits")).unwrap();
    assert_eq!(psf.states().unwrap().values(), [0.55, 0.65, 0.75]);
    let record = psf.record().unwrap();
    assert!(matches!(record.interpolation(), Interpolation::Kriging(Some(_))));
    let expected = "v0.2.0/expected_model.fits";
    let difference = difference_of_0_2_0(&psf.at_state(0.6).unwrap(), expected);
    assert!(difference < ROUNDING, "{difference:e}");
    // The comparison notices another wavelength.
    assert!(difference_of_0_2_0(&psf.at_state(0.61).unwrap(), expected) > 1e-3);
}

#[test]
fn a_table_of_0_2_0_gives_the_image_of_0_2_0() {
    let psf = Psf::open(file("v0.2.0/table.fits")).unwrap();
    let record = psf.record().unwrap();
    assert!(matches!(record.interpolation(), Interpolation::Table { .. }));
    assert_eq!(record.table_of(), Some("a wave"));
    let difference = difference_of_0_2_0(&psf, "v0.2.0/expected_table.fits");
    assert!(difference < ROUNDING, "{difference:e}");
}
