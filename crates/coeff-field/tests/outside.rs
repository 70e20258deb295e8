//! The outside policies, for every interpolator and for difficult layouts of samples.

mod common;

use common::{Extent, at, each, field, methods, reproduces_slopes, samples_of, smooth, value};
use ndarray::Array3;
use psf_types::{FieldError, FrameShape, OutsidePolicy, PixelRegion, Position, SamplePositions};

/// Rounding of an interpolated value of order 1 in well shaped cells.
const ROUNDING: f64 = 1e-11;

#[test]
fn the_outside_is_refused_or_takes_the_value_at_the_edge() {
    each(|layout, name, positions, method| {
        let extent = Extent::of(positions);
        let samples = samples_of(positions, 1, smooth(extent));
        let strict = field(&samples, method, OutsidePolicy::Error);
        let nearest = field(&samples, method, OutsidePolicy::Nearest);
        let size = extent.size();
        // Positions beyond the lowest and the highest sample in x are certainly outside. The sample
        // itself is inside, also after rounding.
        for (edge, sign) in [(extent.low.0, -1.0), (extent.high.0, 1.0)] {
            for &p in positions.iter().filter(|p| p.x() == edge) {
                let mut v = [f64::NAN];
                strict.evaluate_into(p, &mut v).unwrap();
                for hair in [1e-12, 1e-15 * size] {
                    strict
                        .evaluate_into(at(p.x() + sign * hair, p.y()), &mut v)
                        .unwrap();
                    let rounded = value(&nearest, p);
                    assert!((v[0] - rounded).abs() < 1e-6, "{layout} {name} {p}");
                }
                let out = at(p.x() + sign * 0.01 * size, p.y());
                assert!(
                    matches!(strict.evaluate_into(out, &mut v), Err(FieldError::OutsideSamples { position }) if position == out),
                    "{layout} {name} {out}"
                );
                let mut region = Array3::zeros((1, 1, 1));
                let far = PixelRegion::new(
                    (p.x() + sign * (2.0 + 0.1 * size)) as i64,
                    p.y() as i64,
                    FrameShape::new(1, 1).unwrap(),
                );
                assert!(strict.evaluate_region_into(far, 0..1, region.view_mut()).is_err());
            }
        }
        // Far away in many directions, where rounding is coarse.
        for (dx, dy) in [(1.0, 0.0), (-1.0, 0.0), (0.3, 1.0), (-1.0, -1.0)] {
            for far in [1e3 * size, 1e12 * size, 1e49] {
                let p = at(dx * far, dy * far);
                let v = value(&nearest, p);
                assert!(v.is_finite() && v.abs() < 10.0, "{layout} {name} {p}: {v}");
                if far > 1e9 {
                    assert!(strict.evaluate_into(p, &mut [0.0]).is_err());
                }
            }
        }
        assert!(matches!(
            nearest.evaluate_into(at(1e60, 0.0), &mut [0.0]),
            Err(FieldError::External { .. })
        ));
    });
}

#[test]
fn edges_and_corners_of_a_grid_are_inside() {
    for angle in [0.0, 0.3, 0.6, 1.1] {
        let positions = common::grid(9, 8, 10.0, angle, 0.0);
        let checked = SamplePositions::new(positions.clone(), None).unwrap();
        let slope = |p: Position, _: usize| 0.02 * p.x() - 0.03 * p.y();
        for (name, method) in methods(&checked) {
            let strict = field(
                &samples_of(&positions, 1, slope),
                method.as_ref(),
                OutsidePolicy::Error,
            );
            let corners = [positions[0], positions[8], positions[71], positions[63]];
            for side in 0..4 {
                let (a, b) = (corners[side], corners[(side + 1) % 4]);
                for i in 0..=200 {
                    let t = f64::from(i) / 200.0;
                    let p = at(a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y()));
                    let v = value(&strict, p);
                    // The tree of natural neighbours has no edges along a turned hull.
                    let is_on_tree = name != "natural-neighbour" || angle == 0.0;
                    if reproduces_slopes(name) && is_on_tree {
                        assert!((v - slope(p, 0)).abs() < ROUNDING, "{name} {angle} {p}");
                    }
                }
            }
        }
    }
}
