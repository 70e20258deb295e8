//! The coverage of the field by samples.

use ndarray::{Array2, ArrayView2};
use psf_types::maths::ConvexHull;
use psf_types::{FrameShape, Position};
use serde::Serialize;

/// The coverage of the field by samples. For each cell of the field, it holds the number of
/// samples. It also holds the distance from the cell's centre to the nearest sample, and whether
/// the centre is inside the convex hull of the samples.
///
/// Cells are as square as the frame allows, with 16 along its longer side. Outside the hull a PSF
/// model extrapolates.
#[derive(Debug, Clone, PartialEq)]
pub struct CoverageMap {
    counts: Array2<f64>,
    distances_px: Array2<f64>,
    inside: Array2<f64>,
    frame: FrameShape,
    report: CoverageReport,
}

/// The statistics of a [`CoverageMap`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CoverageReport {
    /// Number of samples.
    pub samples: usize,
    /// The spacing that this number of samples would have on a square grid, `sqrt(area / samples)`,
    /// in pixels.
    pub mean_spacing_px: f64,
    /// The fraction of the frame's area outside the convex hull of the samples.
    pub outside_hull: f64,
    /// The fraction of the frame's area (by centres of cells) farther than twice the mean spacing
    /// from any sample.
    pub empty: f64,
    /// The largest distance from the centre of a cell to the nearest sample, in pixels.
    pub largest_gap_px: f64,
    /// The centre (x, y) of the cell with this largest distance.
    pub largest_gap_at: (f64, f64),
    /// Distance from each corner to the nearest sample, in pixels. The corners are
    /// (0, 0), (nx - 1, 0), (0, ny - 1), (nx - 1, ny - 1).
    pub corner_distances_px: [f64; 4],
}

/// Cells along the frame's longer side.
const ACROSS: usize = 16;
/// A part of the field counts as empty if it is farther than this number of mean spacings from any
/// sample.
const EMPTY: f64 = 2.0;
/// If a larger fraction of the area is outside the hull or empty, there is a warning.
const WARNED_AREA: f64 = 0.1;

impl CoverageMap {
    /// Computes the coverage of a frame by samples at `positions`.
    pub fn new(positions: &[Position], frame: FrameShape) -> Self {
        let (nx, ny) = (frame.nx() as f64, frame.ny() as f64);
        let side = (nx.max(ny) / ACROSS as f64).max(1.0);
        let (columns, rows) = (
            ((nx / side).round() as usize).max(1),
            ((ny / side).round() as usize).max(1),
        );
        let centre = |k: usize, cells: usize, n: f64| (k as f64 + 0.5) * n / cells as f64 - 0.5;
        let nearest = |x: f64, y: f64| {
            positions
                .iter()
                .map(|p| (p.x() - x).hypot(p.y() - y))
                .fold(f64::INFINITY, f64::min)
        };
        let mut counts = Array2::zeros((rows, columns));
        for p in positions {
            let cell = |v: f64, n: f64, cells: usize| {
                (((v + 0.5) / n * cells as f64).floor().max(0.0) as usize).min(cells - 1)
            };
            counts[[cell(p.y(), ny, rows), cell(p.x(), nx, columns)]] += 1.0;
        }
        let hull = ConvexHull::new(&positions.iter().map(|p| [p.x(), p.y()]).collect::<Vec<_>>());
        let has_area = hull.corners().len() >= 3;
        let at = |(j, i): (usize, usize)| (centre(i, columns, nx), centre(j, rows, ny));
        let distances_px = Array2::from_shape_fn((rows, columns), |cell| {
            let (x, y) = at(cell);
            nearest(x, y)
        });
        let inside = Array2::from_shape_fn((rows, columns), |cell| {
            let (x, y) = at(cell);
            f64::from(u8::from(has_area && hull.contains([x, y])))
        });
        let mean_spacing_px = (nx * ny / positions.len() as f64).sqrt();
        let (worst, largest_gap_px) =
            distances_px.indexed_iter().fold(
                ((0, 0), 0.0),
                |best, (cell, &d)| {
                    if d > best.1 { (cell, d) } else { best }
                },
            );
        let empty = distances_px
            .iter()
            .filter(|&&d| d > EMPTY * mean_spacing_px)
            .count();
        let (last_x, last_y) = (nx - 1.0, ny - 1.0);
        let report = CoverageReport {
            samples: positions.len(),
            mean_spacing_px,
            outside_hull: (1.0 - hull.area() / (nx * ny)).max(0.0),
            empty: empty as f64 / distances_px.len() as f64,
            largest_gap_px,
            largest_gap_at: at(worst),
            corner_distances_px: [(0.0, 0.0), (last_x, 0.0), (0.0, last_y), (last_x, last_y)]
                .map(|(x, y)| nearest(x, y)),
        };
        Self {
            counts,
            distances_px,
            inside,
            frame,
            report,
        }
    }

