//! Interpolation of PSF coefficients over the field of view.
//!
//! A basis turns each PSF sample into `K` coefficients. This crate interpolates them from the
//! samples' positions to every position of the field:
//!
//! ```text
//! a_k(x) = sum_n w_n(x) v_nk
//! ```
//!
//! Here `w_n(x)` is the weight of node `n` at the position `x`, and `v_nk` is the value of
//! coefficient `k` (component `k`) at this node. Nodes are the samples, the terms of a polynomial,
//! or the corners of cells. All interpolators here are linear in the sample values. So a position needs
//! one list of (node, weight) pairs for all components, and no cube of coefficients is stored. The list
//! is short, except for [`Kriging`].
//!
//! | method | weights per position | at the samples | reproduces | continuity |
//! |---|---|---|---|---|
//! | [`Bilinear`] | 4 | exact | 1, x, y, xy | continuous |
//! | [`Bicubic`] | 16 | exact | 1, x, y, xy; x^i y^j (i, j <= 3) at fifths of cells | continuous |
//! | [`Delaunay`] | 3 | exact | 1, x, y | continuous |
//! | [`NaturalNeighbour`] | 4 | exact | 1, x, y, nearly parabolas | continuous |
//! | [`InverseDistance`] | 4 | exact | 1 | continuous |
//! | [`Polynomial`] | (d+1)(d+2)/2 | least squares | polynomials of degree d | smooth |
//! | [`Nearest`] | 1 | exact | 1 | jumps |
//! | [`Table`] | 25 | exact | x^i y^j (i, j <= 4) | up to the error of the table |
//! | [`Kriging`] | all | exact up to the nugget | the trend | smooth |
//!
//! A [`FieldInterpolation`] is a method with its parameters. It makes a
//! [`psf_types::CoefficientField`] from samples. Methods with few weights return an
//! [`InterpolatedField`], which combines [`FieldWeights`] with the samples' values. Other crates can
//! implement these traits. [`interpolation`] returns the method for a [`psf_types::Interpolation`], and
//! [`choose`] finds the method that predicts the samples best from each other.
//!
//! # Fields of your own
//! A field may be anything, and need not be linear in the samples' values. [`tabulate`] and
//! [`tabulate_field`] store any smooth field as the nodes of a [`Table`], up to an error that is checked at
//! points. Files can hold the table.
//!
//! # Outside the samples
//! The caller chooses a [`psf_types::OutsidePolicy`]. Each method documents its effect. Positions
//! count as inside up to 1e-9 of the samples' extent (at least 1e-9 pixels) beyond the covered
//! area, so that rounding at an edge causes no error.
//!
//! # Accuracy
//! Weights of local methods are finite. They sum to 1 within 1e-12 of the sum of their magnitudes, except
//! in a [`Polynomial`], and far outside a tree of cells under the policy extend, where large weights of a
//! cell's corners cancel. All methods reproduce constants. The geometry uses coordinates relative to
//! the requested position, so weights stay precise at large coordinates and in tight clusters of
//! samples. ([`NaturalNeighbour`] states an exception.) Coordinates may have magnitudes up to 1e50
//! pixels. The values at a position have identical bits in every thread, and for any region or
//! range of components that is evaluated.
//!
//! # Cells
//! [`psf_types::CoefficientField::bilinear_cells`] divides a region into cells in which the coefficients are
//! bilinear, up to an error. The cost of convolution then grows with the number of cells, not of
//! pixels. Cells are those of the grid ([`Bilinear`]), or parts of them where the error requires it
//! ([`Bicubic`]). A [`Polynomial`] has cells as large as its second derivatives allow.
//! [`NaturalNeighbour`] and [`InverseDistance`] have the cells of a tree.
//!
//! [`Delaunay`] and [`Nearest`] have runs instead: [`FieldWeights::weights_along_row`] cuts a row where
//! it enters another triangle or Voronoi cell. Positions with nonlinear weights are visited pixel by
//! pixel, such as positions in very flat triangles, or outside [`Delaunay`]'s samples under the policy
//! extend.
//!
//! # Tree of cells
//! The curvature of natural neighbour weights and of inverse distance weights has no bound: at a sample
//! it is infinite. So these interpolators are defined on a tree of cells: they give the values at the
//! cells' corners, and values are bilinear in each cell. Sides of cells are at most 0.8 times the
//! distance to the third nearest sample. Then the values at corners are changed, so that errors in
//! cells are about 0 in the mean and, up to rounding, exactly 0 at the samples. For 500 samples of a
//! telescope (the preset `survey-2m`), natural neighbours are off by 1.0e-3 (r.m.s., relative L2 of
//! PSFs). With cells of an eighth of the size they would be off by 7e-4. The tree covers the samples
//! and their frame, and under the policy extend half of their extent beyond. Farther outside, the
//! policies are those of a grid ([`Bilinear`]).
//!
//! # Wavelengths, times and frames
//! A PSF may also depend on a wavelength, a time or a frame: its *state*. A field belongs to one
//! state. [`mix_states`] makes the coefficients of a wavelength between two samples, or the mean over
//! a spectrum, because both are weighted sums of the states' coefficients ([`state_weights`]).
//!
//! # Measuring the error
//! [`leave_one_out`] predicts every sample from all others.
//!
//! ```
//! use coeff_field::{FieldInterpolation, NaturalNeighbour, leave_one_out};
//! use ndarray::Array2;
//! use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
//!
//! // A quadratic over scattered samples.
//! let positions: Vec<Position> = (0..100)
//!     .map(|i| Position::new(f64::from(i % 10) * 10.0 + f64::from(i * 7 % 5), f64::from(i / 10) * 10.0))
//!     .collect::<Result<_, _>>()?;
//! let values = Array2::from_shape_fn((100, 1), |(i, _)| positions[i].x() * positions[i].y() / 1e4);
//! let samples = SampleCoefficients::new(values, SamplePositions::new(positions, None)?)?;
//!
//! let field = NaturalNeighbour.interpolate(&samples, OutsidePolicy::Nearest)?;
//! let mut a = [0.0];
//! field.evaluate_into(Position::new(45.0, 45.0)?, &mut a)?;
//! assert!((a[0] - 0.2025).abs() < 0.002);
//!
//! let errors = leave_one_out(&samples, &NaturalNeighbour, OutsidePolicy::Nearest)?;
//! assert!(errors.rms().unwrap() < 0.005);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod axis_weights;
mod bilinear;
mod boundary;
mod choice;
mod delaunay;
mod error;
mod field;
mod geometry;
mod grid;
mod interpolation;
mod kriging;
mod lattice;
mod lattice_values;
mod line;
mod mesh;
mod neighbours;
mod polynomial;
mod search_tree;
mod states;
mod table;
mod triangles;

pub use {ndarray, psf_types};

pub use axis_weights::state_weights;
pub use bilinear::{Bicubic, Bilinear};
pub use choice::{Auto, Choice, Smoothed, choose, interpolation, local_method};
pub use delaunay::{Delaunay, NaturalNeighbour};
pub use error::CoeffFieldError;
pub use field::InterpolatedField;
pub use grid::RegularGrid;
pub use interpolation::{
    FieldInterpolation, FieldWeights, LeaveOneOut, LeftOut, Unpredictable, WeightList, leave_one_out,
};
pub use kriging::{Kriging, KrigingFit, NoisyKrigingFit};
pub use neighbours::{InverseDistance, Nearest};
pub use polynomial::Polynomial;
pub use states::mix_states;
pub use table::{Table, TableOptions, tabulate, tabulate_field};
