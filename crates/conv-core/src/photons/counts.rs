//! Counts of photons in the pixels of an image, which several threads add to.

use std::sync::Mutex;

use ndarray::{ArrayViewMut2, Axis, s};
use psf_types::PixelRegion;

/// The counts of a region of the frame, in bands of rows. Counts are integers, so their sum does not depend on
/// the order in which threads add them.
pub(super) struct SharedCounts<'a> {
    bands: Vec<Mutex<ArrayViewMut2<'a, i32>>>,
    /// Columns and rows.
    shape: [usize; 2],
}

/// The counts of some sources: those near the sources in an array, those far from them in a list.
pub(super) struct SourceCounts {
    /// The first column and row of the array, and its columns and rows, in pixels of the region.
    first: [i32; 2],
    size: [usize; 2],
    near: Vec<i32>,
    /// Row, column and count.
    far: Vec<(u32, u32, i32)>,
    region: [usize; 2],
    pub(super) photons: u64,
    pub(super) counted: i64,
}

/// The rows of a band.
const BAND: usize = 64;
/// An array pays if it has at most so many pixels for each photon.
const PIXELS_PER_PHOTON: f64 = 32.0;

impl<'a> SharedCounts<'a> {
    pub(super) fn new(image: ArrayViewMut2<'a, i32>) -> Self {
        let (rows, columns) = image.dim();
        let mut bands = Vec::new();
        let mut rest = image;
        while rest.nrows() > 0 {
            let rows = BAND.min(rest.nrows());
            let (band, after) = rest.split_at(Axis(0), rows);
            bands.push(Mutex::new(band));
            rest = after;
        }
        Self {
            bands,
            shape: [columns, rows],
        }
    }

    /// Counts of sources whose photons mostly fall into `area`, in pixels of the region, and which are
    /// expected to have so many photons. They use the memory of `near`.
    pub(super) fn for_sources(&self, area: PixelRegion, photons: f64, mut near: Vec<i32>) -> SourceCounts {
        let along = |first: i64, length: usize, limit: usize| {
            let end = (first + length as i64).clamp(0, limit as i64);
            let first = first.clamp(0, end);
            (first as i32, (end - first) as usize)
        };
        let (x, mut nx) = along(area.x0(), area.shape().nx(), self.shape[0]);
        let (y, mut ny) = along(area.y0(), area.shape().ny(), self.shape[1]);
        if (nx * ny) as f64 > PIXELS_PER_PHOTON * photons {
            (nx, ny) = (0, 0);
        }
        near.clear();
        near.resize(nx * ny, 0);
        SourceCounts {
            first: [x, y],
            size: [nx, ny],
            near,
            far: Vec::new(),
            region: self.shape,
            photons: 0,
            counted: 0,
        }
    }

    /// Adds counts, and returns the memory of those near the sources.
    pub(super) fn add(&self, mut counts: SourceCounts) -> Vec<i32> {
        let [columns, rows] = counts.size;
        let [x, y] = counts.first.map(|first| first as usize);
        for (number, band) in self.bands.iter().enumerate() {
            let start = number * BAND;
            let (from, to) = (y.max(start), (y + rows).min(start + BAND));
            if from >= to || columns == 0 {
                continue;
            }
            let mut band = band.lock().expect("no thread panics while it adds");
            for row in from..to {
                let near = &counts.near[(row - y) * columns..][..columns];
                let mut into = band.slice_mut(s![row - start, x..x + columns]);
                match into.as_slice_mut() {
                    Some(into) => into.iter_mut().zip(near).for_each(|(sum, v)| *sum += v),
                    None => into.iter_mut().zip(near).for_each(|(sum, v)| *sum += v),
                }
            }
        }
        counts.far.sort_unstable();
        for of_band in counts
            .far
            .chunk_by(|a, b| a.0 as usize / BAND == b.0 as usize / BAND)
        {
            let number = of_band[0].0 as usize / BAND;
            let mut band = self.bands[number].lock().expect("no thread panics while it adds");
            for &(row, column, count) in of_band {
                band[[row as usize - number * BAND, column as usize]] += count;
            }
        }
        counts.near
    }
}

impl SourceCounts {
    /// Counts a photon in a pixel, if the pixel lies in the region.
    #[inline(always)]
    pub(super) fn count(&mut self, [x, y]: [i32; 2], sign: i32) {
        self.photons += 1;
        let [column, row] = [
            x.wrapping_sub(self.first[0]) as u32,
            y.wrapping_sub(self.first[1]) as u32,
        ];
        if (column as usize) < self.size[0] && (row as usize) < self.size[1] {
            self.near[row as usize * self.size[0] + column as usize] += sign;
            self.counted += i64::from(sign);
        } else if (x as u32 as usize) < self.region[0] && (y as u32 as usize) < self.region[1] {
            self.far.push((y as u32, x as u32, sign));
            self.counted += i64::from(sign);
        }
    }
}
