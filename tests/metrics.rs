//! Measurements of simulated stars.

use integration_tests::{small_telescope, uniform_samples};
use psfield::measure::MeasureOptions;
use psfield::metrics::{AdaptiveMomentFinder, GaussianFitter, Window};
use psfield::psf_types::{NoProgress, PointSource, Position};
use psfield::{Psf, Scene};

/// A star on a pixel is its stamp times its flux. Measurements differ by rounding in f64.
const ROUNDING: f64 = 1e-9;

#[test]
fn stars_on_pixels_measure_as_their_psfs() {
    let psf = Psf::from(uniform_samples(&small_telescope(1), 9, 7));
    let places = [(20, 20), (80, 60), (140, 100), (30, 95)];
    let stars = places
        .map(|(x, y)| PointSource::new(Position::of_pixel(x, y), 1e4).unwrap())
        .to_vec();
    let scene = Scene::<f64>::dark().with_stars(stars);
    let simulator = psf.simulator((120, 160)).tolerance(0.0).build().unwrap();
    let image = simulator.simulate(&scene).unwrap();
    let made = simulator.prepare(&scene, &NoProgress).unwrap();

    let positions = places.map(|(x, y)| Position::of_pixel(x, y));
    let options = MeasureOptions {
        window: Some(15),
        background: false,
    };
    let rows = options.image(image.pixels(), &positions);
    for (row, position) in rows.iter().zip(positions) {
        assert!(row.note.is_empty(), "{}", row.note);
        let stamp = made.model.psf_at(position).unwrap();
        let window = Window::central(15);
        let fit = GaussianFitter::elliptical()
            .with_window(window)
            .fit(stamp.values())
            .unwrap();
        let moments = AdaptiveMomentFinder::new()
            .with_window(window)
            .measure(stamp.values())
            .unwrap();
        let close = |a: Option<f64>, b: f64| (a.unwrap() - b).abs() < ROUNDING * b.abs().max(1.0);
        assert!(close(row.fwhm_px, fit.fwhm_px()) && close(row.eccentricity, fit.eccentricity()));
        assert!(close(row.flux, 1e4 * fit.flux()));
        assert!(
            close(row.sigma_px, moments.sigma_px())
                && close(row.ellipticity, moments.e1().hypot(moments.e2()))
                && close(row.g1, moments.g1())
                && close(row.e2, moments.e2())
        );
        assert!(close(row.x_centroid, position.x() + fit.x_centroid() - 12.0));
    }
}

#[test]
fn sub_pixel_stars_lie_where_they_should() {
    // Stamps are three times oversampled: their spline is accurate to a few 1e-4 pixels.
    let psf = Psf::from(uniform_samples(&small_telescope(3), 5, 5));
    let centred = psf.native(None).unwrap();
    let centred = centred.model().unwrap();
    let simulator = psf.simulator((120, 160)).build::<f64>().unwrap();
    let fitter = |x, y| GaussianFitter::elliptical().with_window(Window::about(15, x, y));
    for (dx, dy) in [(0.0, 0.0), (0.25, -0.4), (-0.5, 0.49), (0.1, 0.3)] {
        let position = Position::new(80.0 + dx, 60.0 + dy).unwrap();
        let star = PointSource::new(position, 1.0).unwrap();
        let image = simulator.simulate(&Scene::dark().with_stars(vec![star])).unwrap();
        let fit = fitter(80, 60).fit(image.pixels()).unwrap();
        let stamp = centred.psf_at(position).unwrap();
        let (cx, cy) = stamp.grid().whole_centre().unwrap();
        let reference = fitter(cx, cy).fit(stamp.values()).unwrap();
        let off_x = fit.x_centroid() - position.x() - (reference.x_centroid() - cx as f64);
        let off_y = fit.y_centroid() - position.y() - (reference.y_centroid() - cy as f64);
        println!("star at ({dx}, {dy}): off by ({off_x:.1e}, {off_y:.1e}) pixels");
        // The PSF is not a Gaussian, so the centre of the fit moves a little with the sub-pixel
        // phase.
        assert!(off_x.abs() < 0.01 && off_y.abs() < 0.01, "{off_x} {off_y}");
    }
}
