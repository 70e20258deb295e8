//! Criteria and sources that are implemented outside the crate, correct and broken.

mod common;

use std::sync::Arc;

use common::Blob;
use ndarray::ArrayViewMut2;
use psf_sample::{
    AdaptiveSampling, CellProbes, CellStamps, CellVariation, RefinementCriterion, SampleError, SamplingMethod,
};
use psf_types::{FrameShape, NoProgress, Position, PsfSource, SourceError, StampGrid};

/// Varies mostly in the corner (1, 1).
fn corner(x: f64, y: f64) -> f64 {
    1.5 + (-((x - 1.0).powi(2) + (y - 1.0).powi(2)) / 0.02).exp()
}

/// A criterion from outside the crate. It refines until the peaks of a cell's corner PSFs differ by
/// less than a factor.
#[derive(Debug)]
struct PeakRatio(f64);

impl RefinementCriterion for PeakRatio {
    fn threshold(&self) -> f64 {
        self.0
    }
    fn probes(&self) -> CellProbes {
        CellProbes::Corners
    }
    fn assess(&self, cell: &CellStamps<'_>) -> CellVariation {
        let peak = |column, row| cell.at(column, row)[[6, 6]];
        let ratio = |a: f64, b: f64| (a / b).ln().abs();
        CellVariation {
            along_x: ratio(peak(0, 0), peak(2, 0)).max(ratio(peak(0, 2), peak(2, 2))),
            along_y: ratio(peak(0, 0), peak(0, 2)).max(ratio(peak(2, 0), peak(2, 2))),
        }
    }
}

#[test]
fn criteria_from_other_crates_work_and_are_checked() {
    let source = Blob::new(400, 400, corner);
    let sampling = AdaptiveSampling::new(Arc::new(PeakRatio(0.1)))
        .sample(&source, &NoProgress)
        .unwrap();
    assert!(sampling.report.worst <= 0.1 && sampling.samples.len() > 25);
    let endless = AdaptiveSampling::new(Arc::new(PeakRatio(f64::NAN))).sample(&source, &NoProgress);
    assert!(
        endless
            .unwrap_err()
            .to_string()
            .contains("threshold of the criterion must be")
    );
    // ln of the ratio of negative peaks is NaN. The sums are positive, so the PSFs themselves are
    // accepted.
    let odd = Broken(|x| if x > 100.0 { -0.5 } else { 0.5 });
    let error = AdaptiveSampling::new(Arc::new(PeakRatio(0.1)))
        .sample(&odd, &NoProgress)
        .unwrap_err();
    assert!(
        matches!(error, SampleError::Criterion { value, .. } if value.is_nan()),
        "{error}"
    );
}

/// Draws a pixel of a given value at [6, 6], and a pixel of value 1 next to it.
struct Broken(fn(f64) -> f64);

impl PsfSource for Broken {
    fn grid(&self) -> StampGrid {
        StampGrid::new(13, 13).unwrap()
    }
    fn field(&self) -> FrameShape {
        FrameShape::new(200, 100).unwrap()
    }
    fn draw_into(&self, position: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        if (self.0)(position.x()) == 7.0 {
            return Err(SourceError::External {
                position,
                source: "no optics here".into(),
            });
        }
        stamp.fill(0.0);
        stamp[[6, 7]] = 1.0;
        stamp[[6, 6]] = (self.0)(position.x());
        Ok(())
    }
}

#[test]
fn bad_psfs_are_refused_with_their_position() {
    let fail = |f| {
        AdaptiveSampling::default()
            .sample(&Broken(f), &NoProgress)
            .unwrap_err()
    };
    let nan = fail(|x| if x > 60.0 { f64::NAN } else { 1.0 });
    assert!(
        matches!(&nan, SampleError::Stamp { position, .. } if position.x() == 74.625),
        "{nan}"
    );
    let dark = fail(|x| if x > 160.0 { -1.0 } else { 1.0 });
    assert!(
        matches!(&dark, SampleError::NoLight { position, flux: 0.0 } if position.x() == 174.125),
        "{dark}"
    );
    let refused = fail(|x| if x > 110.0 { 7.0 } else { 1.0 });
    assert!(
        matches!(&refused, SampleError::Draw { position, .. } if position.x() == 124.375),
        "{refused}"
    );
}
