//! Transforms by their definition.

use std::f64::consts::TAU;

pub(super) type Complex = [f64; 2];

pub(super) fn times(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// `exp(i angle)`.
pub(super) fn turn(angle: f64) -> Complex {
    [angle.cos(), angle.sin()]
}

/// `sum_j v_j exp(sign 2 pi i j k / n)`.
fn transform(values: &[Complex], sign: f64) -> Vec<Complex> {
    let n = values.len();
    (0..n)
        .map(|k| {
            values.iter().enumerate().fold([0.0; 2], |sum, (j, &value)| {
                let turned = times(value, turn(sign * TAU * ((j * k) % n) as f64 / n as f64));
                [sum[0] + turned[0], sum[1] + turned[1]]
            })
        })
        .collect()
}

pub(super) fn forward(values: &[Complex]) -> Vec<Complex> {
    transform(values, -1.0)
}

/// Without a factor.
pub(super) fn back(values: &[Complex]) -> Vec<Complex> {
    transform(values, 1.0)
}
