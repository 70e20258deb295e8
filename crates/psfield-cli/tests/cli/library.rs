//! The library gives the files of the command line, byte for byte.

use ndarray::Array2;
use psfield::conv_core::ConvReal;
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate, evaluate_stamps};
use psfield::image_cards::{PSF_FILE_KEYWORD, provenance_cards};
use psfield::psf_basis::RankSelection;
use psfield::psf_io::{self, Card, CatalogOptions, HeaderCards};
use psfield::psf_types::{Anchor, FrameShape, NoProgress, PixelRegion, PointSource, Position, PsfSamples};
use psfield::{Device, ErrorKind, FitOptions, Method, Psf, PsfieldError, Scene, SimulateOptions};

use crate::desk::{Desk, NX, NY, STAMP, samples};

/// The options of `simulate`.
struct Asked {
    scene: bool,
    catalog: bool,
    frame: Option<PixelRegion>,
    oversample: usize,
    stamp_size: Option<usize>,
    anchor: Anchor,
    method: Method,
    spot_check: usize,
}

const PLAIN: Asked = Asked {
    scene: true,
    catalog: false,
    frame: None,
    oversample: 1,
    stamp_size: None,
    anchor: Anchor::Source,
    method: Method::Auto,
    spot_check: 0,
};

/// A tolerance at which the plan has a choice.
const TOLERANCE: f64 = 1e-3;
const SEED: u64 = 7;

impl Asked {
    fn arguments<T: ConvReal>(&self, output: &str) -> String {
        let mut words = vec!["simulate".to_owned()];
        let mut add = |text: String| words.push(text);
        if self.scene {
            add("scene.fits".to_owned());
        } else {
            add(format!("--shape {NX},{NY}"));
        }
        if self.catalog {
            add("--catalog sources.csv".to_owned());
        }
        if let Some(frame) = self.frame {
            let (x0, y0, shape) = (frame.x0(), frame.y0(), frame.shape());
            add(format!("--frame {x0},{y0},{},{}", shape.nx(), shape.ny()));
        }
        if self.oversample > 1 {
            add(format!("--oversampling {}", self.oversample));
        }
        if let Some(size) = self.stamp_size {
            add(format!("--stamp-size {size}"));
        }
        if self.method == Method::Auto {
            add(format!("--tolerance {TOLERANCE}"));
        }
        add(format!(
            "--psf samples.fits --anchor {} --method {} --precision {}",
            self.anchor,
            self.method,
            T::NAME
        ));
        if self.spot_check > 0 {
            add(format!("--spot-check {} --seed {SEED}", self.spot_check));
        }
        add(format!("-o {output} -q --device cpu"));
        words.join(" ")
    }

    /// Runs the library with these options. `command` is written to the header.
    fn done_by_library<T: ConvReal>(&self, desk: &Desk, output: &str, command: &str) {
        let psf = Psf::open(desk.path("samples.fits")).unwrap();
        let options = SimulateOptions {
            method: self.method,
            tolerance: TOLERANCE,
            anchor: self.anchor,
            oversample: self.oversample,
            stamp_size: self.stamp_size,
            frame: self.frame,
            device: Device::Cpu,
            ..SimulateOptions::default()
        };
        let (mut scene, mut shape, mut header) = (
            Scene::<T>::dark(),
            (NY * self.oversample, NX * self.oversample),
            HeaderCards::new(),
        );
        if self.scene {
            let read = psf_io::read_image::<T>(desk.path("scene.fits")).unwrap();
            let (image, its_header) = read.into_parts();
            (shape, header) = (image.pixels().dim(), its_header);
            scene = Scene::from(image);
        }
        if self.catalog {
            let catalog =
                psf_io::read_catalog_with(desk.path("sources.csv"), &CatalogOptions::default()).unwrap();
            let (stars, galaxies) = catalog.into_parts();
            scene = scene.with_stars(stars).with_galaxies(galaxies);
        }

        let simulator = psf.simulator(shape).options(options).build::<T>().unwrap();
        let image = simulator.simulate(&scene).unwrap();
        let mut cards = provenance_cards(command);
        cards[1] = Card::new("DATE", "1970-01-01T00:00:00", &cards[1].comment_text()).unwrap();
        cards.push(Card::new(PSF_FILE_KEYWORD, "samples.fits", "file of the PSF").unwrap());
        let made = simulator.prepare(&scene, &NoProgress).unwrap();
        cards.extend(simulator.cards(&made).unwrap());
        if self.spot_check > 0 {
            let pixels = (self.spot_check, SEED);
            let check = simulator.spot_check(&scene, &image, pixels, &NoProgress).unwrap();
            cards.extend(check.cards().unwrap());
        }
        let header = simulator.carried_header(&header, self.scene);
        psf_io::write_image(desk.path(output), &image, &header, &cards, false).unwrap();
    }
}

