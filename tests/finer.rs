//! Scenes finer than the frame, and the pixel response, which must be applied exactly once.

use ndarray::{Array2, Array3};
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate_stamps};
use psfield::psf_types::{
    Anchor, FrameShape, Image, NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfSamples,
    SamplePositions, StampGrid,
};
use psfield::{FitOptions, Method, Psf, Scene, SimulateOptions};

const FRAME: usize = 40;

/// Gaussians that widen and move over the field, `s` samples per frame pixel. With `response` they
/// are averaged over a frame pixel.
fn sampled(s: usize, response: bool) -> Psf {
    let n = 24 * s + 1;
    let grid = StampGrid::new(n, n)
        .and_then(|g| g.with_oversampling(s as f64))
        .unwrap()
        .with_pixel_response_included(response);
    let last = FRAME as i64 - 1;
    let places = [(0, 0), (last, 0), (0, last), (last, last)];
    let positions = places.map(|(x, y)| Position::of_pixel(x, y)).to_vec();
    let field = Some(FrameShape::new(FRAME, FRAME).unwrap());
    let stamps = Array3::from_shape_fn((4, n, n), |(j, y, x)| {
        let sigma = 1.2 + 0.15 * j as f64;
        let at = |i: usize| (i as f64 - (n / 2) as f64) / s as f64;
        let (dx, dy) = (at(x) - 0.1 * j as f64, at(y));
        if response {
            averaged(dx, sigma) * averaged(dy, sigma)
        } else {
            gauss(dx, sigma) * gauss(dy, sigma)
        }
    });
    let samples = PsfSamples::new(stamps, SamplePositions::new(positions, field).unwrap(), grid).unwrap();
    let options = FitOptions {
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    Psf::new(samples, options)
}

fn gauss(d: f64, sigma: f64) -> f64 {
    (-d * d / (2.0 * sigma * sigma)).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
}

/// The Gaussian averaged over a frame pixel, by a fine sum.
fn averaged(d: f64, sigma: f64) -> f64 {
    (0..64)
        .map(|k| gauss(d + (f64::from(k) + 0.5) / 64.0 - 0.5, sigma))
        .sum::<f64>()
        / 64.0
}

fn largest_difference(a: &Image<f64>, b: &Image<f64>) -> f64 {
    let peak = b.pixels().fold(0.0f64, |m, v| m.max(v.abs()));
    assert!(peak > 0.0, "the test must see light");
    (&a.pixels() - &b.pixels()).fold(0.0f64, |m, v| m.max(v.abs())) / peak
}

fn stars() -> Vec<PointSource> {
    [
        (10.0, 12.0, 100.0),
        (30.25, 20.5, 50.0),
        (-2.0, 8.75, 80.0),
        (33.0, 39.4, 60.0),
    ]
    .map(|(x, y, flux)| PointSource::new(Position::new(x, y).unwrap(), flux).unwrap())
    .to_vec()
}

fn run(psf: &Psf, scene: &Scene<'_>, options: &SimulateOptions) -> Image<f64> {
    let side = FRAME * options.oversample;
    let by = |method| {
        let options = SimulateOptions {
            method,
            tolerance: 0.0,
            ..options.clone()
        };
        psf.simulator((side, side)).options(options).build().unwrap()
    };
    let simulator = by(Method::Auto);
    let image = simulator.simulate(scene).unwrap();
    let direct = by(Method::Direct).simulate(scene).unwrap();
    assert!(
        largest_difference(&image, &direct) < 1e-11,
        "the engine and the direct sum"
    );
    let pixels = [(3, 4), (20, 17), (10, 12), (30, 21)];
    let exact = simulator.exact_at(scene, &pixels, &NoProgress).unwrap();
    for (&(x, y), exact) in pixels.iter().zip(exact) {
        assert!((direct.pixels()[[y, x]] - exact).abs() < 1e-9, "{x}, {y}");
    }
    image
}

fn finer(s: usize, anchor: Anchor) -> SimulateOptions {
    SimulateOptions {
        oversample: s,
        anchor,
        ..SimulateOptions::default()
    }
}

/// Light in a pixel of a finer scene gives the image of a star at that pixel's centre, for odd and
/// even scales.
#[test]
fn light_in_fine_pixels_equals_stars_at_their_centres() {
    for s in [2, 3, 4] {
        let mut light = Array2::zeros((FRAME * s, FRAME * s));
        let mut stars = Vec::new();
        for (x, y, flux) in [(50, 60, 7.0), (51, 33, 3.0), (2 * s, 3, 5.0), (79, 79, 2.0)] {
            light[[y, x]] = flux;
            let of_frame = |v: usize| (v as f64 - (s as f64 - 1.0) / 2.0) / s as f64;
            stars.push(PointSource::new(Position::new(of_frame(x), of_frame(y)).unwrap(), flux).unwrap());
        }
        let psf = sampled(4, true);
        let image = run(&psf, &Scene::new(light).unwrap(), &finer(s, Anchor::Source));
        assert_eq!(image.shape(), FrameShape::new(FRAME, FRAME).unwrap());
        let dark = Scene::dark().with_stars(stars);
        let expected = run(&psf, &dark, &SimulateOptions::default());
        // For s = 3, which does not divide the stamps' oversampling of 4, one spline interpolates
        // the stamps for both images.
        let largest = largest_difference(&image, &expected);
        assert!(largest < 1e-9, "{s}: {largest}");
    }
}

/// Output-anchored, each frame pixel uses the PSF at its own centre, also for even scales.
#[test]
fn output_anchored_images_of_finer_scenes() {
    for s in [2, 3] {
        let mut light = Array2::zeros((FRAME * s, FRAME * s));
        light[[21 * s, 20 * s + 1]] = 7.0;
        let psf = sampled(4, true);
        let image = run(&psf, &Scene::new(light).unwrap(), &finer(s, Anchor::Output));
        let of_frame = |v: usize| (v as f64 - (s as f64 - 1.0) / 2.0) / s as f64;
        let star = PointSource::new(
            Position::new(of_frame(20 * s + 1), of_frame(21 * s)).unwrap(),
            7.0,
        );
        let dark = Scene::dark().with_stars(vec![star.unwrap()]);
        let expected = run(&psf, &dark, &finer(1, Anchor::Output));
        assert!(largest_difference(&image, &expected) < 1e-9, "{s}");
    }
}

/// Stamps without the response give the image of stamps with it: stars, images and finer scenes.
#[test]
fn the_pixel_response_is_applied_once() {
    let mut light = Array2::zeros((FRAME, FRAME));
    (light[[10, 20]], light[[30, 31]]) = (5.0, 8.0);
    let image = Scene::new(light).unwrap().with_stars(stars());
    let dark = Scene::dark().with_stars(stars());
    let mut fine = Array2::zeros((2 * FRAME, 2 * FRAME));
    fine[[33, 44]] = 3.0;
    let fine = Scene::new(fine).unwrap();
    for (scene, s) in [(&image, 1), (&dark, 1), (&fine, 2)] {
        let with = run(&sampled(4, true), scene, &finer(s, Anchor::Source));
        let without = run(&sampled(4, false), scene, &finer(s, Anchor::Source));
        let largest = largest_difference(&without, &with);
        // The error of a cubic spline through four samples per pixel, for a sigma of 1.2 pixels.
        assert!(largest < 5e-5, "{largest}");
        // A response applied twice would show: the variance of a pixel is 1/12.
        let psf = sampled(4, true);
        let (samples, options) = psf.samples().expect("samples");
        let grid = samples.grid().with_pixel_response_included(false);
        let again = PsfSamples::new(samples.stamps().to_owned(), samples.positions().clone(), grid).unwrap();
        let twice = run(&Psf::new(again, *options), scene, &finer(s, Anchor::Source));
        assert!(largest_difference(&twice, &with) > 1e-2);
    }
}

/// `evaluate` on the frame's pixels gives the star that a simulation draws, for stamps with and
/// without the response.
#[test]
fn a_psf_on_the_frames_pixels_is_the_image_of_a_star() {
    const SIZE: usize = 21;
    let (x, y) = (20.25, 18.5);
    let star = PointSource::new(Position::new(x, y).unwrap(), 1.0).unwrap();
    let scene = Scene::dark().with_stars(vec![star]);
    let (first_x, first_y) = (20 - SIZE / 2, 19 - SIZE / 2);
    let rows_and_columns = ndarray::s![first_y..first_y + SIZE, first_x..first_x + SIZE];
    for (s, response) in [(4, true), (4, false), (5, false)] {
        let psf = sampled(s, response);
        let image = run(&psf, &scene, &SimulateOptions::default());
        let image = Image::new(image.pixels().slice(rows_and_columns).to_owned()).unwrap();
        let model = psf.model().unwrap();
        let on_frame = EvaluateOptions {
            grid: OutputGrid::Native,
            size: Some(SIZE),
            sub_pixel: true,
        };
        let (stamps, grid) = evaluate_stamps(model, &[star.position()], on_frame).unwrap();
        assert!(grid.pixel_response_included());
        let seen = Image::new(stamps.index_axis_move(ndarray::Axis(0), 0)).unwrap();
        let largest = largest_difference(&seen, &image);
        // When the response is added, the simulation interpolates stamps that have it, with one
        // more spline.
        let limit = if response { 1e-12 } else { 5e-5 };
        assert!(largest < limit, "{s}, {response}: {largest}");

        // Stamps on the model's own pixels stay unchanged. Centred PSFs on the frame's pixels get
        // the response.
        let of = |grid| {
            let options = EvaluateOptions {
                grid,
                ..EvaluateOptions::default()
            };
            evaluate_stamps(model, &[star.position()], options).unwrap()
        };
        assert_eq!(of(OutputGrid::Model).1, model.grid());
        let (stamps, grid) = of(OutputGrid::Native);
        assert!(grid.pixel_response_included());
        // Stamps that fill whole frame pixels do not grow by the half pixel of margin.
        assert!((stamps.sum() - 1.0).abs() < 1e-3, "{}", stamps.sum());
    }
}

/// A frame within a finer scene, cut at whole frame pixels.
#[test]
fn frames_of_finer_scenes() {
    let s = 2;
    let mut light = Array2::zeros((FRAME * s, FRAME * s));
    light[[33, 44]] = 3.0;
    light[[2, 5]] = 30.0;
    let whole = Scene::new(light).unwrap();
    // A constant PSF, so that the image of the cut is a cut of the image.
    let psf = sampled(4, true);
    let (samples, options) = psf.samples().expect("samples");
    let one = samples.stamps().slice(ndarray::s![..1, .., ..]).to_owned();
    let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
    let psf = Psf::new(PsfSamples::new(one, positions, samples.grid()).unwrap(), *options);
    let all = run(&psf, &whole, &finer(s, Anchor::Source));
    let frame = PixelRegion::new(2, 1, FrameShape::new(35, 32).unwrap());
    let options = SimulateOptions {
        frame: Some(frame),
        ..finer(s, Anchor::Source)
    };
    let image = run(&psf, &whole, &options);
    let expected = all.pixels().slice(ndarray::s![1..33, 2..37]).to_owned();
    assert!(largest_difference(&image, &Image::new(expected).unwrap()) < 1e-12);
    // A frame is given in frame pixels. A scene that is not a whole number of them needs an
    // explicit frame.
    let odd = |options| {
        psf.simulator((FRAME * s, FRAME * s + 1))
            .options(options)
            .build::<f64>()
    };
    assert!(odd(options).is_ok());
    let refused = odd(finer(s, Anchor::Source)).unwrap_err();
    assert_eq!(refused.setting(), Some("frame"));
    assert!(
        refused.to_string().contains("must be multiples of 2"),
        "{refused}"
    );
}
