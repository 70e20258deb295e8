//! The weights of a field's samples over the frame, as a few functions for each block.

use std::sync::{Arc, OnceLock};

use ndarray::{Array2, Array3};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, Normalisation, PixelRegion, Progress, PsfBasis, PsfModel,
    StampGrid, ToleranceOn,
};
use rayon::prelude::*;

use super::Plan;
use super::block::Block;
use super::coefficient_table::CoefficientTable;
use super::polynomials::Polynomials;
use super::psf_space::PsfSpace;
use crate::kept::get_or_make;
use crate::{ConvError, ConvReal, view};

/// The weights `w_j(x)` of samples over the frame of a plan: a linear interpolation of any values `v_j`
/// of the samples is `v(x) = sum_j w_j(x) v_j`.
///
/// In each block of the plan, the weights are sums of a few functions, `w_j(x) = sum_m f_m(x) s_mj`. At each
/// position, the error of all weights together is at most the plan's tolerance times their L2 norm. So
/// products with weights leave no direction out, whatever the modes of the plan are.
#[derive(Debug)]
pub struct SampleWeights<T> {
    pub(crate) blocks: Vec<BlockWeights<T>>,
    samples: usize,
}

/// The weights of samples in a block.
#[derive(Debug)]
pub(crate) struct BlockWeights<T> {
    /// The shares `s` `[function, sample]`.
    pub(crate) shares: Array2<f64>,
    pub(crate) functions: Functions<T>,
}

/// The functions of which weights are sums.
#[derive(Debug)]
pub(crate) enum Functions<T> {
    /// Functions that are bilinear in cells, for weights with kinks between them.
    Table(Arc<CoefficientTable<T>>),
    /// Polynomials, for smooth weights. They would need many small cells.
    Polynomials(Polynomials<T>),
}

impl<T: ConvReal> SampleWeights<T> {
    /// The weights of the samples of a field over the frame of a plan. `unit_field` interpolates the unit
    /// matrix: its component `j` is the weight of sample `j`. Everywhere, the weights must have the sum 1.
    ///
    /// # Errors
    /// [`ConvError::Cancelled`].
    ///
    /// # Panics
    /// If the field has no components.
    pub fn new(
        plan: &Plan<T>,
        unit_field: Arc<dyn CoefficientField>,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let samples = unit_field.component_count();
        let tolerance = plan.options().tolerance_in::<T>();
        let pixel = view::region(plan.geometry.weighted.x0(), plan.geometry.weighted.y0(), (1, 1));
        let is_smooth = matches!(
            unit_field.bilinear_cells(pixel, ErrorLimit::ZERO),
            BilinearCells::Unknown { .. }
        );
        // Most smooth fields need no cells.
        let space = OnceLock::new();
        let blocks = plan.blocks.par_iter().with_max_len(1).map(|block| {
            progress.check_cancelled()?;
            let region = block.region();
            let polynomials = is_smooth
                .then(|| Polynomials::of_field(&*unit_field, region, tolerance))
                .flatten();
            if let Some((polynomials, shares)) = polynomials {
                return Ok(BlockWeights {
                    shares,
                    functions: Functions::Polynomials(polynomials),
                });
            }
            let space = get_or_make(&space, || space_of_weights(&unit_field));
            Ok(BlockWeights::by_cells(space, region, tolerance))
        });
        Ok(Self {
            blocks: blocks.collect::<Result<_, ConvError>>()?,
            samples,
        })
    }

    /// The number of samples.
    pub fn sample_count(&self) -> usize {
        self.samples
    }
}

/// The weights at each position as a PSF of one row, whose pixel `j` is the weight of sample `j`. So its flux
/// is 1.
fn space_of_weights(unit_field: &Arc<dyn CoefficientField>) -> PsfSpace {
    let samples = unit_field.component_count();
    let unit = Array2::<f64>::eye(samples).into_shape_with_order((samples, 1, samples));
    let stamps: Array3<f64> = unit.expect("row-major");
    let grid = StampGrid::new(samples, 1).expect("a field has components");
    let basis = PsfBasis::new(None, stamps, grid).expect("unit vectors are orthonormal");
    let model = PsfModel::new(&basis, Arc::clone(unit_field), Normalisation::Keep, None);
    PsfSpace::new(&[model.expect("as many components")], ToleranceOn::L2)
}

impl<T: ConvReal> BlockWeights<T> {
    fn by_cells(space: &PsfSpace, region: PixelRegion, tolerance: f64) -> Self {
        let block = Block::new(space, region, tolerance, true);
        Self {
            shares: block.directions(),
            functions: Functions::Table(block.table_or_new(space)),
        }
    }
}
