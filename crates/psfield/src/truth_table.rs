//! Tables of what is where in an image.

use std::collections::HashMap;
use std::path::Path;

use detector::PixelFlags;
use ndarray::ArrayView2;
use psf_io::{Card, Catalog, ColumnValues, IoError, SkyCoordinates, TableColumn};
use psf_types::{PixelRegion, Position};

/// The sources of a catalogue as they are in an image, in the order of the catalogue's rows.
///
/// | column | value |
/// |---|---|
/// | `row` | row of the catalogue, counted from 0 |
/// | `x`, `y` | position in 0-based pixels of the image |
/// | `ra`, `dec` | position on the sky in degrees at the date of the image, if it has world coordinates |
/// | `flux` | flux in the unit of the image |
/// | `in_frame` | whether the position is on a pixel of the image |
/// | `saturated_pixels` | with a detector: how many pixels the saturated area at the position has, 0 if it is not saturated |
///
/// A saturated area is a group of saturated pixels that touch, also at corners. Several sources may share one.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthTable {
    sources: Vec<TrueSource>,
    has_sky: bool,
    has_detector: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct TrueSource {
    row: usize,
    position: Position,
    /// NaN if they are not known.
    sky: (f64, f64),
    flux: f64,
    in_frame: bool,
    saturated_pixels: usize,
}

impl TruthTable {
    /// The sources of a catalogue in an image that shows a part of the scene
    /// ([`Simulator::shown_region`](crate::Simulator::shown_region)). The positions of the catalogue and the world
    /// coordinates count from the first pixel of the scene.
    pub fn new(catalog: &Catalog, shown: PixelRegion, sky: Option<&SkyCoordinates>) -> Self {
        let stars = catalog.stars().iter().map(|star| (star.position(), star.flux()));
        let galaxies = catalog.galaxies().iter();
        let galaxies = galaxies.map(|galaxy| (galaxy.position(), galaxy.flux()));
        let mut sources: Vec<TrueSource> = stars
            .chain(galaxies)
            .zip(catalog.rows())
            .filter_map(|((at, flux), &row)| {
                let position = Position::new(at.x() - shown.x0() as f64, at.y() - shown.y0() as f64).ok()?;
                let in_frame = on_pixel(position, (shown.shape().nx(), shown.shape().ny())).is_some();
                Some(TrueSource {
                    row,
                    position,
                    sky: sky.and_then(|sky| sky.sky(at)).unwrap_or((f64::NAN, f64::NAN)),
                    flux,
                    in_frame,
                    saturated_pixels: 0,
                })
            })
            .collect();
        sources.sort_by_key(|source| source.row);
        Self {
            sources,
            has_sky: sky.is_some(),
            has_detector: false,
        }
    }

    /// The number of sources.
    pub fn count(&self) -> usize {
        self.sources.len()
    }

    /// The number of sources on pixels of the image.
    pub fn count_in_frame(&self) -> usize {
        self.sources.iter().filter(|source| source.in_frame).count()
    }

    /// Adds the saturated pixels of an exposure, by the flags of its pixels `[y, x]`
    /// ([`Exposure::flags`](detector::Exposure::flags)).
    #[must_use]
    pub fn with_flags(self, flags: ArrayView2<'_, u8>) -> Self {
        self.with_saturated(&SaturatedAreas::of(flags.nrows(), |y| {
            flags
                .row(y)
                .into_iter()
                .map(|flag| flag & PixelFlags::SATURATED != 0)
        }))
    }

    fn with_saturated(mut self, areas: &SaturatedAreas) -> Self {
        for source in &mut self.sources {
            source.saturated_pixels = areas.pixels_at(source.position);
        }
        self.has_detector = true;
        self
    }

    /// The columns.
    pub fn columns(&self) -> Vec<TableColumn> {
        let sources = || self.sources.iter();
        let numbers = |name, unit, value: fn(&TrueSource) -> f64| TableColumn {
            name,
            unit,
            values: ColumnValues::Numbers(sources().map(value).collect()),
        };
        let integers = |name, value: fn(&TrueSource) -> usize| TableColumn {
            name,
            unit: "",
            values: ColumnValues::Integers(sources().map(|source| value(source) as i64).collect()),
        };
        let mut columns = vec![
            integers("row", |source| source.row),
            numbers("x", "pix", |source| source.position.x()),
            numbers("y", "pix", |source| source.position.y()),
        ];
        if self.has_sky {
            columns.push(numbers("ra", "deg", |source| source.sky.0));
            columns.push(numbers("dec", "deg", |source| source.sky.1));
        }
        columns.push(numbers("flux", "", |source| source.flux));
        columns.push(TableColumn {
            name: "in_frame",
            unit: "",
            values: ColumnValues::Flags(sources().map(|source| source.in_frame).collect()),
        });
        if self.has_detector {
            columns.push(integers("saturated_pixels", |source| source.saturated_pixels));
        }
        columns
    }

