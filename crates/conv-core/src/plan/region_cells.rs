//! The weights of a coefficient field's nodes over a region.
//!
//! At each pixel, a field's coefficients are `sum_n w_n v_n`. Node `n` has the values `v_n`
//! ([`psf_types::WeightedNodes`]) and, at this pixel, the weight `w_n`. If the field has no nodes, the
//! corners of its cells are the nodes.

use std::{iter, ops::Range};

use psf_types::{BilinearCells, CoefficientField, ErrorLimit, PixelRegion, Position};
use rustc_hash::{FxBuildHasher, FxHashMap};

use super::allowed_errors::CellError;
use super::axis_cuts::parts;
use super::checked_cells::{CheckedCells, Measure};
use crate::view;

/// Cells: rectangles in which the nodes' weights are bilinear. A region is divided into bands of
/// rows, and each band is divided into cells at some columns. Neighbouring cells share corners if
/// the field is continuous from one to the next.
#[derive(Debug, Default)]
pub struct RegionCells {
    pub(crate) bands: Vec<Band>,
    cells: Vec<Cell>,
    /// The nodes that have a weight anywhere in the region, ascending. Corners that are nodes follow
    /// those of the fields.
    pub(crate) nodes: Vec<usize>,
    /// The number of nodes that the fields have.
    nodes_of_fields: usize,
    /// The coefficients at each corner that is a node.
    corner_values: Vec<Vec<f64>>,
    /// For each corner, its range of the list `weights`.
    corners: Vec<Range<usize>>,
    /// `(index into nodes, weight)`.
    weights: Vec<(usize, f64)>,
    /// Weights at a position.
    buffer: Vec<(usize, f64)>,
    /// The largest size ([`ErrorLimit`]) of the coefficients' errors, because they are not quite
    /// bilinear in the cells.
    pub(crate) error: f64,
    /// The largest flux in a circle of these errors. `None` if it is not known.
    pub(crate) circle_error: Option<f64>,
    /// The number of layers, each with a field of its own. The rows of layer `l` begin at row `l` times
    /// the number of the region's rows. All layers together are as one region, with all nodes of all
    /// fields.
    pub(crate) layers: usize,
}

/// Neighbouring rows of a region that are divided at the same columns.
#[derive(Debug, Clone)]
pub(crate) struct Band {
    /// The rows of pixels, counted from the region's first row.
    pub(crate) rows: Range<usize>,
    cells: Range<usize>,
}

/// Neighbouring columns of a band.
#[derive(Debug, Clone)]
pub(crate) struct Cell {
    /// The columns of pixels, counted from the region's first column.
    pub(crate) columns: Range<usize>,
    /// The x and the y coordinates of the corners, counted from the region's first pixel.
    pub(crate) sides: [(f64, f64); 2],
    /// The corners: left and right at the first y coordinate, then at the second. `None` if the
    /// field has no value in the cell. Cells of neighbouring bands have the same corners if they
    /// are parts of one rectangle.
    pub(crate) corners: Option<[usize; CORNERS]>,
}

pub(crate) const CORNERS: usize = 4;

/// A stretch of one row, with the corners at its first and its last pixel.
struct Run {
    columns: Range<usize>,
    corners: Option<[usize; 2]>,
}

/// Neighbouring columns, and the x coordinates of corners from the first to the last of them.
struct Stretch {
    columns: Range<usize>,
    edges: Vec<f64>,
}

/// The limits of errors: of fields that know their cells, and of cells that checks find.
#[derive(Clone, Copy)]
pub(crate) struct CellLimits<'a> {
    pub(crate) known: ErrorLimit<'a>,
    pub(crate) measure: Measure<'a>,
}

/// The number of a field's own nodes.
pub(crate) fn node_count(field: &dyn CoefficientField) -> usize {
    field
        .weighted_nodes()
        .map_or(0, |nodes| nodes.node_values().nrows())
}

