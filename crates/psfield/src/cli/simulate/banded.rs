//! Scenes larger than memory: rows from one FITS file to another.

use std::ops::Range;
use std::time::Instant;

use conv_core::{ConvReal, RowStream};
use ndarray::{ArrayView2, ArrayViewMut2};
use psf_io::{ImageReader, ImageWriter};
use psf_types::{Anchor, Scene};
use psfield::{PixelPicker, PsfieldError, Simulation};

/// Rows of the scene out of its file, rows of the image into theirs; and the pixels for the spot check as they pass.
pub(super) struct FitsRows<'a, T: ConvReal> {
    pub(super) reader: &'a mut ImageReader,
    pub(super) writer: ImageWriter<T>,
    pub(super) picker: PixelPicker,
    pub(super) read_seconds: f64,
    pub(super) write_seconds: f64,
}

impl<T: ConvReal> RowStream<T> for FitsRows<'_, T> {
    type Error = PsfieldError;

    fn read(&mut self, rows: Range<usize>, light: ArrayViewMut2<'_, T>) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        self.reader.read_rows_into(rows.start, light)?;
        self.read_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), PsfieldError> {
        let clock = Instant::now();
        for row in rows.outer_iter() {
            self.picker.pass(row.iter().map(|v| v.as_f64()));
        }
        self.writer.write_rows(rows)?;
        self.write_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }
}

/// Rows read at once for the direct sum.
const BAND: usize = 512;

/// The direct sum at pixels that are sorted by rows, with only the rows in memory that they need.
pub(super) fn exact_at<T: ConvReal>(
    simulation: &Simulation,
    reader: &mut ImageReader,
    scene: &Scene<T>,
    anchor: Anchor,
    pixels: &[(usize, usize)],
) -> Result<Vec<f64>, PsfieldError> {
    let mut sums = Vec::with_capacity(pixels.len());
    let mut rest = pixels;
    while let Some(&(_, first)) = rest.first() {
        let count = rest.partition_point(|&(_, row)| row < first + BAND);
        let last = rest[count - 1].1;
        let rows = simulation.rows_reaching(scene, first..=last);
        let light = reader.read_rows::<T>(rows.clone())?;
        sums.extend(simulation.exact_at_rows(
            scene,
            Some((light.view(), rows.start)),
            anchor,
            &rest[..count],
        )?);
        rest = &rest[count..];
    }
    Ok(sums)
}