    /// Writes the table to a FITS file, with `cards` in its primary header.
    ///
    /// # Errors
    /// The errors of [`write_table`](psf_io::write_table).
    pub fn write(&self, path: impl AsRef<Path>, cards: &[Card], overwrite: bool) -> Result<(), IoError> {
        psf_io::write_table(path, "TRUTH", &self.columns(), cards, overwrite)
    }
}

/// The pixel (column, row) of a position in an image of this width and height. `None` outside the image.
fn on_pixel(at: Position, (nx, ny): (usize, usize)) -> Option<(usize, usize)> {
    let index = |value: f64, count: usize| {
        let nearest = (value + 0.5).floor();
        (nearest >= 0.0 && nearest < count as f64).then_some(nearest as usize)
    };
    Some((index(at.x(), nx)?, index(at.y(), ny)?))
}

/// The groups of saturated pixels that touch.
struct SaturatedAreas {
    /// For each row, its runs of saturated pixels: first column, column after the last, number of the run.
    rows: Vec<Vec<(usize, usize, usize)>>,
    /// The pixels of the area of each run.
    pixels: Vec<usize>,
}

impl SaturatedAreas {
    /// `row` tells of each pixel of a row whether it is saturated.
    fn of<R: Iterator<Item = bool>>(ny: usize, row: impl Fn(usize) -> R) -> Self {
        let mut rows: Vec<Vec<(usize, usize, usize)>> = Vec::with_capacity(ny);
        // The run that stands for the area of each run, in the end.
        let mut parents: Vec<usize> = Vec::new();
        for y in 0..ny {
            let mut runs: Vec<(usize, usize, usize)> = Vec::new();
            for (x, _) in row(y).enumerate().filter(|(_, is_saturated)| *is_saturated) {
                match runs.last_mut() {
                    Some((_, end, _)) if *end == x => *end += 1,
                    _ => {
                        runs.push((x, x + 1, parents.len()));
                        parents.push(parents.len());
                    }
                }
            }
            for (x0, x1, run) in &runs {
                // Pixels touch at corners, too.
                let above = y.checked_sub(1).map_or(&[][..], |before| &rows[before]);
                for (_, _, other) in above.iter().filter(|(a0, a1, _)| a0 <= x1 && x0 <= a1) {
                    let (a, b) = (root(&parents, *run), root(&parents, *other));
                    parents[a.max(b)] = a.min(b);
                }
            }
            rows.push(runs);
        }
        let mut areas: HashMap<usize, usize> = HashMap::new();
        for &(x0, x1, run) in rows.iter().flatten() {
            *areas.entry(root(&parents, run)).or_default() += x1 - x0;
        }
        let pixels = (0..parents.len())
            .map(|run| areas[&root(&parents, run)])
            .collect();
        Self { rows, pixels }
    }

    /// The pixels of the area at a position. 0 if its pixel is not saturated.
    fn pixels_at(&self, at: Position) -> usize {
        let Some((x, y)) = on_pixel(at, (usize::MAX, self.rows.len())) else {
            return 0;
        };
        let runs = &self.rows[y];
        let run = runs.partition_point(|&(_, end, _)| end <= x);
        let found = runs.get(run).filter(|(start, ..)| *start <= x);
        found.map_or(0, |&(.., number)| self.pixels[number])
    }
}

fn root(parents: &[usize], mut run: usize) -> usize {
    while parents[run] != run {
        run = parents[run];
    }
    run
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn saturated_pixels_that_touch_are_one_area() {
        let picture = ["##..#", "..#..", "#...#", "#.###"];
        let row = |y: usize| {
            picture[y]
                .chars()
                .map(|c| c == '#')
                .collect::<Vec<_>>()
                .into_iter()
        };
        let areas = SaturatedAreas::of(picture.len(), row);
        let at = |x: f64, y: f64| areas.pixels_at(Position::new(x, y).unwrap());
        assert_eq!([at(0.0, 0.0), at(1.4, 0.4), at(2.0, 1.0)], [3, 3, 3]);
        assert_eq!([at(4.0, 0.0), at(4.0, 2.0), at(2.0, 3.0)], [1, 4, 4]);
        assert_eq!([at(0.0, 2.0), at(0.0, 3.0)], [2, 2]);
        assert_eq!([at(2.0, 0.0), at(-1.0, 0.0), at(0.0, 4.0), at(9.0, 0.0)], [0; 4]);
    }
}
