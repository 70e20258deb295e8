//! Predictions of PSFs from those drawn so far.

use coeff_field::{CoeffFieldError, Kriging, KrigingFit};
use ndarray::{Array2, ArrayView2};
use psf_types::{
    KrigingKernel, KrigingParameters, OutsidePolicy, Position, SampleCoefficients, SamplePositions,
};

use crate::orthonormal::OrthonormalBasis;

/// The parameters are chosen again when the number of PSFs has grown by this factor.
const CHOSEN_AGAIN: f64 = 1.15;

/// Predicts PSFs by kriging. It learns from each PSF that is drawn.
#[derive(Debug, Default)]
pub(crate) struct Learner {
    basis: OrthonormalBasis,
    positions: Vec<Position>,
    /// For each PSF, the coefficients that are not 0.
    coefficients: Vec<Vec<f64>>,
    fit: Option<KrigingFit>,
    /// The parameters, and the number of PSFs from which they were chosen.
    chosen: Option<(KrigingParameters, usize)>,
}

impl Learner {
    /// Adds a PSF. Predictions use it after the next [`fit`](Self::fit).
    pub(crate) fn add(&mut self, position: Position, stamp: ArrayView2<'_, f64>) {
        self.positions.push(position);
        self.coefficients.push(self.basis.add(stamp));
    }

    /// Fits kriging to the PSFs so far.
    pub(crate) fn fit(&mut self) -> Result<(), CoeffFieldError> {
        let mut values = Array2::zeros((self.positions.len(), self.basis.len()));
        for (mut row, coefficients) in values.outer_iter_mut().zip(&self.coefficients) {
            for (value, coefficient) in row.iter_mut().zip(coefficients) {
                *value = *coefficient;
            }
        }
        let positions = SamplePositions::new(self.positions.clone(), None)?;
        let samples = SampleCoefficients::new(values, positions)?;
        let count = self.positions.len();
        let kriging = match self.chosen {
            Some((parameters, of)) if (count as f64) < CHOSEN_AGAIN * of as f64 => Kriging::new(parameters),
            _ => {
                let parameters = Kriging::default().parameters(&samples)?;
                self.chosen = Some((parameters, count));
                Kriging::new(parameters)
            }
        };
        self.fit = Some(kriging.fit(&samples, OutsidePolicy::Extend)?);
        Ok(())
    }

    fn fitted(&self) -> &KrigingFit {
        self.fit.as_ref().expect("fitted before predictions")
    }

    fn coefficients_at(&self, position: Position) -> Vec<f64> {
        // PSFs may have been added after the fit.
        let field = self.fitted().field();
        let mut coefficients = vec![0.0; field.component_count()];
        let predicted = field.evaluate_into(position, &mut coefficients);
        predicted.expect("the field extends beyond its samples");
        coefficients
    }

    /// The PSF that the fit predicts at a position.
    pub(crate) fn predicted(&self, position: Position) -> Array2<f64> {
        self.basis.stamp(&self.coefficients_at(position))
    }

    /// Whether the field has all derivatives, as far as the PSFs tell.
    pub(crate) fn is_smooth(&self) -> bool {
        self.fitted().parameters().kernel() == KrigingKernel::Gaussian
    }

    /// The error that kriging expects at a position: relative to the norm of the predicted PSF, in L2.
    pub(crate) fn expected(&self, position: Position) -> f64 {
        let expected = self.fitted().expected_errors(&[position]);
        let expected = expected.expect("positions on the field are in range");
        expected[0] * self.weight(position)
    }

    /// The inverse of the norm of the predicted PSF.
    fn weight(&self, position: Position) -> f64 {
        let squares = self.coefficients_at(position).iter().map(|c| c * c).sum::<f64>();
        if squares > 0.0 {
            squares.sqrt().recip()
        } else {
            0.0
        }
    }

    /// The candidates with the largest expected errors, at most `count`, and these errors: relative to
    /// the norms of the predicted PSFs, in L2.
    pub(crate) fn least_known(
        &self,
        candidates: &[Position],
        count: usize,
    ) -> Result<Vec<(Position, f64)>, CoeffFieldError> {
        let weights: Vec<f64> = candidates.iter().map(|&position| self.weight(position)).collect();
        let chosen = self.fitted().least_known(candidates, &weights, count)?;
        Ok(chosen
            .into_iter()
            .map(|(i, expected)| (candidates[i], expected))
            .collect())
    }
}
