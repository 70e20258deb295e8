//! Mixtures of states: coefficients between wavelengths or times, and means over a spectrum.

use std::collections::{HashMap, HashSet};

use ndarray::{Array2, ArrayView2, s};
use psf_types::{Interpolation, OutsidePolicy, Position, SampleCoefficients, SamplePositions, StateKind};

use crate::choice::interpolation;
use crate::error::CoeffFieldError;

/// The coefficients of mixtures of states: `v_p = sum_s W_ps v_s`. `mixtures` are the weights `W`
/// `[mixture, state]`. The result has one state for each mixture, of the given kind and value. If
/// `labels` is None, there is one mixture, and the result has no states.
///
/// If the samples of all states that a mixture needs are at the same positions, so are those of the
/// result. Otherwise each state is interpolated to the positions of all of them.
///
/// # Errors
/// [`CoeffFieldError::DifferentGrids`] when states differ in their positions and `method` needs a
/// regular grid. The errors of [`FieldInterpolation::interpolate`](crate::FieldInterpolation::interpolate).
///
/// # Panics
/// When `mixtures` does not have one column per state, or `labels` not one value per mixture.
pub fn mix_states(
    samples: &SampleCoefficients,
    (method, outside): (Interpolation, OutsidePolicy),
    mixtures: ArrayView2<'_, f64>,
    labels: Option<(StateKind, &[f64])>,
) -> Result<SampleCoefficients, CoeffFieldError> {
    let all = samples.positions();
    assert_eq!(mixtures.ncols(), all.state_count(), "one weight per state");
    assert_eq!(
        mixtures.nrows(),
        labels.map_or(1, |(_, values)| values.len()),
        "one label per mixture"
    );
    let used: Vec<usize> = (0..all.state_count())
        .filter(|&state| mixtures.column(state).iter().any(|w| *w != 0.0))
        .collect();
    let at = positions_of(all, &used);
    // [state, node, component]
    let on_nodes = used
        .iter()
        .map(|&state| on_positions(samples, state, &at, (method, outside)));
    let on_nodes = on_nodes.collect::<Result<Vec<_>, _>>()?;
    let (nodes, components) = (at.len(), samples.component_count());
    let mut values = Array2::zeros((mixtures.nrows() * nodes, components));
    for (mixture, weights) in mixtures.outer_iter().enumerate() {
        let mut block = values.slice_mut(s![mixture * nodes..(mixture + 1) * nodes, ..]);
        for (&state, of_state) in used.iter().zip(&on_nodes) {
            block.scaled_add(weights[state], of_state);
        }
    }
    let positions = match labels {
        None => SamplePositions::new(at, all.field()),
        Some((kind, of_mixtures)) => SamplePositions::in_every_state(&at, all.field(), kind, of_mixtures),
    };
    Ok(SampleCoefficients::new(values, positions?)?)
}

/// The distinct positions of the samples of some states, in the order of their first appearance.
fn positions_of(all: &SamplePositions, states: &[usize]) -> Vec<Position> {
    let mut seen = HashSet::new();
    let samples = states.iter().flat_map(|&state| all.samples_of_state(state));
    let positions = samples.map(|sample| all.as_slice()[sample]);
    positions
        .filter(|&position| seen.insert(position.bits()))
        .collect()
}