impl RegionCells {
    /// The cells of a field in a region. Together they cover all rows of the region. In the cells,
    /// coefficients are bilinear up to `error`.
    pub fn new(field: &dyn CoefficientField, region: PixelRegion, error: ErrorLimit<'_>) -> Self {
        let limit = CellError {
            size: error.size,
            flux_weight: 0.0,
            l2: error.size,
            circle: None,
        };
        let measure = |d: &[f64]| error.product(d, d).sqrt() / error.size;
        let limits = CellLimits {
            known: error,
            measure: Measure {
                limit,
                of_size: &measure,
                of_all: &measure,
            },
        };
        Self::of_layers(&[field], region, limits)
    }

    /// The cells of all layers.
    pub(crate) fn of_layers(
        layers: &[&dyn CoefficientField],
        region: PixelRegion,
        limits: CellLimits<'_>,
    ) -> Self {
        Self::of_each(layers, region, |all, field| {
            all.add_rows(field, region, 0..region.shape().ny(), limits);
        })
    }

    /// The cells that `add` adds for each layer.
    fn of_each(
        layers: &[&dyn CoefficientField],
        region: PixelRegion,
        add: impl Fn(&mut Self, &dyn CoefficientField),
    ) -> Self {
        let counts: Vec<usize> = layers.iter().map(|field| node_count(*field)).collect();
        let mut all = Self {
            nodes_of_fields: counts.iter().sum(),
            circle_error: Some(0.0),
            layers: layers.len(),
            ..Self::default()
        };
        // The rows and the nodes of a layer follow those of the layers before it.
        let mut nodes = 0;
        for (layer, (&field, count)) in layers.iter().zip(counts).enumerate() {
            let (bands, cells, weights) = (all.bands.len(), all.cells.len(), all.weights.len());
            add(&mut all, field);
            let above = layer * region.shape().ny();
            for band in &mut all.bands[bands..] {
                band.rows = band.rows.start + above..band.rows.end + above;
            }
            for cell in &mut all.cells[cells..] {
                let (low, high) = cell.sides[1];
                cell.sides[1] = (low + above as f64, high + above as f64);
            }
            let weights = all.weights[weights..].iter_mut();
            let own = weights.filter(|(node, _)| *node < all.nodes_of_fields);
            own.for_each(|(node, _)| *node += nodes);
            nodes += count;
        }
        all.number_nodes();
        all
    }

    /// The cells of `count` rows of each layer of a region, which include the first and the last row.
    /// Each of these rows is a band of its own, with `count + 1` cells unless the field has runs. The
    /// other rows have no cells.
    pub(crate) fn sampled(layers: &[&dyn CoefficientField], region: PixelRegion, count: usize) -> Self {
        Self::of_each(layers, region, |all, field| {
            all.add_sampled_rows(field, region, count);
        })
    }

    fn add_sampled_rows(&mut self, field: &dyn CoefficientField, region: PixelRegion, count: usize) {
        let (nx, ny) = (region.shape().nx(), region.shape().ny());
        let has_runs = matches!(
            field.bilinear_cells(region, ErrorLimit::ZERO),
            BilinearCells::Bands(_) | BilinearCells::Rectangles(_)
        );
        let rows = count.min(ny);
        for i in 0..rows {
            let row = i * (ny - 1) / (rows - 1).max(1);
            if has_runs {
                self.add_band(field, region, row..row + 1);
                continue;
            }
            let columns = parts(0, nx, nx.div_ceil(count + 1));
            let runs: Vec<Run> = columns
                .into_iter()
                .map(|(first, length)| {
                    let mut at = |column: usize| self.corner(field, region, [column as f64, row as f64]);
                    Run {
                        columns: first..first + length,
                        corners: at(first).zip(at(first + length - 1)).map(|(a, b)| [a, b]),
                    }
                })
                .collect();
            self.push_band(row..row + 1, &runs, &runs);
        }
    }

