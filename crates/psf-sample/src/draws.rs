//! Drawing many PSFs at once.

use std::collections::HashMap;

use ndarray::{Array2, Array3, Axis};
use psf_types::{Position, Progress, PsfSamples, PsfSource, SamplePositions, Stamp};
use rayon::prelude::*;

use crate::SampleError;
use crate::mesh::Node;

/// One checked PSF: finite, with light.
pub(crate) fn draw(source: &dyn PsfSource, position: Position) -> Result<Array2<f64>, SampleError> {
    draw_shifted(source, position, (0.0, 0.0))
}

pub(crate) fn draw_shifted(
    source: &dyn PsfSource,
    position: Position,
    shift: (f64, f64),
) -> Result<Array2<f64>, SampleError> {
    let grid = source.grid();
    let mut values = Array2::zeros(grid.dim());
    let drawn = if shift == (0.0, 0.0) {
        source.draw_into(position, values.view_mut())
    } else {
        source.draw_shifted_into(position, shift, values.view_mut())
    };
    drawn.map_err(|source| SampleError::Draw { position, source })?;
    let stamp = Stamp::new(values, grid).map_err(|source| SampleError::Stamp { position, source })?;
    let flux = stamp.flux();
    if flux > 0.0 {
        Ok(stamp.into_values())
    } else {
        Err(SampleError::NoLight { position, flux })
    }
}

/// Draws in parallel; the first error in the order of the positions wins, whatever the threads did.
pub(crate) fn draw_all(
    source: &dyn PsfSource,
    positions: &[Position],
    progress: &dyn Progress,
) -> Result<Vec<Array2<f64>>, SampleError> {
    let drawn: Vec<_> = positions
        .par_iter()
        .map(|&position| {
            let stamp = draw(source, position);
            progress.advance(1);
            stamp
        })
        .collect();
    drawn.into_iter().collect()
}

/// Every PSF drawn so far, by its place on the mesh.
#[derive(Debug, Default)]
pub(crate) struct DrawnStamps {
    stamps: HashMap<Node, Array2<f64>>,
    announced: u64,
}

impl DrawnStamps {
    pub(crate) fn get(&self, node: Node) -> &Array2<f64> {
        &self.stamps[&node]
    }

    /// PSFs drawn, each once.
    pub(crate) fn count(&self) -> usize {
        self.stamps.len()
    }

    /// Draws those of `nodes` that are not here yet. `position` maps a node to the field.
    pub(crate) fn add(
        &mut self,
        source: &dyn PsfSource,
        nodes: impl Iterator<Item = Node>,
        position: impl Fn(Node) -> Result<Position, SampleError>,
        progress: &dyn Progress,
    ) -> Result<(), SampleError> {
        let mut missing: Vec<Node> = nodes.filter(|n| !self.stamps.contains_key(n)).collect();
        missing.sort_unstable();
        missing.dedup();
        if missing.is_empty() {
            return Ok(());
        }
        self.announced += missing.len() as u64;
        progress.start(self.announced);
        let positions = missing
            .iter()
            .map(|&n| position(n))
            .collect::<Result<Vec<_>, _>>()?;
        let drawn = draw_all(source, &positions, progress)?;
        self.stamps.extend(missing.into_iter().zip(drawn));
        Ok(())
    }

    /// The samples at `nodes`, in that order.
    pub(crate) fn into_samples(
        mut self,
        source: &dyn PsfSource,
        nodes: &[Node],
        position: impl Fn(Node) -> Result<Position, SampleError>,
    ) -> Result<PsfSamples, SampleError> {
        let taken: Vec<_> = nodes
            .iter()
            .map(|n| self.stamps.remove(n).expect("samples are drawn"))
            .collect();
        drop(self);
        let positions = nodes
            .iter()
            .map(|&n| position(n))
            .collect::<Result<Vec<_>, _>>()?;
        into_samples(source, positions, taken)
    }
}

/// Samples from stamps and positions of a source.
pub(crate) fn into_samples(
    source: &dyn PsfSource,
    positions: Vec<Position>,
    stamps: Vec<Array2<f64>>,
) -> Result<PsfSamples, SampleError> {
    let (ny, nx) = source.grid().dim();
    let mut stack = Array3::zeros((stamps.len(), ny, nx));
    // Each stamp is freed as it is copied, so that the stack comes on top of less and less.
    for (mut plane, stamp) in stack.axis_iter_mut(Axis(0)).zip(stamps) {
        plane.assign(&stamp);
    }
    let positions = SamplePositions::new(positions, Some(source.field()))?;
    Ok(PsfSamples::new(stack, positions, source.grid())?)
}
