//! `psfield evaluate` and `psfield compare`.

use ndarray::{Array2, Axis};
use psfield::psf_types::Position;

use crate::desk::{Desk, STAMP, assert_keys, points, samples, samples_at};

/// Rounding of stamps in f32, relative to the peak.
const SINGLE: f64 = 1e-7;
/// Rounding in f64.
const DOUBLE: f64 = 1e-13;

fn largest(a: ndarray::ArrayView2<'_, f64>, b: ndarray::ArrayView2<'_, f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

#[test]
fn samples_come_back_at_their_positions() {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits --rank full");
    desk.write("at.csv", "x,y\n30,25\n0,0\n");
    for (psf, options) in [("model", ""), ("samples", "--rank full")] {
        for (precision, tolerance) in [("f32", SINGLE), ("f64", DOUBLE)] {
            let out = format!("{psf}_{precision}.fits");
            let report = desk
                .done(&format!(
                    "evaluate {psf}.fits --at at.csv -o {out} --precision {precision} {options} --json"
                ))
                .json();
            assert_eq!(report["stamps"], 2);
            assert_eq!(report["shape"], serde_json::json!([STAMP, STAMP]));
            let (stamps, truth) = (desk.samples(&out), desk.samples("samples.fits"));
            assert_eq!(
                stamps.positions().as_slice()[0],
                Position::new(30.0, 25.0).unwrap()
            );
            for (plane, sample) in [(0, 4), (1, 0)] {
                let found = stamps.stamps().index_axis_move(Axis(0), plane);
                assert!(largest(found, truth.stamps().index_axis_move(Axis(0), sample)) <= tolerance);
            }
        }
    }
}

#[test]
fn positions_between_samples_are_interpolated() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n15,12.5\n");
    desk.done(
        "evaluate samples.fits --at at.csv -o stamp.fits --rank full --precision f64 --interpolation bilinear",
    );
    let truth = desk.samples("samples.fits");
    let corner = |k: usize| truth.stamps().index_axis_move(Axis(0), k);
    let mean = (&corner(0) + &corner(1) + corner(3) + corner(4)) / 4.0;
    let found = desk.samples("stamp.fits");
    assert!(largest(found.stamps().index_axis_move(Axis(0), 0), mean.view()) <= DOUBLE);
    // With another interpolator the comparison fails.
    desk.done("evaluate samples.fits --at at.csv -o nearest.fits --rank full --interpolation nearest");
    let nearest = desk.samples("nearest.fits");
    assert!(largest(nearest.stamps().index_axis_move(Axis(0), 0), mean.view()) > 1e-4);
    // On a grid of 3 x 3, the default is parabolas in x and y. Half way to the second line it is
    // the mean of their values at 2/5 and 3/5 of the way: (12, 16, -3) / 25 and (7, 21, -3) / 25.
    desk.done("evaluate samples.fits --at at.csv -o default.fits --rank full --precision f64");
    let weights = [0.38, 0.74, -0.12];
    let mut parabolas = Array2::<f64>::zeros(mean.dim());
    for (sample, stamp) in truth.stamps().outer_iter().enumerate() {
        parabolas.scaled_add(weights[sample % 3] * weights[sample / 3], &stamp);
    }
    let found = desk.samples("default.fits");
    assert!(largest(found.stamps().index_axis_move(Axis(0), 0), parabolas.view()) <= DOUBLE);
}

#[test]
fn native_grid_sizes_and_phases() {
    let desk = Desk::new();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk.write("at.csv", "x,y\n30.3,24.6\n");
    let stamp = |options: &str, out: &str| {
        desk.done(&format!(
            "evaluate fine.fits --at at.csv -o {out} --precision f64 {options}"
        ));
        desk.samples(out)
    };
    let centroid = |samples: &psfield::psf_types::PsfSamples| {
        let plane = samples.stamps().index_axis_move(Axis(0), 0);
        let sum = plane.sum();
        let of = |f: fn((usize, usize)) -> usize| {
            plane.indexed_iter().map(|(at, v)| f(at) as f64 * v).sum::<f64>() / sum
        };
        (of(|(_, x)| x), of(|(y, _)| y), sum)
    };
    // The shift is right to a thousandth of a pixel, because the stamps are well sampled.
    let near = |(x, y, sum): (f64, f64, f64), at: (f64, f64), flux: f64| {
        assert!((x - at.0).abs() < 1e-3 && (y - at.1).abs() < 1e-3, "{x} {y}");
        assert!((sum / flux - 1.0).abs() < 1e-3, "{sum}");
    };
    let model = stamp("", "model.fits");
    assert_eq!((model.grid().nx(), model.grid().oversampling()), (3 * STAMP, 3.0));
    near(centroid(&model), (22.0, 22.0), 9.0);
    let cut = stamp("--size 31", "cut.fits");
    assert_eq!((cut.grid().dim(), cut.grid().oversampling()), ((31, 31), 3.0));
    near(centroid(&cut), (15.0, 15.0), 9.0);
    let native = stamp("--pixels native", "native.fits");
    assert_eq!(
        (native.grid().dim(), native.grid().oversampling()),
        ((STAMP, STAMP), 1.0)
    );
    near(centroid(&native), (7.0, 7.0), 1.0);
    let shifted = stamp("--pixels native --sub-pixel --size 21", "shifted.fits");
    assert_eq!(shifted.grid().dim(), (21, 21));
    near(centroid(&shifted), (10.3, 9.6), 1.0);
}

