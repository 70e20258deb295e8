//! What there is to convolve in a tile.

use crate::ConvReal;

/// The light of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Light {
    /// Pixels that are not zero.
    pub(crate) lit: usize,
    /// The largest absolute value.
    pub(crate) largest: f64,
    /// The sum of the absolute values.
    pub(crate) total: f64,
}

/// A transform spreads rounding noise of this part of a tile's light over all of it.
///
/// A pixel that outshines the tile's mean by more than `1 / (NOISE_GOAL)` of the precision is drawn by itself.
pub(crate) fn brightest_allowed<T: ConvReal>() -> f64 {
    // 256 in f32, 1e11 in f64: the noise stays below a few 1e-6 of the faint light in the one, 1e-5 in the other.
    3e-5 / T::epsilon().as_f64()
}

/// Independent sums, so that they fill a vector.
const LANES: usize = 16;

/// Looks at `rows` rows of `columns` pixels, `pitch` apart.
#[inline(always)]
pub(crate) fn look<T: ConvReal>(plane: &[T], pitch: usize, rows: usize, columns: usize) -> Light {
    let mut lit = [0_u32; LANES];
    let mut largest = [T::zero(); LANES];
    let mut total = 0.0;
    for row in plane.chunks(pitch).take(rows) {
        let mut sums = [T::zero(); LANES];
        // Rows are padded with zeros to whole vectors.
        for chunk in row[..columns.next_multiple_of(LANES).min(row.len())].chunks_exact(LANES) {
            for i in 0..LANES {
                let value = chunk[i].abs();
                lit[i] += u32::from(value != T::zero());
                largest[i] = if value > largest[i] { value } else { largest[i] };
                sums[i] += value;
            }
        }
        total += sums.iter().map(|v| v.as_f64()).sum::<f64>();
    }
    Light {
        lit: lit.iter().map(|&n| n as usize).sum(),
        largest: largest.iter().map(|v| v.as_f64()).fold(0.0, f64::max),
        total,
    }
}

/// A pixel of a tile: row, column and light.
pub(crate) type LitPixel<T> = (usize, usize, T);

/// All lit pixels.
pub(crate) fn lit_pixels<T: ConvReal>(
    plane: &[T],
    pitch: usize,
    rows: usize,
    columns: usize,
) -> Vec<LitPixel<T>> {
    let mut pixels = Vec::new();
    for (row, values) in plane.chunks(pitch).take(rows).enumerate() {
        let lit = values[..columns].iter().enumerate().filter(|(_, v)| !v.is_zero());
        pixels.extend(lit.map(|(column, &value)| (row, column, value)));
    }
    pixels
}

/// Takes the pixels out of a tile that would drown the rest of it in the noise of a transform, the brightest first; at most
/// `most` of them.
pub(crate) fn take_bright<T: ConvReal>(
    plane: &mut [T],
    pitch: usize,
    (rows, columns): (usize, usize),
    mut light: Light,
    most: usize,
) -> Vec<LitPixel<T>> {
    let mut taken: Vec<LitPixel<T>> = Vec::new();
    loop {
        // The mean over the whole tile, dark pixels included, is what the noise is to be compared with.
        let limit = brightest_allowed::<T>() * light.total / (rows * columns) as f64;
        if light.lit <= 1 || light.largest <= limit {
            return taken;
        }
        let before = taken.len();
        for (row, values) in plane.chunks_mut(pitch).take(rows).enumerate() {
            for (column, value) in values[..columns].iter_mut().enumerate() {
                if value.abs().as_f64() > limit && taken.len() < most {
                    taken.push((row, column, *value));
                    *value = T::zero();
                }
            }
        }
        if taken.len() == before || taken.len() == most {
            return taken;
        }
        light = look(plane, pitch, rows, columns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bright_pixels_are_taken_until_the_rest_is_even() {
        let (pitch, rows, columns) = (48, 30, 20);
        let mut plane = vec![0.0_f32; pitch * rows];
        for row in 0..rows {
            for column in 0..columns {
                plane[row * pitch + column] = 1.0;
            }
        }
        plane[3 * pitch + 4] = 1e8;
        plane[5 * pitch + 6] = -1e5;
        let light = look(&plane, pitch, rows, columns);
        assert_eq!((light.lit, light.largest), (600, 1e8));
        let taken = take_bright(&mut plane, pitch, (rows, columns), light, 10);
        assert_eq!(taken, [(3, 4, 1e8), (5, 6, -1e5)]);
        let light = look(&plane, pitch, rows, columns);
        assert_eq!((light.lit, light.largest, light.total), (598, 1.0, 598.0));
        assert!(take_bright(&mut plane, pitch, (rows, columns), light, 10).is_empty());
        assert_eq!(lit_pixels(&plane, pitch, rows, columns).len(), 598);
    }
}