/// The coefficients of one state at these positions, `[position, component]`. They are interpolated
/// only where the state has no sample.
fn on_positions(
    samples: &SampleCoefficients,
    state: usize,
    at: &[Position],
    (method, outside): (Interpolation, OutsidePolicy),
) -> Result<Array2<f64>, CoeffFieldError> {
    let own = samples.positions().samples_of_state(state);
    let positions = samples.positions().as_slice();
    let known: HashMap<_, _> = own
        .iter()
        .map(|&sample| (positions[sample].bits(), sample))
        .collect();
    let mut values = Array2::zeros((at.len(), samples.component_count()));
    let mut unknown = Vec::new();
    for (node, &position) in at.iter().enumerate() {
        match known.get(&position.bits()) {
            Some(&sample) => values.row_mut(node).assign(&samples.values().row(sample)),
            None => unknown.push(node),
        }
    }
    if unknown.is_empty() {
        return Ok(values);
    }
    if let Some(states) = samples.positions().states()
        && matches!(method, Interpolation::Bilinear | Interpolation::Bicubic)
    {
        let (kind, interpolation) = (states.kind(), method);
        return Err(CoeffFieldError::DifferentGrids { kind, interpolation });
    }
    let of_state = samples.of_state(state);
    let field = interpolation(method)?.interpolate(&of_state, outside)?;
    for node in unknown {
        let row = values.row_mut(node).into_slice().expect("row-major");
        field.evaluate_into(at[node], row)?;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use psf_types::SampleStates;

    use super::*;
    use crate::state_weights;

    /// Rounding of sums of a few terms of order 10.
    const ROUNDING: f64 = 1e-13;

    /// Samples of `f(x, y, wavelength)` in states 1, 2, 4 and 5, at the corners of a square and, in
    /// some states, at a point inside.
    fn samples(f: impl Fn(f64, f64, f64) -> f64, with_inner: &[f64]) -> SampleCoefficients {
        let corners = [(0, 0), (8, 0), (0, 8), (8, 8)].map(|(x, y)| Position::of_pixel(x, y));
        let (mut at, mut states) = (Vec::new(), Vec::new());
        for state in [4.0, 1.0, 2.0, 5.0] {
            let inner = with_inner.contains(&state).then(|| Position::of_pixel(3, 5));
            for position in corners.into_iter().chain(inner) {
                at.push(position);
                states.push(state);
            }
        }
        let values = at.iter().zip(&states).map(|(p, &s)| f(p.x(), p.y(), s)).collect();
        let values = Array2::from_shape_vec((at.len(), 1), values).unwrap();
        let states = SampleStates::new(StateKind::Wavelength, &states).unwrap();
        SampleCoefficients::new(
            values,
            SamplePositions::with_states(at, None, Some(states)).unwrap(),
        )
        .unwrap()
    }

    fn row_at(values: &[f64], v: f64) -> Array2<f64> {
        let mut row = Array2::zeros((1, values.len()));
        for (state, weight) in state_weights(values, v) {
            row[(0, state)] += weight;
        }
        row
    }

    #[test]
    fn cubics_of_the_wavelength_are_exact_at_equal_positions() {
        let f = |x: f64, y: f64, w: f64| (1.0 + x) * w.powi(3) / 50.0 - y * w;
        let samples = samples(f, &[1.0, 2.0, 4.0, 5.0]);
        let states = samples.positions().states().unwrap().values().to_vec();
        for v in [1.0, 1.7, 3.3, 5.0] {
            let mixed = mix_states(
                &samples,
                (Interpolation::Bilinear, OutsidePolicy::Nearest),
                row_at(&states, v).view(),
                None,
            )
            .unwrap();
            assert_eq!((mixed.positions().len(), mixed.positions().states()), (5, None));
            for (p, row) in mixed
                .positions()
                .as_slice()
                .iter()
                .zip(mixed.values().outer_iter())
            {
                assert!((row[0] - f(p.x(), p.y(), v)).abs() < ROUNDING * 10.0, "{v}");
            }
        }
    }

    #[test]
    fn weights_are_continuous_between_uneven_states() {
        let states = [0.0, 10.0, 25.0, 30.0, 60.0, 70.0];
        let at = |v: f64| row_at(&states, v);
        for step in 0..7000 {
            let v = 0.01 * f64::from(step);
            let jump = (at(v + 1e-9) - at(v)).mapv(f64::abs).sum();
            assert!(jump < 1e-8, "{v}: {jump:e}");
            assert!((at(v).sum() - 1.0).abs() < ROUNDING, "{v}");
        }
    }

    #[test]
    fn a_model_without_components_has_states_too() {
        let positions = samples(|_, _, _| 0.0, &[]).positions().clone();
        let samples = SampleCoefficients::new(Array2::zeros((positions.len(), 0)), positions).unwrap();
        let labels = Some((StateKind::Spectrum, &[0.0, 1.0][..]));
        let half = Array2::from_elem((2, 4), 0.25);
        let method = (Interpolation::Bilinear, OutsidePolicy::Nearest);
        let mixed = mix_states(&samples, method, half.view(), labels).unwrap();
        assert_eq!(mixed.values().dim(), (8, 0));
    }

    #[test]
    fn states_at_different_positions_are_interpolated_to_all_of_them() {
        // Linear in the position, so that every state knows its value at the inner point.
        let f = |x: f64, y: f64, w: f64| x * w - y;
        let samples = samples(f, &[2.0]);
        let weights = ndarray::array![[0.25, 0.75, 0.0, 0.0], [0.0, 0.0, 0.5, 0.5]];
        let mixed = |method| {
            let labels = Some((StateKind::Spectrum, &[0.0, 1.0][..]));
            mix_states(&samples, (method, OutsidePolicy::Nearest), weights.view(), labels)
        };
        let found = mixed(Interpolation::NaturalNeighbour).unwrap();
        assert_eq!(
            (found.positions().len(), found.positions().state_count()),
            (10, 2)
        );
        for (mixture, mean) in [1.75, 4.5].into_iter().enumerate() {
            let of_state = found.of_state(mixture);
            for (p, row) in of_state
                .positions()
                .as_slice()
                .iter()
                .zip(of_state.values().outer_iter())
            {
                assert!((row[0] - f(p.x(), p.y(), mean)).abs() < ROUNDING * 10.0);
            }
        }
        let message = mixed(Interpolation::Bilinear).unwrap_err().to_string();
        assert!(
            message.contains("wavelength") && message.contains("natural-neighbour"),
            "{message}"
        );
    }
}
