//! Cubic B-splines.

/// ... 2 1 | 0 1 2 ... n-1 | n-2 n-3 ...
pub(crate) fn mirror(index: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let last = length as i64 - 1;
    let folded = index.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// From samples to B-spline coefficients, in place.
pub(crate) fn prefilter(line: &mut [f64]) {
    let n = line.len();
    if n == 1 {
        return;
    }
    let pole = 3f64.sqrt() - 2.0;
    // The causal filter's start: the sum over the mirrored line, which repeats after 2n - 2.
    let period = 2 * n - 2;
    let mut start = 0.0;
    let mut power = 1.0;
    for k in 0..period {
        start += power * line[mirror(k as i64, n)];
        power *= pole;
        if power == 0.0 {
            break;
        }
    }
    line[0] = start / (1.0 - power);
    for k in 1..n {
        line[k] += pole * line[k - 1];
    }
    line[n - 1] = pole / (pole * pole - 1.0) * (line[n - 1] + pole * line[n - 2]);
    for k in (0..n - 1).rev() {
        line[k] = pole * (line[k + 1] - line[k]);
    }
    for c in line {
        *c *= 6.0;
    }
}
