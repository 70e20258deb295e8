//! Artificial input for shaders, and transforms by their definition.

use std::f64::consts::TAU;

/// Two tiles of different sizes. The first tile has runs of coefficients, and a kernel without
/// coefficients. The second tile has coefficients pixel by pixel, and its first function divides
/// the others. The results of the tiles do not overlap. The result of the first tile reaches beyond
/// the panel.
#[derive(Debug)]
pub(super) struct Case {
    pub(super) nx: usize,
    pub(super) ny: usize,
    /// Rows that a workgroup transforms together.
    pub(super) row_group: usize,
    /// True with coefficients. If false, stamps are turned by 180 degrees.
    pub(super) weighted: bool,
    pub(super) tiles: Vec<Tile>,
    pub(super) tables: Vec<u32>,
    pub(super) light: Vec<f32>,
    pub(super) planes: Vec<f32>,
    pub(super) spectra: Vec<f32>,
    pub(super) panel: Vec<f32>,
    pub(super) draws: Vec<Draw>,
    /// Row and column.
    pub(super) pixels: Vec<[i32; 2]>,
    pub(super) amounts: Vec<f32>,
}

pub(super) const STAMP: (usize, usize) = (7, 5);
const KERNELS: [u32; 2] = [3, 2];

impl Case {
    /// Input for planes of `nx x ny` values, with one kernel per tile if `single`.
    pub(super) fn new((nx, ny): (usize, usize), row_group: usize, single: bool, weighted: bool) -> Self {
        let mut numbers = Numbers(0x9e37_79b9);
        let mut reals = |count: usize| -> Vec<f32> { (0..count).map(|_| numbers.next()).collect() };
        let half = ny / 2;
        let kernels = if single { [1, 1] } else { KERNELS };
        let planes = (kernels[0] + kernels[1] + 2) as usize;
        // One tile fills most of its plane, the other fills less than half the rows.
        let sizes = [(nx - 6, ny - 4), (nx / 2 + 1, half - 3)];
        let panel = (nx + 40, 2 * ny + 10);
        let mut tables = runs_table(sizes[0], false, &mut reals);
        let second = tables.len() as u32;
        tables.extend(runs_table(sizes[1], true, &mut reals));
        let tile = |n: usize, light: usize, plane: u32, spectrum: u32| Tile {
            light: light as u32,
            width: sizes[n].0 as u32 - 3,
            height: sizes[n].1 as u32 - 2,
            plane,
            spectrum,
            kernels: kernels[n],
            table: [0, second][n],
            column: 2,
            row: 1,
            out_column: [-3, 20][n],
            out_row: [-2, ny as i32 + 4][n],
            out_width: sizes[n].0 as u32 - 4,
            out_height: sizes[n].1 as u32 - 4,
            skip_column: 1,
            skip_row: 2,
            back: [1.0, 4.0][n],
        };
        let lights = sizes.map(|(columns, rows)| columns * rows);
        let tiles = vec![tile(0, 0, 0, 0), tile(1, lights[0], kernels[0] + 1, kernels[0])];
        let draw = |n: usize| Draw {
            first_pixel: [0, 4][n],
            pixels: [4, 3][n],
            first_amount: [0, 4 * KERNELS[0]][n],
            stamps: [0, KERNELS[0] * (STAMP.0 * STAMP.1) as u32][n],
            kernels: KERNELS[n],
            table: tiles[n].table,
            column: 1,
            row: 1,
            out_column: tiles[n].out_column,
            out_row: tiles[n].out_row,
            out_width: tiles[n].out_width,
            out_height: tiles[n].out_height,
        };
        Self {
            nx,
            ny,
            row_group,
            weighted,
            tables,
            light: reals(lights[0] + lights[1]),
            planes: reals(planes * nx * ny),
            spectra: reals((kernels[0] + kernels[1]) as usize * nx * ny),
            panel: reals(panel.0 * panel.1),
            draws: vec![draw(0), draw(1)],
            // Some stamps begin before the result, some overlap.
            pixels: vec![[-2, -3], [4, 3], [6, 5], [4, 3], [0, 2], [3, 9], [4, 1]],
            amounts: reals(7 * 3),
            tiles,
        }
    }