    /// Number of samples in each cell `[y, x]`.
    pub fn counts(&self) -> ArrayView2<'_, f64> {
        self.counts.view()
    }

    /// Distance from the centre of each cell to the nearest sample `[y, x]`, in pixels of the
    /// frame.
    pub fn distances_px(&self) -> ArrayView2<'_, f64> {
        self.distances_px.view()
    }

    /// The statistics of the coverage.
    pub fn report(&self) -> &CoverageReport {
        &self.report
    }

    /// For each cell `[y, x]`, 1 if its centre lies inside the convex hull of the samples, else 0.
    pub fn inside_hull(&self) -> ArrayView2<'_, f64> {
        self.inside.view()
    }

    /// Width and height of a cell in pixels of the frame.
    pub fn cell_px(&self) -> (f64, f64) {
        let (rows, columns) = self.counts.dim();
        (
            self.frame.nx() as f64 / columns as f64,
            self.frame.ny() as f64 / rows as f64,
        )
    }

    /// Warnings about parts of the field that the samples do not cover well. Empty if they cover
    /// the field well.
    pub fn warnings(&self) -> Vec<String> {
        let report = &self.report;
        let mut said = Vec::new();
        if report.outside_hull > WARNED_AREA {
            said.push(format!(
                "{:.0} % of the field lies outside the outermost samples, where the PSF cannot be interpolated",
                100.0 * report.outside_hull
            ));
        }
        if report.empty > WARNED_AREA {
            said.push(format!(
                "{:.0} % of the field is farther than {:.0} pixels from any sample. The largest distance, {:.0} pixels, is at ({:.0}, {:.0})",
                100.0 * report.empty,
                EMPTY * report.mean_spacing_px,
                report.largest_gap_px,
                report.largest_gap_at.0,
                report.largest_gap_at.1
            ));
        }
        let names = ["lower left", "lower right", "upper left", "upper right"];
        let bare: Vec<String> = names
            .iter()
            .zip(report.corner_distances_px)
            .filter(|(_, d)| *d > EMPTY * report.mean_spacing_px)
            .map(|(name, d)| format!("{name} ({d:.0} pixels to the nearest sample)"))
            .collect();
        if !bare.is_empty() {
            said.push(format!("corners without samples: {}", bare.join(", ")));
        }
        said
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> Position {
        Position::new(x, y).unwrap()
    }

    #[test]
    fn a_full_grid_leaves_only_its_margin() {
        let frame = FrameShape::new(100, 80).unwrap();
        let positions: Vec<_> = (0..80)
            .map(|k| at(5.0 + 10.0 * f64::from(k % 10), 5.0 + 10.0 * f64::from(k / 10)))
            .collect();
        let map = CoverageMap::new(&positions, frame);
        let report = map.report();
        assert!((report.outside_hull - (1.0 - 90.0 * 70.0 / 8000.0)).abs() < 1e-12);
        assert_eq!(report.empty, 0.0);
        assert!((report.mean_spacing_px - 10.0).abs() < 1e-12);
        assert_eq!(map.counts().sum(), 80.0);
        assert!((report.corner_distances_px[0] - 50f64.sqrt()).abs() < 1e-12);
        assert_eq!(map.inside_hull()[[5, 8]], 1.0);
        assert_eq!(map.inside_hull()[[0, 0]], 0.0);
    }

    #[test]
    fn samples_in_one_half_give_warnings() {
        let frame = FrameShape::new(128, 128).unwrap();
        let positions: Vec<_> = (0..64)
            .map(|k| at(2.0 + 6.0 * f64::from(k % 8), 4.0 + 17.0 * f64::from(k / 8)))
            .collect();
        let map = CoverageMap::new(&positions, frame);
        assert!(map.report().outside_hull > 0.5 && map.report().largest_gap_px > 60.0);
        let said = map.warnings().join("; ");
        assert!(
            said.contains("outside the outermost samples") && said.contains("lower right"),
            "{said}"
        );
        assert!(!said.contains("lower left"), "{said}");
        let (gap_x, _) = map.report().largest_gap_at;
        assert!(gap_x > 110.0);
    }

    #[test]
    fn one_sample_has_no_hull() {
        let map = CoverageMap::new(&[at(3.0, 4.0)], FrameShape::new(10, 10).unwrap());
        assert_eq!(map.report().outside_hull, 1.0);
        assert_eq!(map.inside_hull().sum(), 0.0);
    }
}
