//! Compares simulated objects with the truth, and remakes the figures and tables of the paper from
//! which psfield's method comes (Bai, Jia et al. 2025).
//!
//! [`Reproduction`] measures psfield's own survey telescope, whose optics give the true PSF at any
//! position. [`Validation`] compares a given model with given PSFs or with the stars of a frame.
//! Both give an [`Evaluation`], for which each object is measured in the same way in its simulated
//! and in its true image. Both also give a [`Document`] (sections, tables and figures), from which
//! one self-contained HTML page is made.
//!
//! The table defines the measures of an object. The first four rows describe an elliptical Gaussian
//! without background, which is fitted to the same window of both images. The Gaussian has
//! the axes `a >= b`, and `phi` is the angle of `a` from the x axis towards the y axis.
//!
//! | measure | definition |
//! |---|---|
//! | eccentricity | `sqrt(1 - b^2 / a^2)`, called ellipticity in the paper |
//! | `e1`, `e2` | distortion, `(a^2 - b^2) / (a^2 + b^2)` times `cos 2 phi`, `sin 2 phi` |
//! | FWHM | `2 sqrt(2 ln 2)` times the geometric mean of the two sigmas, in pixels of the frame |
//! | FWHM along rows, along columns | FWHM along x and along y of the Gaussian summed over the other axis: `2 sqrt(2 ln 2)` times `sqrt(C_xx)` and times `sqrt(C_yy)` of the covariance `C` |
//! | MAE, MSE, `relative_l2`, `max_over_peak`, `mae_over_mean` | differences of the two windows, as in [`Comparison`](metrics::Comparison) |

mod colour;
mod document;
mod evaluation;
mod frames;
mod model_rows;
mod object_figures;
mod object_row;
mod patch_comparison;
mod reproduction;
mod reproduction_document;
mod scenes;
mod validation;

pub use colour::{ColourComparison, ColourRow};
pub use document::{Document, NamedFigure, Section, Software};
pub use evaluation::{ErrorSummary, Evaluation, Spread, Target};
pub use frames::{FrameComparison, FrameRow};
pub use model_rows::ModelRow;
pub use object_row::{OBJECT_COLUMNS, ObjectRow};
pub use patch_comparison::GalaxyComparison;
pub use reproduction::{ObjectKind, Reproduction, ReproductionOptions, ToleranceRow};
pub use validation::{Validation, ValidationTruth};

pub use crate::plot::Histogram;
