//! Limits from the slope of the sorted values.

/// Pixels looked at.
const SAMPLES: usize = 1000;
/// The slope is divided by it.
const CONTRAST: f64 = 0.25;
/// At least this part of the pixels, and this many, must follow the line.
const KEPT_PART: f64 = 0.5;
const KEPT_LEAST: usize = 5;
/// Pixels farther from the line than so many standard deviations are left out, ...
const REJECTION: f64 = 2.5;
/// ... in so many rounds, ...
const ROUNDS: usize = 5;
/// ... with this part of all pixels about them.
const GROWTH: f64 = 0.01;

/// Limits for finite values, one at least: IRAF's zscale in the form of astropy's `ZScaleInterval` with its defaults.
///
/// A line is fitted to the sorted samples against their rank; `slope` is that of the samples which follow it. The limits are
/// `median - (centre - 1) slope / contrast` and `median + (n - centre) slope / contrast`, within the lowest and the highest sample.
pub(super) fn zscale(values: &[f64]) -> (f64, f64) {
    let stride = (values.len() / SAMPLES).max(1);
    let mut samples: Vec<f64> = values.iter().copied().step_by(stride).take(SAMPLES).collect();
    samples.sort_by(f64::total_cmp);
    let n = samples.len();
    let (lowest, highest) = (samples[0], samples[n - 1]);
    let least = KEPT_LEAST.max((n as f64 * KEPT_PART) as usize);
    let Some(slope) = slope_of_most(&samples, least) else {
        return (lowest, highest);
    };
    let slope = slope / CONTRAST;
    let centre = (n - 1) / 2;
    let median = f64::midpoint(samples[centre], samples[n / 2]);
    (
        lowest.max(median - (centre as f64 - 1.0) * slope),
        highest.min(median + (n - centre) as f64 * slope),
    )
}

/// The slope, unless fewer than `least` samples follow a line.
fn slope_of_most(samples: &[f64], least: usize) -> Option<f64> {
    let n = samples.len();
    let growth = ((n as f64 * GROWTH) as usize).max(1);
    let mut rejected = vec![false; n];
    let (mut kept, mut kept_before) = (n, n + 1);
    let mut slope = None;
    for _ in 0..ROUNDS {
        if kept >= kept_before || kept < least {
            break;
        }
        let line = Line::through(samples, &rejected);
        let threshold = REJECTION * line.scatter(samples, &rejected);
        for (rank, (&value, rejected)) in samples.iter().zip(&mut rejected).enumerate() {
            *rejected |= line.residual(rank, value).abs() > threshold;
        }
        rejected = grown(&rejected, growth);
        kept_before = kept;
        kept = rejected.iter().filter(|&&rejected| !rejected).count();
        slope = Some(line.slope);
    }
    slope.filter(|_| kept >= least)
}

/// Rejects the neighbours of what is rejected: `numpy.convolve(rejected, ones(width), "same")`.
fn grown(rejected: &[bool], width: usize) -> Vec<bool> {
    (0..rejected.len())
        .map(|i| {
            let first = i.saturating_sub(width / 2);
            let last = (i + (width - 1) / 2).min(rejected.len() - 1);
            rejected[first..=last].contains(&true)
        })
        .collect()
}

/// A least-squares line through values against their rank.
struct Line {
    slope: f64,
    /// Means of rank and value.
    centre: (f64, f64),
}

impl Line {
    fn through(samples: &[f64], rejected: &[bool]) -> Self {
        let kept = || {
            samples
                .iter()
                .enumerate()
                .zip(rejected)
                .filter(|&(_, &rejected)| !rejected)
                .map(|((rank, &value), _)| (rank as f64, value))
        };
        let count = kept().count() as f64;
        let sum = kept().fold((0.0, 0.0), |sum, (rank, value)| (sum.0 + rank, sum.1 + value));
        let centre = (sum.0 / count, sum.1 / count);
        let (above, below) = kept().fold((0.0, 0.0), |(above, below), (rank, value)| {
            let from = rank - centre.0;
            (above + from * (value - centre.1), below + from * from)
        });
        Self {
            slope: above / below,
            centre,
        }
    }

    fn residual(&self, rank: usize, value: f64) -> f64 {
        value - self.centre.1 - self.slope * (rank as f64 - self.centre.0)
    }

    /// The standard deviation of the residuals that count.
    fn scatter(&self, samples: &[f64], rejected: &[bool]) -> f64 {
        let (mut count, mut squares) = (0, 0.0);
        for (rank, &value) in samples.iter().enumerate().filter(|&(rank, _)| !rejected[rank]) {
            count += 1;
            squares += self.residual(rank, value).powi(2);
        }
        // Their mean is zero, as of any such fit.
        (squares / f64::from(count)).sqrt()
    }
}