    /// About how many cells [`new`](Self::new) makes.
    pub(crate) fn expected(
        field: &dyn CoefficientField,
        region: PixelRegion,
        limits: CellLimits<'_>,
    ) -> usize {
        match field.bilinear_cells(region, limits.known) {
            BilinearCells::Lines { x, y, .. } => (x.len() + 1) * (y.len() + 1),
            BilinearCells::Rectangles(rectangles) => {
                let edges = edges_along_y(&rectangles);
                rectangles.iter().map(|[_, y]| crossed(&edges, *y).len()).sum()
            }
            BilinearCells::Bands(lines) => {
                let shape = region.shape();
                let middle = region.y0() + shape.ny() as i64 / 2;
                let runs = Self::default().runs(field, (region.x0(), middle), shape.nx());
                (lines.len() + 1) * runs.len()
            }
            BilinearCells::Divide => 1,
            BilinearCells::Unknown { scale, .. } => {
                CheckedCells::expected(field, region, (scale, limits.measure))
            }
        }
    }

    /// Adds the cells of some rows of a region.
    fn add_rows(
        &mut self,
        field: &dyn CoefficientField,
        region: PixelRegion,
        rows: Range<usize>,
        limits: CellLimits<'_>,
    ) {
        // Parts of these rows, from left to right. If the field has a kink in them, their columns
        // are divided, and then the rows, until kinks are in single pixels.
        let mut left: Vec<_> = iter::once(0..region.shape().nx()).collect();
        let (mut stretches, mut lines) = (Vec::new(), Vec::new());
        while let Some(columns) = left.pop() {
            let part = view::region(
                region.x0() + columns.start as i64,
                region.y0() + rows.start as i64,
                (columns.len(), rows.len()),
            );
            match field.bilinear_cells(part, limits.known) {
                BilinearCells::Bands(ys) => {
                    let edges = edges(&ys, region.y0(), &rows);
                    for (rows, _) in between(&edges, rows) {
                        self.add_band(field, region, rows);
                    }
                    return;
                }
                BilinearCells::Rectangles(rectangles)
                    if columns.len() == region.shape().nx() && !rectangles.is_empty() =>
                {
                    self.add_rectangles(field, region, rectangles, rows);
                    return;
                }
                BilinearCells::Unknown { scale, .. } if columns.len() == region.shape().nx() => {
                    let cells = CheckedCells::new(field, part, (scale, limits.measure));
                    let limit = limits.measure.limit.times(cells.error);
                    self.error = self.error.max(limit.l2);
                    self.circle_error = self.circle_error.zip(limit.circle).map(|(a, b)| a.max(b));
                    self.add_checked_cells(&cells, part.shape().nx(), rows);
                    return;
                }
                BilinearCells::Rectangles(_) | BilinearCells::Unknown { .. } => {
                    for row in rows {
                        self.add_band(field, region, row..row + 1);
                    }
                    return;
                }
                BilinearCells::Lines { x, y, error } => {
                    lines.extend(y);
                    self.error = self.error.max(error);
                    if error > 0.0 {
                        self.circle_error = None;
                    }
                    stretches.push(Stretch {
                        edges: edges(&x, region.x0(), &columns),
                        columns,
                    });
                }
                BilinearCells::Divide if columns.len() > 1 => {
                    let middle = usize::midpoint(columns.start, columns.end);
                    left.extend([middle..columns.end, columns.start..middle]);
                }
                BilinearCells::Divide if rows.len() > 1 => {
                    let middle = usize::midpoint(rows.start, rows.end);
                    self.add_rows(field, region, rows.start..middle, limits);
                    self.add_rows(field, region, middle..rows.end, limits);
                    return;
                }
                BilinearCells::Divide => stretches.push(Stretch {
                    edges: vec![columns.start as f64; 2],
                    columns,
                }),
            }
        }
        let edges = edges(&lines, region.y0(), &rows);
        let corners: Vec<Vec<Option<usize>>> = edges
            .iter()
            .map(|&y| {
                let xs = stretches.iter().flat_map(|stretch| &stretch.edges);
                xs.map(|&x| self.corner(field, region, [x, y])).collect()
            })
            .collect();
        for (rows, i) in between(&edges, rows) {
            let (start, mut first) = (self.cells.len(), 0);
            for Stretch { columns, edges: xs } in &stretches {
                for (columns, j) in between(xs, columns.clone()) {
                    let at = |i: usize, j: usize| corners[i][first + j];
                    let of_cell = [at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)];
                    self.cells.push(Cell {
                        columns,
                        sides: [(xs[j], xs[j + 1]), (edges[i], edges[i + 1])],
                        corners: of_cell
                            .iter()
                            .all(Option::is_some)
                            .then(|| of_cell.map(Option::unwrap_or_default)),
                    });
                }
                first += xs.len();
            }
            self.end_band(rows, start);
        }
    }

    /// Adds rectangles that cover some rows of a region. Bands end where a rectangle begins or
    /// ends.
    fn add_rectangles(
        &mut self,
        field: &dyn CoefficientField,
        region: PixelRegion,
        mut rectangles: Vec<[(f64, f64); 2]>,
        rows: Range<usize>,
    ) {
        let (origin, nx) = ([region.x0(), region.y0()], region.shape().nx());
        for sides in &mut rectangles {
            for (side, origin) in sides.iter_mut().zip(origin) {
                *side = (side.0 - origin as f64, side.1 - origin as f64);
            }
        }
        // Rounding may leave nothing between the sides of a rectangle.
        let is_flat = |side: (f64, f64)| side.0 >= side.1;
        rectangles.retain(|&[x, y]| (nx == 1 || !is_flat(x)) && (rows.len() == 1 || !is_flat(y)));
        self.add_counted_rectangles(nx, rectangles, rows, |all, at| all.corner(field, region, at));
    }

    /// Adds the cells that checks found in some rows of a region with `nx` columns.
    fn add_checked_cells(&mut self, cells: &CheckedCells, nx: usize, rows: Range<usize>) {
        let above = rows.start;
        let in_region = |&[x, y]: &[(usize, usize); 2]| {
            [x, (y.0 + above, y.1 + above)].map(|(first, last)| (first as f64, last as f64))
        };
        let rectangles = cells.rectangles.iter().map(in_region).collect();
        self.add_counted_rectangles(nx, rectangles, rows, |all, [x, y]| {
            let values = cells.at([x as usize, y as usize - above])?;
            Some(all.push_values(values.to_vec()))
        });
    }

    /// Adds rectangles whose sides count from the region's first pixel. `corner` stores a corner.
    fn add_counted_rectangles(
        &mut self,
        nx: usize,
        mut rectangles: Vec<[(f64, f64); 2]>,
        rows: Range<usize>,
        store_corner: impl Fn(&mut Self, [f64; 2]) -> Option<usize>,
    ) {
        rectangles.sort_by(|[a, _], [b, _]| a.0.total_cmp(&b.0));
        let mut numbers = FxHashMap::with_capacity_and_hasher(2 * rectangles.len(), FxBuildHasher);
        let mut corner = |all: &mut Self, at: [f64; 2]| {
            *numbers
                .entry(at.map(f64::to_bits))
                .or_insert_with(|| store_corner(all, at))
        };
        let corners: Vec<Option<[usize; CORNERS]>> = rectangles
            .iter()
            .map(|[x, y]| {
                let at = [[x.0, y.0], [x.1, y.0], [x.0, y.1], [x.1, y.1]];
                let [a, b, c, d] = at.map(|at| corner(self, at));
                Some([a?, b?, c?, d?])
            })
            .collect();
        let mut edges = edges_along_y(&rectangles);
        if edges.len() == 1 {
            edges.push(edges[0]);
        }
        // The rectangles between each edge and the next, from left to right.
        let mut of_bands = vec![Vec::new(); edges.len() - 1];
        for (rectangle, [_, y]) in rectangles.iter().enumerate() {
            for of_band in &mut of_bands[crossed(&edges, *y)] {
                of_band.push(rectangle);
            }
        }
        for (rows, i) in between(&edges, rows) {
            let start = self.cells.len();
            for (k, &rectangle) in of_bands[i].iter().enumerate() {
                let first_column = |rectangle: usize| rectangles[rectangle][0].0.ceil() as usize;
                let end = of_bands[i].get(k + 1).map_or(nx, |&next| first_column(next));
                let columns = first_column(rectangle)..end;
                if !columns.is_empty() {
                    self.cells.push(Cell {
                        columns,
                        sides: rectangles[rectangle],
                        corners: corners[rectangle],
                    });
                }
            }
            self.end_band(rows, start);
        }
    }

    /// Stores the weights at a position, which is counted from the region's first pixel. `None` if
    /// the field has no value there.
    fn corner(
        &mut self,
        field: &dyn CoefficientField,
        region: PixelRegion,
        [x, y]: [f64; 2],
    ) -> Option<usize> {
        let position = Position::new(region.x0() as f64 + x, region.y0() as f64 + y).ok()?;
        let Some(nodes) = field.weighted_nodes() else {
            return self.evaluated_corner(field, position);
        };
        let mut weights = std::mem::take(&mut self.buffer);
        let outcome = nodes.weights_into(position, &mut weights);
        let corner =
            (outcome.is_ok() && weights.iter().all(|(_, w)| w.is_finite())).then(|| self.push(&weights));
        self.buffer = weights;
        corner
    }

    /// Stores the coefficients at a position as a node of their own.
    fn evaluated_corner(&mut self, field: &dyn CoefficientField, position: Position) -> Option<usize> {
        let mut values = vec![0.0; field.component_count()];
        field.evaluate_into(position, &mut values).ok()?;
        values
            .iter()
            .all(|v| v.is_finite())
            .then(|| self.push_values(values))
    }

    fn push_values(&mut self, values: Vec<f64>) -> usize {
        let node = self.nodes_of_fields + self.corner_values.len();
        self.corner_values.push(values);
        self.push(&[(node, 1.0)])
    }

    /// Adds rows whose runs are of equal lengths. They become one band if the first and the last row
    /// are divided at the same columns. Otherwise each row becomes a band.
    fn add_band(&mut self, field: &dyn CoefficientField, region: PixelRegion, rows: Range<usize>) {
        let nx = region.shape().nx();
        let runs_of =
            |all: &mut Self, row: usize| all.runs(field, (region.x0(), region.y0() + row as i64), nx);
        let first = runs_of(self, rows.start);
        if rows.len() == 1 {
            self.push_band(rows, &first, &first);
            return;
        }
        let last = runs_of(self, rows.end - 1);
        let alike =
            |(a, b): (&Run, &Run)| a.columns == b.columns && a.corners.is_some() == b.corners.is_some();
        if first.len() == last.len() && first.iter().zip(&last).all(alike) {
            self.push_band(rows, &first, &last);
            return;
        }
        let (low, high) = (rows.start, rows.end - 1);
        self.push_band(low..low + 1, &first, &first);
        for row in low + 1..high {
            let runs = runs_of(self, row);
            self.push_band(row..row + 1, &runs, &runs);
        }
        self.push_band(high..high + 1, &last, &last);
    }

    fn push_band(&mut self, rows: Range<usize>, first: &[Run], last: &[Run]) {
        let start = self.cells.len();
        self.cells.extend(first.iter().zip(last).map(|(first, last)| {
            let corners = first.corners.zip(last.corners);
            let columns = first.columns.clone();
            Cell {
                sides: [&columns, &rows].map(|pixels| (pixels.start as f64, (pixels.end - 1) as f64)),
                columns,
                corners: corners.map(|([a, b], [c, d])| [a, b, c, d]),
            }
        }));
        self.end_band(rows, start);
    }

    /// Makes the cells from `start` on a band.
    fn end_band(&mut self, rows: Range<usize>, start: usize) {
        let cells = start..self.cells.len();
        self.bands.push(Band { rows, cells });
    }

    /// Returns the runs of a row and stores their weights.
    fn runs(&mut self, field: &dyn CoefficientField, (x, y): (i64, i64), length: usize) -> Vec<Run> {
        let Some(nodes) = field.weighted_nodes() else {
            let run_of = |column: usize| {
                let position = Position::of_pixel(x + column as i64, y);
                let corner = self.evaluated_corner(field, position);
                Run {
                    columns: column..column + 1,
                    corners: corner.map(|corner| [corner; 2]),
                }
            };
            return (0..length).map(run_of).collect();
        };
        let mut runs = Vec::new();
        let mut column = 0;
        while column < length {
            let outcome = nodes.weights_along_row((x + column as i64, y), length - column, &mut |run| {
                // A run may extend beyond the row. Such a run is cut, and its pixels have no value.
                let pixels = run.length.min(length - column);
                let finite = |end: &[(usize, f64)]| end.iter().all(|(_, w)| w.is_finite());
                let corners = (finite(run.first) && finite(run.last) && pixels == run.length).then(|| {
                    let first = self.push(run.first);
                    let last = if run.length == 1 {
                        first
                    } else {
                        self.push(run.last)
                    };
                    [first, last]
                });
                if pixels > 0 {
                    runs.push(Run {
                        columns: column..column + pixels,
                        corners,
                    });
                }
                column += pixels;
            });
            if outcome.is_err() || column < length {
                // This pixel has no PSF. That is an error of the execution if the pixel is lit.
                runs.push(Run {
                    columns: column..column + 1,
                    corners: None,
                });
                column += 1;
            }
        }
        runs
    }

    fn push(&mut self, weights: &[(usize, f64)]) -> usize {
        let start = self.weights.len();
        self.weights.extend_from_slice(weights);
        self.corners.push(start..self.weights.len());
        self.corners.len() - 1
    }

    /// Lists the nodes and numbers them from 0.
    fn number_nodes(&mut self) {
        let range = |(low, high): (usize, usize), &(node, _): &(usize, f64)| (low.min(node), high.max(node));
        let (low, high) = self.weights.iter().fold((usize::MAX, 0), range);
        if low > high {
            return;
        }
        let mut numbers = vec![usize::MAX; high - low + 1];
        for &(node, _) in &self.weights {
            numbers[node - low] = 0;
        }
        for (node, number) in numbers.iter_mut().enumerate().filter(|(_, number)| **number == 0) {
            *number = self.nodes.len();
            self.nodes.push(low + node);
        }
        for (node, _) in &mut self.weights {
            *node = numbers[*node - low];
        }
    }

    pub(crate) fn cells_of(&self, band: &Band) -> &[Cell] {
        &self.cells[band.cells.clone()]
    }

    /// The corners of all cells with values, cell by cell.
    pub(crate) fn corners_of_cells(&self) -> impl Iterator<Item = &[usize; CORNERS]> {
        self.cells.iter().filter_map(|cell| cell.corners.as_ref())
    }

    /// The coefficients of a node that is a corner. None for a node of a field.
    pub(crate) fn values_of(&self, node: usize) -> Option<&[f64]> {
        let corner = node.checked_sub(self.nodes_of_fields)?;
        Some(&self.corner_values[corner])
    }

    /// The weights of [`nodes`](Self::nodes) at a corner.
    pub(crate) fn weights(&self, corner: usize) -> &[(usize, f64)] {
        &self.weights[self.corners[corner].clone()]
    }

    /// The weights at each corner.
    pub(crate) fn corners(&self) -> impl ExactSizeIterator<Item = &[(usize, f64)]> {
        self.corners.iter().map(|range| &self.weights[range.clone()])
    }

    /// Returns whether the weights at every corner sum to 1.
    pub(crate) fn is_partition_of_unity(&self) -> bool {
        let sum = |corner: &[(usize, f64)]| corner.iter().map(|(_, w)| w).sum::<f64>();
        self.corners()
            .all(|corner| (sum(corner) - 1.0).abs() <= ROUNDING_OF_WEIGHTS)
    }
}