#[test]
fn a_policy_rules_outside_the_samples() {
    let desk = Desk::empty();
    let triangle = samples_at(&[(10.0, 10.0), (50.0, 12.0), (30.0, 40.0)], 1);
    desk.write_samples("samples.fits", &triangle);
    desk.write("at.csv", "x,y\n0,0\n");
    let to = "evaluate samples.fits --at at.csv --rank full --precision f64";
    desk.refused(
        &format!("{to} -o out.fits --outside error"),
        1,
        &["at.csv", "(0, 0)"],
    );
    desk.done(&format!("{to} -o nearest.fits"));
    desk.done(&format!("{to} -o extend.fits --outside extend"));
    let [nearest, extended] = ["nearest.fits", "extend.fits"].map(|name| desk.samples(name));
    let apart = largest(
        nearest.stamps().index_axis_move(Axis(0), 0),
        extended.stamps().index_axis_move(Axis(0), 0),
    );
    assert!(apart > 1e-4, "{apart:e}");
}

#[test]
fn compare_measures_differences() {
    let desk = Desk::empty();
    desk.write_image("truth.fits", points(&[(10, 10, 3.0), (20, 10, 4.0)]));
    desk.write_image("result.fits", points(&[(10, 10, 3.0), (20, 10, 4.5)]));
    let keys = ["mae", "mse", "relative_l2", "max_abs", "max_over_peak"];
    let found = desk.done("compare result.fits truth.fits --json").json();
    assert_keys(&found, &keys);
    let pixels = 61.0 * 51.0;
    for (key, expected) in keys
        .into_iter()
        .zip([0.5 / pixels, 0.25 / pixels, 0.1, 0.5, 0.125])
    {
        let value = found[key].as_f64().unwrap();
        assert!(
            (value / expected - 1.0).abs() < DOUBLE,
            "{key}: {value:e}, {expected:e}"
        );
    }
    let text = desk.done("compare result.fits truth.fits").stdout;
    assert!(text.contains("relative L2   1.000000e-1"), "{text}");
    assert_eq!(
        desk.done("compare truth.fits truth.fits --json").json()["relative_l2"],
        0.0
    );
    // A reference of zeros has no peak and no norm.
    desk.write_image("dark.fits", points(&[]));
    let found = desk.done("compare truth.fits dark.fits --json").json();
    assert!(found["relative_l2"].is_null() && found["max_over_peak"].is_null());
    assert_eq!(found["max_abs"], 4.0);
}

#[test]
fn compare_summarises_cubes_by_plane() {
    let desk = Desk::empty();
    let truth = samples(3, 1);
    desk.write_samples("truth.fits", &truth);
    let mut stamps = truth.stamps().to_owned();
    stamps.index_axis_mut(Axis(0), 5).mapv_inplace(|v| v * 1.5);
    let result = psfield::psf_types::PsfSamples::new(stamps, truth.positions().clone(), truth.grid());
    desk.write_samples("result.fits", &result.unwrap());
    let found = desk.done("compare result.fits truth.fits --json").json();
    assert_eq!(found["planes"], 9);
    assert_keys(
        &found["median"],
        &["mae", "mse", "relative_l2", "max_abs", "max_over_peak"],
    );
    assert_eq!(found["median"]["relative_l2"], 0.0);
    assert!((found["max"]["relative_l2"].as_f64().unwrap() - 0.5).abs() < DOUBLE);
    desk.write_samples("other.fits", &samples(2, 1));
    desk.refused(
        "compare result.fits other.fits",
        1,
        &["result.fits", "other.fits", "[9, 15, 15]", "[4, 15, 15]"],
    );
    desk.done("fit truth.fits -o model.fits");
    desk.refused(
        "compare model.fits truth.fits",
        1,
        &["model.fits", "PSF model", "evaluate"],
    );
}