    pub(super) fn half(&self) -> usize {
        self.ny / 2
    }

    fn panel_size(&self) -> (usize, usize) {
        (self.nx + 40, 2 * self.ny + 10)
    }

    /// `Params` of `common.wgsl`.
    pub(super) fn params(&self) -> [u32; 8] {
        let (columns, rows) = self.panel_size();
        let [columns, rows, nx, ny] = [columns, rows, STAMP.0, STAMP.1].map(|v| v as u32);
        [
            0,
            (!self.weighted).into(),
            self.weighted.into(),
            columns,
            rows,
            nx,
            ny,
            0,
        ]
    }

    /// Every plane of every tile.
    pub(super) fn work(&self) -> Vec<u32> {
        let of_tile = |(n, tile): (usize, &Tile)| {
            (0..tile.kernels)
                .flat_map(move |k| [n as u32, k])
                .collect::<Vec<_>>()
        };
        self.tiles.iter().enumerate().flat_map(of_tile).collect()
    }

    pub(super) fn tile_words(&self) -> Vec<u32> {
        self.tiles.iter().flat_map(|tile| tile.words()).collect()
    }

    pub(super) fn draw_words(&self) -> Vec<u32> {
        self.draws.iter().flat_map(|draw| draw.words()).collect()
    }

    pub(super) fn pixel_words(&self) -> Vec<u32> {
        self.pixels.iter().flatten().map(|v| v.cast_unsigned()).collect()
    }

    pub(super) fn highest(&self) -> u32 {
        self.draws.iter().map(|draw| draw.out_height).max().unwrap_or(0)
    }

    /// A complex value of planes or spectra.
    pub(super) fn complex(&self, values: &[f32], plane: usize, row: usize, column: usize) -> Complex {
        let place = 2 * ((plane * self.half() + row) * self.nx + column);
        [f64::from(values[place]), f64::from(values[place + 1])]
    }

    pub(super) fn set(&self, values: &mut [f64], plane: usize, row: usize, column: usize, value: Complex) {
        let place = 2 * ((plane * self.half() + row) * self.nx + column);
        values[place..place + 2].copy_from_slice(&value);
    }

    /// The transform along y of a tile's column, multiplied by the twist factors first.
    pub(super) fn column(&self, tile: &Tile, plane: usize, column: usize) -> Vec<Complex> {
        let lit = self.half().min(tile.height as usize);
        let values: Vec<Complex> = (0..self.half())
            .map(|row| {
                if row >= lit {
                    return [0.0; 2];
                }
                times(self.complex(&self.planes, plane, row, column), self.turned(row))
            })
            .collect();
        forward(&values)
    }

    /// `exp(i pi row / ny)`.
    pub(super) fn turned(&self, row: usize) -> Complex {
        turn(std::f64::consts::PI * row as f64 / self.ny as f64)
    }

    /// The inverse of [`turned`](Self::turned), divided by the gain of both transforms back.
    pub(super) fn turned_back(&self, row: usize) -> Complex {
        let [re, im] = self.turned(row);
        let gain = (self.nx * self.half()) as f64;
        [re / gain, -im / gain]
    }

    /// Adds to the pixel (`x`, `y`) of the panel, if the pixel lies within the panel.
    pub(super) fn add(&self, panel: &mut [f64], (x, y): (i64, i64), value: f64) {
        let (columns, rows) = self.panel_size();
        if (0..columns as i64).contains(&x) && (0..rows as i64).contains(&y) {
            panel[y as usize * columns + x as usize] += value;
        }
    }
}

