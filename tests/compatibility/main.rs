//! Every release must read the files of earlier releases. `v0.1.0` holds files that psfield 0.1.0
//! wrote and the images that it simulated from them (`psfield batch jobs.toml` in that folder). The
//! tests of the command line run the same list.

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
        .join("compatibility/v0.1.0")
        .join(name)
}

/// Relative L2 difference from the image of the release, at the pixels near stars.
fn difference(psf: &Psf, expected: &str) -> f64 {
    let catalog = read_catalog_with(file("stars.csv"), &CatalogOptions::default()).unwrap();
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
    let psf = Psf::open(file("model.fits")).unwrap();
    assert_eq!(psf.kind(), Some(FileKind::PsfModel));
    assert_eq!(psf.model().unwrap().rank(), 4);
    let difference = difference(&psf, "expected_stars.fits");
    assert!(difference < EDGES, "{difference:e}");
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
    assert!(difference < EDGES, "{difference:e}");
}

#[test]
fn a_telescope_and_a_detector_of_0_1_0_are_read() {
    let telescope = Telescope::from_toml_file(file("telescope.toml")).unwrap();
    let field = telescope.field();
    assert_eq!((field.nx(), field.ny()), (96, 80));
    let detector = Detector::from_toml_file(file("detector.toml")).unwrap();
    assert_eq!(detector.params().read_noise_e, 3.0);
}
