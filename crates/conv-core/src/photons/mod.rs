//! Drawing of faint sources photon by photon.
//!
//! The image of a source is a Poisson process: the counts of its pixels are independent, and their means are the
//! source's flux times the PSF `h`. The PSF of a source is a weighted mean of the PSFs at a few corners
//! ([`corners`]), divided by its flux if PSFs are scaled to unit flux. In a pixel, each of them is a sum of
//! coefficients times the weights of their taps, as for [stars](crate::stars): `h(u) = sum_t w_t c_{u,t}`.
//!
//! A photon chooses a corner, then a tap, then a coefficient of the tap's residue class, each in proportion to
//! its size ([`corner_table`], [`photon_draw`]). This proposes pixel `u` in proportion to `H(u) = sum_t |w_t c_{u,t}|`. It is
//! accepted with the probability `|h(u)| / H(u)`, and counts with the sign of `h(u)`: thinning of a Poisson
//! process (Lewis and Shedler 1979, Naval Research Logistics 26, 403). Where all terms are positive, nothing is
//! rejected, and `h(u)` need not be computed. The number of proposals is a Poisson deviate.
//!
//! So the mean of every pixel is exact, for any interpolation of the stamps. Its variance is the mean where the
//! PSFs at all corners are positive, and the weighted sum of their sizes elsewhere. The photons of an extended
//! source first get an offset that is drawn from its light ([`psf_types::RadialLight`]).
//!
//! Random numbers depend on a source's data and the run's seed alone ([`random`]), and counts are integers
//! ([`counts`]). So the image does not depend on threads, on the region or on the order of the sources.

mod alias;
mod choice;
mod corner_table;
mod corners;
mod counts;
mod photon_draw;
mod photon_shooter;
mod random;
mod shot;
mod wing_photons;

pub use choice::ExpectedPhotons;
pub(crate) use choice::{SharedWork, photons_to_shoot_below};
pub(crate) use photon_shooter::PhotonShooter;
pub use photon_shooter::{PhotonReport, PhotonSources};
pub(crate) use wing_photons::add_photons_of_light;