pub(super) fn doubles(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

/// A table with three runs per row. With `divides`, it has three functions, and the first is positive
/// and divides the others. Otherwise it has two, and one kernel without a function before them.
fn runs_table(
    (columns, rows): (usize, usize),
    divides: bool,
    reals: &mut impl FnMut(usize) -> Vec<f32>,
) -> Vec<u32> {
    let (runs, functions) = (3 * rows, 2 + usize::from(divides));
    let first_run = 6 + rows + 1;
    let header = [
        functions,
        usize::from(divides),
        usize::from(!divides),
        6,
        first_run,
        first_run + runs,
    ];
    let mut words: Vec<u32> = header.map(|v| v as u32).to_vec();
    words.extend((0..=rows as u32).map(|row| 3 * row));
    words.extend((0..rows as u32).flat_map(|row| [0, columns as u32 / 3 + row % 3, columns as u32 / 2]));
    let steps = columns as f32;
    for _ in 0..runs {
        words.push(steps.to_bits());
        for (i, value) in reals(2 * functions).into_iter().enumerate() {
            // The divisor is positive along the whole run.
            let least = if divides && i < 2 { 1.5 } else { 0.0 };
            words.push(((least + 0.1 * value) / steps).to_bits());
        }
    }
    words
}

/// Numbers between -1 and 1 that look random.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (f64::from(self.0) / f64::from(u32::MAX) * 2.0 - 1.0) as f32
    }
}

/// `Tile` of `common.wgsl`, which explains the fields.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub(super) light: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) plane: u32,
    pub(super) spectrum: u32,
    pub(super) kernels: u32,
    pub(super) table: u32,
    pub(super) column: u32,
    pub(super) row: u32,
    pub(super) out_column: i32,
    pub(super) out_row: i32,
    pub(super) out_width: u32,
    pub(super) out_height: u32,
    pub(super) skip_column: u32,
    pub(super) skip_row: u32,
    pub(super) back: f32,
}

impl Tile {
    pub(super) fn words(self) -> [u32; 16] {
        [
            self.light,
            self.width,
            self.height,
            self.plane,
            self.spectrum,
            self.kernels,
            self.table,
            self.column,
            self.row,
            self.out_column.cast_unsigned(),
            self.out_row.cast_unsigned(),
            self.out_width,
            self.out_height,
            self.skip_column,
            self.skip_row,
            self.back.to_bits(),
        ]
    }
}

/// `Draw` of `draw_stamps.wgsl`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draw {
    pub(super) first_pixel: u32,
    pub(super) pixels: u32,
    pub(super) first_amount: u32,
    pub(super) stamps: u32,
    pub(super) kernels: u32,
    pub(super) table: u32,
    pub(super) column: u32,
    pub(super) row: u32,
    pub(super) out_column: i32,
    pub(super) out_row: i32,
    pub(super) out_width: u32,
    pub(super) out_height: u32,
}

impl Draw {
    pub(super) fn words(self) -> [u32; 12] {
        [
            self.first_pixel,
            self.pixels,
            self.first_amount,
            self.stamps,
            self.kernels,
            self.table,
            self.column,
            self.row,
            self.out_column.cast_unsigned(),
            self.out_row.cast_unsigned(),
            self.out_width,
            self.out_height,
        ]
    }
}

pub(super) type Complex = [f64; 2];

pub(super) fn times(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// `exp(i angle)`.
pub(super) fn turn(angle: f64) -> Complex {
    [angle.cos(), angle.sin()]
}

/// `sum_j v_j exp(sign 2 pi i j k / n)`.
fn transform(values: &[Complex], sign: f64) -> Vec<Complex> {
    let n = values.len();
    (0..n)
        .map(|k| {
            values.iter().enumerate().fold([0.0; 2], |sum, (j, &value)| {
                let turned = times(value, turn(sign * TAU * ((j * k) % n) as f64 / n as f64));
                [sum[0] + turned[0], sum[1] + turned[1]]
            })
        })
        .collect()
}

pub(super) fn forward(values: &[Complex]) -> Vec<Complex> {
    transform(values, -1.0)
}

/// The transform back, without a factor.
pub(super) fn back(values: &[Complex]) -> Vec<Complex> {
    transform(values, 1.0)
}
