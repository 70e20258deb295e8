//! Rules of integration and interpolation on squares.

/// Values along an axis that fix the polynomial of a block.
pub(crate) const NODES: usize = 6;

/// Nodes and weights of Gauss and Legendre for an interval of length 1 around 0.
pub(crate) const GAUSS_2: [(f64, f64); 2] = [(-0.288_675_134_594_812_9, 0.5), (0.288_675_134_594_812_9, 0.5)];
/// The same of three nodes.
pub(crate) const GAUSS_3: [(f64, f64); 3] = [
    (-0.387_298_334_620_741_7, 5.0 / 18.0),
    (0.0, 8.0 / 18.0),
    (0.387_298_334_620_741_7, 5.0 / 18.0),
];
/// The same of four nodes.
pub(crate) const GAUSS_4: [(f64, f64); 4] = [
    (-0.430_568_155_797_026_3, 0.173_927_422_568_726_9),
    (-0.169_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.169_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.430_568_155_797_026_3, 0.173_927_422_568_726_9),
];

/// Chebyshev's nodes on an interval of length 1 around 0.
pub(crate) fn chebyshev_nodes() -> [f64; NODES] {
    std::array::from_fn(|k| {
        let angle = (2 * k + 1) as f64 * std::f64::consts::PI / (2 * NODES) as f64;
        0.5 * angle.cos()
    })
}

/// For each pixel along a block of `size` pixels, the weights of the values at the nodes (Lagrange's polynomials).
pub(crate) fn interpolation_weights(size: usize) -> Vec<[f64; NODES]> {
    let nodes = chebyshev_nodes();
    let weights_at = |at: f64| {
        std::array::from_fn(|k| {
            (0..NODES)
                .filter(|&j| j != k)
                .map(|j| (at - nodes[j]) / (nodes[k] - nodes[j]))
                .product()
        })
    };
    (0..size)
        .map(|pixel| weights_at((pixel as f64 + 0.5) / size as f64 - 0.5))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_rules_are_exact_up_to_their_degree() {
        let rules: [(&[(f64, f64)], i32); 3] = [(&GAUSS_2, 3), (&GAUSS_3, 5), (&GAUSS_4, 7)];
        for (rule, degree) in rules {
            let integral = |m: i32| rule.iter().map(|(x, w)| w * x.powi(m)).sum::<f64>();
            let exact = |m: i32| {
                if m % 2 == 0 {
                    0.5_f64.powi(m) / f64::from(m + 1)
                } else {
                    0.0
                }
            };
            for m in 0..=degree {
                assert!((integral(m) - exact(m)).abs() < 1e-16, "degree {m} of {degree}");
            }
            assert!((integral(degree + 1) - exact(degree + 1)).abs() > 1e-8);
        }
    }

    #[test]
    fn polynomials_of_degree_5_are_interpolated_exactly() {
        let nodes = chebyshev_nodes();
        let polynomial = |x: f64| 1.0 + x * (2.0 - x * (3.0 + x * (1.0 - x * (4.0 + 5.0 * x))));
        for (pixel, weights) in interpolation_weights(16).iter().enumerate() {
            let at = (pixel as f64 + 0.5) / 16.0 - 0.5;
            let value: f64 = weights.iter().zip(nodes).map(|(w, x)| w * polynomial(x)).sum();
            assert!((value - polynomial(at)).abs() < 1e-14);
        }
    }
}