#[test]
fn the_library_writes_the_bytes_of_simulate() {
    fn compare<T: ConvReal>(asked: &Asked) {
        let desk = Desk::new();
        // A star between pixels, a star off the frame, and galaxies, one of them outside with light
        // on the frame.
        desk.write(
            "sources.csv",
            "x,y,flux,re,n,q,angle\n20.3,15.8,50,0,,,\n-2,10,90,0,,,\n33,28,200,3,1.5,0.6,30\n-3,30,300,4,1,0.8,10\n",
        );
        let arguments = asked.arguments::<T>("by_command.fits");
        desk.done(&arguments);
        // The number of threads and `--quiet` are not written to the header.
        let noted = format!("psfield {}", arguments.replace(" -q", ""));
        asked.done_by_library::<T>(&desk, "by_library.fits", &noted);
        assert!(
            desk.bytes("by_command.fits") == desk.bytes("by_library.fits"),
            "{arguments}"
        );
    }
    let frame = Some(PixelRegion::new(5, 4, FrameShape::new(24, 20).unwrap()));
    compare::<f32>(&PLAIN);
    compare::<f64>(&Asked {
        spot_check: 50,
        ..PLAIN
    });
    compare::<f32>(&Asked {
        catalog: true,
        frame,
        spot_check: 20,
        ..PLAIN
    });
    compare::<f32>(&Asked {
        catalog: true,
        frame,
        oversample: 2,
        anchor: Anchor::Output,
        stamp_size: Some(11),
        ..PLAIN
    });
    compare::<f64>(&Asked {
        scene: false,
        catalog: true,
        oversample: 3,
        ..PLAIN
    });
    compare::<f64>(&Asked {
        catalog: true,
        method: Method::Patch(16),
        spot_check: 10,
        ..PLAIN
    });
}

#[test]
fn a_fit_that_is_not_resampled_serves_in_place_of_its_samples() {
    let desk = Desk::new();
    let star = PointSource::new(Position::new(22.4, 30.3).unwrap(), 80.0).unwrap();
    let image_of = |psf: &Psf, (oversample, stamp_size): (usize, Option<usize>), image: bool, stars: bool| {
        let (mut scene, mut shape) = (Scene::<f32>::dark(), (NY * oversample, NX * oversample));
        if image {
            let read = psf_io::read_image::<f32>(desk.path("scene.fits")).unwrap();
            scene = Scene::from(read.into_parts().0);
            shape = (NY, NX);
        }
        if stars {
            scene = scene.with_stars(vec![star]);
        }
        let options = SimulateOptions {
            tolerance: TOLERANCE,
            oversample,
            stamp_size,
            frame: image.then(|| PixelRegion::new(2, 2, FrameShape::new(20, 20).unwrap())),
            ..SimulateOptions::default()
        };
        let simulator = psf.simulator(shape).options(options).build().unwrap();
        simulator.simulate(&scene).unwrap().into_pixels()
    };
    // The fit is truncated, so that resampling before and after it differ.
    let fit_options = FitOptions {
        rank: RankSelection::Fixed(2),
        ..FitOptions::default()
    };
    let both = |samples: PsfSamples| {
        let psf = Psf::new(samples, fit_options);
        let fitted = Psf::from(psf.record().unwrap().clone());
        [psf, fitted]
    };
    for (fineness, oversample, size, of_image, of_stars, resampled) in [
        (1, 1, None, true, false, false),
        (1, 1, None, true, true, false),
        (1, 1, Some(STAMP), true, true, false),
        (1, 1, Some(9), true, false, true),
        (1, 2, None, true, true, true),
        (3, 1, None, true, false, true),
        (3, 1, None, false, true, false),
        (3, 1, Some(9), false, true, false),
        (3, 2, None, false, true, false),
    ] {
        let images =
            both(samples(3, fineness)).map(|psf| image_of(&psf, (oversample, size), of_image, of_stars));
        let case = format!("{fineness} {oversample} {size:?} {of_image} {of_stars}");
        assert_eq!(images[0] == images[1], !resampled, "{case}");
    }
    // The response is added to stamps without it, for stars too.
    let without = samples(3, 1);
    let grid = without.grid().with_pixel_response_included(false);
    let without = PsfSamples::new(without.stamps().to_owned(), without.positions().clone(), grid);
    let images = both(without.unwrap()).map(|psf| image_of(&psf, (1, None), false, true));
    assert!(images[0] != images[1]);
}

#[test]
fn stamps_are_those_of_evaluate_at_any_number_of_positions() {
    let psf = Psf::from(samples(3, 3));
    let model = psf.model().unwrap();
    let options = EvaluateOptions {
        grid: OutputGrid::Native,
        size: Some(9),
        sub_pixel: true,
    };
    let at = |x, y| Position::new(x, y).unwrap();
    let places = [at(10.3, 20.0), at(44.0, 7.75)];
    let samples = evaluate(model, places.to_vec(), options).unwrap();
    let (stamps, grid) = evaluate_stamps(model, &[places[1], places[0], places[1]], options).unwrap();
    assert_eq!((grid, stamps.dim()), (samples.grid(), (3, 9, 9)));
    let plane = |k: usize| -> Array2<f64> { stamps.index_axis(ndarray::Axis(0), k).to_owned() };
    assert_eq!(plane(0), samples.stamp(1));
    assert_eq!(plane(1), samples.stamp(0));
    assert_eq!(plane(2), samples.stamp(1));
    assert_ne!(plane(0), plane(1));

    assert_eq!(evaluate_stamps(model, &[], options).unwrap().0.dim(), (0, 9, 9));
    let assert_refused = |error: PsfieldError, kind, part: &str| {
        assert!(
            error.kind() == kind && error.to_string().contains(part),
            "{error:?}"
        );
    };
    let refused = evaluate(model, Vec::new(), options).unwrap_err();
    assert_refused(refused, ErrorKind::Data, "there are no positions");
    let refused = evaluate(model, vec![places[0]; 2], options).unwrap_err();
    assert_refused(refused, ErrorKind::Data, "positions 0 and 1 (0-based) are both");
    let refused = evaluate_stamps(model, &[places[0], at(-9.0, 3.0)], options).unwrap_err();
    assert_refused(refused, ErrorKind::Field, "position 1 (0-based) at ");
    let on_own_grid = EvaluateOptions {
        grid: OutputGrid::Model,
        ..options
    };
    let refused = evaluate_stamps(model, &places, on_own_grid).unwrap_err();
    assert_refused(refused, ErrorKind::Setting, "choose the native grid");
}