/// The y coordinates at which rectangles begin or end, ascending.
fn edges_along_y(rectangles: &[[(f64, f64); 2]]) -> Vec<f64> {
    let mut edges: Vec<f64> = rectangles.iter().flat_map(|[_, y]| [y.0, y.1]).collect();
    edges.sort_by(f64::total_cmp);
    edges.dedup();
    edges
}

/// The bands between edges that a rectangle crosses, from its first to its last y coordinate.
fn crossed(edges: &[f64], (first, last): (f64, f64)) -> Range<usize> {
    let [first, end] = [first, last].map(|y| edges.partition_point(|&edge| edge < y));
    first..end.max(first + 1)
}

/// The coordinates of corners over a range of pixels: its first pixel, the lines after it, its last
/// pixel. Lines are counted from 0, pixels and the result from `origin`.
fn edges(lines: &[f64], origin: i64, range: &Range<usize>) -> Vec<f64> {
    let (first, last) = (range.start as f64, (range.end - 1) as f64);
    let mut edges: Vec<f64> = lines.iter().map(|line| line - origin as f64).collect();
    edges.retain(|&edge| edge > first && edge <= last);
    edges.extend([first, last]);
    edges.sort_by(f64::total_cmp);
    edges
}

/// The pixels between each edge and the next, and the index of the first edge. A pixel on an edge
/// lies after it. Pairs of edges without a pixel are left out.
fn between(edges: &[f64], range: Range<usize>) -> impl Iterator<Item = (Range<usize>, usize)> {
    let last = edges.len() - 2;
    let pixels = edges.windows(2).enumerate().map(move |(i, pair)| {
        let end = if i == last {
            range.end
        } else {
            pair[1].ceil() as usize
        };
        (pair[0].ceil() as usize..end, i)
    });
    pixels.filter(|(pixels, _)| !pixels.is_empty())
}

