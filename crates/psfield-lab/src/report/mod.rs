//! Errors of simulated objects against the truth: the figures and tables of the method's paper,
//! remade.
//!
//! [`Reproduction`] measures psfield's own survey telescope, whose optics give the true PSF at any
//! position. [`Validation`] compares a given model with given PSFs or with a frame with stars. Both
//! give an [`Evaluation`] of objects, each measured twice in the same way, and a [`Document`]:
//! sections, tables and figures, from which one self-contained HTML page is made.
//!
//! Measures of an object (an elliptical Gaussian without background, fitted to the same window of
//! both images):
//!
//! | measure | definition |
//! |---|---|
//! | ellipticity | `e = sqrt(1 - b^2 / a^2)` of the axes `a >= b`, as the paper has it |
//! | `e1`, `e2` | distortion, `(a^2 - b^2) / (a^2 + b^2)` times `cos 2 phi`, `sin 2 phi` |
//! | FWHM | `2 sqrt(2 ln 2)` times the geometric mean of the two sigmas, in pixels |
//! | FWHM along rows, columns | the same of the Gaussian summed along the other axis: `sqrt(C_xx)`, `sqrt(C_yy)` of its covariance |
//! | FWHM along rows, columns | FWHM of the Gaussian summed along the other axis: `sqrt(C_xx)`, `sqrt(C_yy)` of its covariance |

mod document;
mod evaluation;
mod model_rows;
mod object_figures;
mod object_row;
mod patch_comparison;
mod reproduction;
mod reproduction_document;
mod scenes;
mod validation;

pub use document::{Document, NamedFigure, Section, Software, Table};
pub use evaluation::{ErrorSummary, Evaluation, Spread, Target};
pub use model_rows::{InterpolationRow, ModelRow};
pub use object_row::{OBJECT_COLUMNS, ObjectRow};
pub use patch_comparison::{GalaxyComparison, PatchComparison};
pub use reproduction::{BasisFigures, ObjectKind, Reproduction, ReproductionOptions, ToleranceRow};
pub use validation::{Validation, ValidationTruth};

pub use crate::plot::Histogram;
