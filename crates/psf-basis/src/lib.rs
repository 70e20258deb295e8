//! PSF bases: a few orthonormal stamps and the samples' coefficients, computed from samples of a
//! PSF.
//!
//! A sample `h_j` (a stamp) is approximated by `B_0(u) + sum_k a_jk B_k(u)` at pixel `u`, with a
//! mean stamp `B_0` (absent if the basis is not centred) and orthonormal stamps `B_k`. A
//! [`BasisMethod`] finds these stamps and the coefficients `a_jk`. [`Svd`] uses the singular value
//! decomposition, [`WeightedPca`] is for samples with bad pixels or very different noise, and
//! [`GivenStamps`] uses stamps from elsewhere. Implement the trait for other methods.
//!
//! # Choosing the rank
//! [`RankSelection`] selects the number of components. Every fit by [`Svd`] reports its
//! [`Spectrum`]:
//!
//! * **Elbow** of the cumulative-weight curve `c_k = sum_{i<=k} s_i / sum_i s_i` of the `m`
//!   singular values `s_i`: the point furthest above the chord from `(0, 0)` to `(m, 1)`
//!   ("Kneedle", Satopaa et al. 2011). If the singular values fall by more than a factor of 1000
//!   from one to the next within the first half of the curve, the elbow is at that cliff.
//! * **Noise**: white noise of standard deviation sigma, in `P` samples of `L` pixels, has singular
//!   values up to `sigma (sqrt L + sqrt P)`, the noise edge. The noise is given or estimated
//!   ([`PixelNoise`]). Noise alone stays below a threshold near the edge in 99 % of cases. The
//!   elbow keeps no component below the threshold. If the noise level differs from
//!   sample to sample, as between bright and faint stars, the edge is computed for this uneven
//!   noise. The threshold is then 2 % above the edge.
//! * **Smoothness**: where noise limits the rank, `auto` also keeps components below the threshold that
//!   vary smoothly over the field. It finds them in the samples' sums weighted by polynomials in x and y,
//!   where the noise is much smaller ([`Spectrum::smooth`]).
//!
//! # Normalisation
//! Stamps are used as they are. If the samples have unit flux and are mean-centred, every component
//! has zero flux, so that any truncation preserves the flux. Therefore scale samples first
//! ([`psf_types::PsfSamples::into_unit_flux`]).

mod circles;
mod components;
mod decomposition;
mod fit;
mod noise;
mod rank;
mod smooth;
mod weighted;

pub use {ndarray, psf_types};

pub use decomposition::{BasisError, orthonormal, orthonormal_in_order};
pub use fit::{BasisFit, BasisMethod, Centring, GivenStamps, Svd, project};
pub use noise::PixelNoise;
pub use rank::{RankSelection, Spectrum};
pub use weighted::WeightedPca;