/// The largest rounding error of a sum of weights.
const ROUNDING_OF_WEIGHTS: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::FieldError;

    /// Two parts of a region, and between them one that is thinner than the rounding of rows.
    #[derive(Debug)]
    struct Thin(f64, f64);

    impl CoefficientField for Thin {
        fn component_count(&self) -> usize {
            1
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            a[0] = p.y();
            Ok(())
        }
        fn bilinear_cells(&self, region: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
            let (x, y) = (region.x0() as f64, region.y0() as f64);
            let last = [x, y].map(|first| first + 32.0);
            let ys = [(self.1, last[1]), (self.0, self.1), (y, self.0)];
            let ys = ys.into_iter().filter(|y| y.0 < y.1);
            BilinearCells::Rectangles(ys.map(|y| [(x, last[0]), y]).collect())
        }
    }

    #[test]
    fn a_thin_cell_takes_no_pixels_from_others() {
        let region = view::region(-32, -32, (33, 33));
        for (low, high) in [(-0.300_000_000_000_000_04, -0.3), (-1e-17, 0.0)] {
            let cells = RegionCells::new(&Thin(low, high), region, ErrorLimit::ZERO);
            let rows: usize = cells.bands.iter().map(|band| band.rows.len()).sum();
            assert_eq!(rows, 33, "{:?}", cells.bands);
            for cell in &cells.cells {
                assert!(
                    cell.columns == (0..33) && cell.sides[1].0 < cell.sides[1].1,
                    "{cell:?}"
                );
            }
        }
    }
}
