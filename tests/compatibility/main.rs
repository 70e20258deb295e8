//! Every release must read the files of earlier releases. `v0.1.0` holds files that psfield 0.1.0
//! wrote and the images that it simulated from them (`psfield batch jobs.toml` in that folder). The
//! tests of the command line run the same list.

use std::path::{Path, PathBuf};

use integration_tests::relative_l2;
use psfield::detector::Detector;
use psfield::psf_io::{CatalogOptions, FileKind, read_catalog_with, read_image};
use psfield::psf_optics::Telescope;
use psfield::psf_types::{Interpolation, PsfSource};
use psfield::{FitOptions, Psf, Scene};

/// Rounding of positions and of sums over 1089 stamp pixels, in f64.
const ROUNDING: f64 = 1e-12;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("compatibility/v0.1.0")
        .join(name)
}

/// Relative L2 difference from the image of the release.
fn difference(psf: &Psf, expected: &str) -> f64 {
    let catalog = read_catalog_with(file("stars.csv"), &CatalogOptions::default()).unwrap();
    let (stars, galaxies) = catalog.into_parts();
    assert_eq!((stars.len(), galaxies.len()), (4, 0));
    let simulator = psf.simulator((80, 96)).tolerance(0.0).build::<f64>().unwrap();
    let image = simulator.simulate(&Scene::dark().with_stars(stars)).unwrap();
    let (expected, _) = read_image::<f64>(file(expected)).unwrap().into_parts();
    relative_l2(&image, &expected)
}

#[test]
fn a_model_of_0_1_0_gives_the_image_of_0_1_0() {
    let psf = Psf::open(file("model.fits")).unwrap();
    assert_eq!(psf.kind(), Some(FileKind::PsfModel));
    assert_eq!(psf.model().unwrap().rank(), 4);
    let difference = difference(&psf, "expected_stars.fits");
    assert!(difference < ROUNDING, "{difference:e}");
    // The comparison notices a missing component.
    let truncated = psf.record().unwrap().truncated(1).unwrap();
    assert!(self::difference(&truncated.into(), "expected_stars.fits") > 1e-3);
}

#[test]
fn samples_of_0_1_0_give_the_image_of_0_1_0() {
    let options = FitOptions {
        rank: psfield::psf_basis::RankSelection::Full,
        interpolation: Interpolation::Bilinear,
        ..FitOptions::default()
    };
    let psf = Psf::open(file("samples.fits")).unwrap().with_fit_options(options);
    let difference = difference(&psf, "expected_samples.fits");
    // This path has one more singular value decomposition.
    assert!(difference < 1e3 * ROUNDING, "{difference:e}");
}

#[test]
fn a_telescope_and_a_detector_of_0_1_0_are_read() {
    let telescope = Telescope::from_toml_file(file("telescope.toml")).unwrap();
    let field = telescope.field();
    assert_eq!((field.nx(), field.ny()), (96, 80));
    let detector = Detector::from_toml_file(file("detector.toml")).unwrap();
    assert_eq!(detector.params().read_noise_e, 3.0);
}
