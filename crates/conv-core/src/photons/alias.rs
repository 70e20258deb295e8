//! Tables from which one of many values is drawn in constant time.

/// Writes the alias table of some weights (Walker 1977, ACM Trans. Math. Softw. 3, 253), by a sweep over light
/// and heavy weights at the same time (Huebschle-Schneider and Sanders 2019, ESA). A weight above the mean
/// lends a part of it to the slots of weights below the mean. So every slot holds one or two numbers, and all
/// slots have equal probabilities. `weights` are scaled to a mean of 1.
///
/// The upper half of a slot is the probability of its own number, the lower half is the other number.
pub(super) fn write_alias(weights: &mut [f32], slots: &mut [u64]) {
    let count = weights.len();
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    let scale = if total > 0.0 { count as f64 / total } else { 0.0 };
    for w in weights.iter_mut() {
        *w = (f64::from(*w) * scale) as f32;
    }
    let slot = |own: f32, other: usize| u64::from((own * ONE) as u32) << 32 | other as u64;
    let next = |from: usize, is_heavy: bool| {
        let mut i = from;
        while i < count && (weights[i] > 1.0) != is_heavy {
            i += 1;
        }
        i
    };
    let (mut light, mut heavy) = (next(0, false), next(0, true));
    let mut left = weights.get(heavy).map_or(0.0, |&w| f64::from(w));
    while heavy < count {
        if left > 1.0 {
            if light >= count {
                // Only rounding is left.
                break;
            }
            slots[light] = slot(weights[light], heavy);
            left -= 1.0 - f64::from(weights[light]);
            light = next(light + 1, false);
        } else {
            let following = next(heavy + 1, true);
            if following < count {
                slots[heavy] = slot(left as f32, following);
                left += f64::from(weights[following]) - 1.0;
            } else {
                slots[heavy] = slot(1.0, heavy);
            }
            heavy = following;
        }
    }
    while light < count {
        slots[light] = slot(1.0, light);
        light = next(light + 1, false);
    }
    while heavy < count {
        slots[heavy] = slot(1.0, heavy);
        heavy = next(heavy + 1, true);
    }
}

const ONE: f32 = (1_u64 << 32) as f32;

/// Draws a number from an alias table by a random word.
#[inline(always)]
pub(super) fn draw(slots: &[u64], random: u64) -> usize {
    let place = u128::from(random) * slots.len() as u128;
    let (number, fraction) = ((place >> 64) as usize, place as u64);
    let slot = slots[number];
    let (own, other) = (number as u64, slot & u64::from(u32::MAX));
    // Without a branch, which could not be predicted, so that the processor reads the slots of several photons at
    // the same time.
    let mask = u64::from(fraction >> 32 < slot >> 32).wrapping_neg();
    (other ^ ((own ^ other) & mask)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of weights in single precision, of which the heaviest is 50 times the mean.
    const ROUNDING: f64 = 1e-4;

    /// The probability of each number, from the slots, times their number.
    fn probabilities(slots: &[u64]) -> Vec<f64> {
        let mut sums = vec![0.0; slots.len()];
        for (number, slot) in slots.iter().enumerate() {
            let own = (slot >> 32) as f64 / f64::from(ONE);
            sums[number] += own;
            sums[(slot & u64::from(u32::MAX)) as usize] += 1.0 - own;
        }
        sums
    }

    #[test]
    fn probabilities_are_the_weights() {
        let peaked: Vec<f32> = (0..5000).map(|i| (-0.01 * i as f32).exp()).collect();
        let turned: Vec<f32> = peaked.iter().rev().copied().collect();
        let uneven: Vec<f32> = (0..977).map(|i| ((i * 7919) % 977) as f32).collect();
        for weights in [
            vec![1.0],
            vec![0.0, 3.0, 0.0],
            vec![2.0; 7],
            peaked,
            turned,
            uneven,
        ] {
            let mut slots = vec![0; weights.len()];
            write_alias(&mut weights.clone(), &mut slots);
            let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
            let scale = weights.len() as f64 / total;
            for (p, &w) in probabilities(&slots).iter().zip(&weights) {
                assert!((p - f64::from(w) * scale).abs() < ROUNDING, "{p} {w}");
            }
        }
    }
}
