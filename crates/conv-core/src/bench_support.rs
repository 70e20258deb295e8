//! Private pieces for the benches of this crate: no part of its interface.

use psf_types::{PixelRegion, PsfModel};

use crate::ConvReal;
use crate::lowrank::internals::{Aligned, CoefficientTable, FluxRole, LocalModes, PsfSpace, RegionCells};
use crate::simd::{Lanes, WithIsa};
use crate::transform::TileTransform;

/// The transform of a square tile as large as it holds with a stamp, and the planes that it works in.
#[derive(Debug)]
pub struct SquareTransform<T: ConvReal> {
    fft: TileTransform<T>,
    /// Pixels along each side of the tile and of the stamp.
    sides: [usize; 2],
    plane: Aligned<T>,
    spectrum: Aligned<T>,
    kernel: Aligned<T>,
    sum: Aligned<T>,
    result: Aligned<T>,
    column: Aligned<T>,
}

/// A step of a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The light's spectrum.
    Forward,
    /// The stamp's.
    Kernel,
    /// Their product, added to a sum.
    Multiply,
    /// Back to pixels. Overwrites the sum.
    Inverse,
}

impl<T: ConvReal> SquareTransform<T> {
    /// Transforms of `size x size` values, a multiple of 32 without prime factors above 5, with stamps of `stamp x stamp` pixels.
    pub fn new(size: usize, stamp: usize) -> Self {
        let fft = TileTransform::new(size, size);
        let length = fft.plane_len().max(fft.spectrum_len());
        let zeros = || Aligned::zeros(length);
        let mut plane = zeros();
        for (i, value) in plane.get_mut().iter_mut().enumerate() {
            *value = T::nearest((i % 17) as f64);
        }
        Self {
            column: Aligned::zeros(fft.column_len()),
            sides: [size + 1 - stamp, stamp],
            plane,
            spectrum: zeros(),
            kernel: zeros(),
            sum: zeros(),
            result: zeros(),
            fft,
        }
    }

    /// Does a step with the best instruction set of this machine, on this thread.
    pub fn run(&mut self, step: Step) {
        T::dispatch(Run(self, step));
    }
}

struct Run<'a, T: ConvReal>(&'a mut SquareTransform<T>, Step);

impl<T: ConvReal> WithIsa<T> for Run<'_, T> {
    type Output = ();
    fn run<S: Lanes<T>>(self, simd: S) {
        let Self(all, step) = self;
        let [tile, stamp] = all.sides;
        let (plane, column) = (all.plane.get(), all.column.get_mut());
        simd.vectorized(
            #[inline(always)]
            || match step {
                Step::Forward => all
                    .fft
                    .forward(simd, plane, (tile, tile), all.spectrum.get_mut(), column),
                Step::Kernel => all
                    .fft
                    .forward(simd, plane, (stamp, stamp), all.kernel.get_mut(), column),
                Step::Multiply => all.fft.multiply_swapped(
                    simd,
                    all.spectrum.get(),
                    all.kernel.get(),
                    all.sum.get_mut(),
                    true,
                ),
                Step::Inverse => {
                    let size = (tile + stamp - 1, tile + stamp - 1);
                    all.fft
                        .inverse_of_swapped(simd, all.sum.get_mut(), size, all.result.get_mut(), column);
                }
            },
        );
    }
}

/// What a block of tiles needs before any light comes.
#[derive(Debug)]
pub struct BlockSteps<T: ConvReal> {
    model: PsfModel,
    space: PsfSpace,
    region: PixelRegion,
    tolerance: f64,
    cells: RegionCells,
    modes: LocalModes,
    role: FluxRole,
    table: CoefficientTable<T>,
    ramp: Vec<T>,
}

impl<T: ConvReal> BlockSteps<T> {
    /// The steps for a region of a model's field, all of them done once.
    pub fn new(model: &PsfModel, region: PixelRegion, tolerance: f64) -> Self {
        let space = PsfSpace::new(model);
        let cells = RegionCells::new(model.field(), region);
        let modes = LocalModes::new(&space, &cells, tolerance);
        let (role, _) = FluxRole::of(model, &modes, &cells);
        Self {
            table: CoefficientTable::new(region, role, &modes, &cells),
            ramp: (0..region.shape().nx()).map(|i| T::nearest(i as f64)).collect(),
            model: model.clone(),
            space,
            region,
            tolerance,
            cells,
            modes,
            role,
        }
    }

    /// The weights of the field's nodes along the region's rows.
    pub fn weights_along_rows(&mut self) {
        self.cells = RegionCells::new(self.model.field(), self.region);
    }

    /// The modes.
    pub fn local_modes(&mut self) {
        self.modes = LocalModes::new(&self.space, &self.cells, self.tolerance);
    }

    /// Their coefficients over the region.
    pub fn coefficients(&mut self) {
        self.table = CoefficientTable::new(self.region, self.role, &self.modes, &self.cells);
    }

    /// The region's light `[y, x]` times the coefficient of the last mode.
    pub fn weigh(&self, light: &[T], weighted: &mut [T]) {
        T::dispatch(Weigh(self, light, weighted));
    }
}

struct Weigh<'a, T: ConvReal>(&'a BlockSteps<T>, &'a [T], &'a mut [T]);

impl<T: ConvReal> WithIsa<T> for Weigh<'_, T> {
    type Output = ();
    fn run<S: Lanes<T>>(self, simd: S) {
        let Self(block, light, weighted) = self;
        let nx = block.region.shape().nx();
        let last = block.table.kernel_count() - 1;
        simd.vectorized(
            #[inline(always)]
            || {
                let rows = light.chunks_exact(nx).zip(weighted.chunks_exact_mut(nx));
                for (row, (light, weighted)) in rows.enumerate() {
                    block.table.weigh(last, row, 0, light, &block.ramp, weighted);
                }
            },
        );
    }
}
