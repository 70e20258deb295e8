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

/// By how much a pixel may outshine the mean of a tile: a transform spreads rounding noise of a pixel's light over all of it.
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
        for (n, some) in values[..columns].chunks(LANES).enumerate() {
            // Most are dark: one look at all of them is faster than one at each.
            if some.iter().fold(false, |lit, v| lit | !v.is_zero()) {
                let lit = some.iter().enumerate().filter(|(_, v)| !v.is_zero());
                pixels.extend(lit.map(|(i, &value)| (row, n * LANES + i, value)));
            }
        }
    }
    pixels
}

/// Takes the pixels out of a tile that would drown the rest of it in the noise of a transform, at most `most` of them, the
/// brightest first.
///
/// What the noise is to be compared with is the mean over the whole tile without its `most` brightest pixels: a bright galaxy of a few
/// hundred pixels must not raise the level that it is judged by.
pub(crate) fn take_bright<T: ConvReal>(
    plane: &mut [T],
    pitch: usize,
    (rows, columns): (usize, usize),
    light: Light,
    most: usize,
) -> Vec<LitPixel<T>> {
    let pixels = (rows * columns) as f64;
    let contrast = brightest_allowed::<T>();
    // Where no pixel stands out, as in most fully lit tiles, this is all there is to do.
    if light.largest <= contrast * (light.total - most as f64 * light.largest) / pixels {
        return Vec::new();
    }
    let rest = match total_of_faint(plane, pitch, (rows, columns), most) {
        rest if rest > 0.0 => rest,
        // There is nothing but those few pixels; among themselves they are compared with their mean.
        _ => light.total,
    };
    let limit = contrast * rest / pixels;
    let mut taken: Vec<LitPixel<T>> = Vec::new();
    if light.lit <= 1 || light.largest <= limit {
        return taken;
    }
    for (row, values) in plane.chunks(pitch).take(rows).enumerate() {
        for (column, &value) in values[..columns].iter().enumerate() {
            if value.abs().as_f64() > limit {
                taken.push((row, column, value));
            }
        }
    }
    // The brightest of them; a stable sort, so that equals keep their order.
    taken.sort_by(|a, b| b.2.abs().as_f64().total_cmp(&a.2.abs().as_f64()));
    taken.truncate(most);
    for &(row, column, _) in &taken {
        plane[row * pitch + column] = T::zero();
    }
    taken
}

/// The sum of the absolute values without the brightest, of which there are at most `most`; to the nearest factor of 2 in
/// brightness.
fn total_of_faint<T: ConvReal>(
    plane: &[T],
    pitch: usize,
    (rows, columns): (usize, usize),
    most: usize,
) -> f64 {
    const EXPONENTS: usize = 1 << 11;
    let mut by_exponent = vec![(0_usize, 0.0_f64); EXPONENTS];
    for values in plane.chunks(pitch).take(rows) {
        for value in &values[..columns] {
            let value = value.abs().as_f64();
            let bin = &mut by_exponent[(value.to_bits() >> 52) as usize % EXPONENTS];
            bin.0 += 1;
            bin.1 += value;
        }
    }
    let mut bright = 0;
    let faint = by_exponent.iter().rev().skip_while(|(count, _)| {
        bright += count;
        bright <= most
    });
    faint.map(|(_, sum)| sum).sum()
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
        // A bright galaxy does not raise the level it is judged by; more of it than may be drawn stays where it is.
        for row in 10..14 {
            plane[row * pitch + 2..row * pitch + 5].fill(1e7);
        }
        let light = look(&plane, pitch, rows, columns);
        let mut copy = plane.clone();
        assert_eq!(
            take_bright(&mut copy, pitch, (rows, columns), light, 20).len(),
            12
        );
        assert_eq!(look(&copy, pitch, rows, columns).largest, 1.0);
        assert!(take_bright(&mut plane, pitch, (rows, columns), light, 8).len() <= 8);
        for row in 10..14 {
            plane[row * pitch + 2..row * pitch + 5].fill(1.0);
        }
        let light = look(&plane, pitch, rows, columns);
        assert!(take_bright(&mut plane, pitch, (rows, columns), light, 10).is_empty());
        assert_eq!(lit_pixels(&plane, pitch, rows, columns).len(), light.lit);
    }
}
