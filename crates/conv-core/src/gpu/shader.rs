//! The shaders by name, and the data that they read.

/// Defines the shaders with their names. Each has a file of this name in `shaders`.
macro_rules! shaders {
    ($count:literal: $($shader:ident = $name:literal),+) => {
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum Shader {
            $($shader),+
        }

        impl Shader {
            pub(super) const ALL: [Self; $count] = [$(Self::$shader),+];

            pub(super) fn name(self) -> &'static str {
                match self {
                    $(Self::$shader => $name),+
                }
            }

            pub(super) fn text(self) -> &'static str {
                match self {
                    $(Self::$shader => include_str!(concat!("shaders/", $name, ".wgsl"))),+
                }
            }
        }
    };
}

shaders!(7:
    WeighRows = "weigh_rows",
    SpectrumColumns = "spectrum_columns",
    SumColumns = "sum_columns",
    SpreadColumns = "spread_columns",
    AddRows = "add_rows",
    GatherRows = "gather_rows",
    DrawStamps = "draw_stamps"
);

impl Shader {
    pub(super) fn is_of_columns(self) -> bool {
        matches!(
            self,
            Self::SpectrumColumns | Self::SumColumns | Self::SpreadColumns
        )
    }

    pub(super) fn adds_to_panel(self) -> bool {
        matches!(self, Self::AddRows | Self::GatherRows | Self::DrawStamps)
    }

    pub(super) fn has_coefficients(self) -> bool {
        matches!(self, Self::WeighRows | Self::GatherRows | Self::DrawStamps)
    }
}

/// The number of threads of a workgroup that draws stamps.
pub(super) const DRAWING_THREADS: usize = 64;
/// Each workgroup that draws stamps adds them to this number of rows of a result.
pub(super) const STRIP: usize = 8;

/// The kernels that a batch applies to a tile, and the place of the result. These are the common
/// fields of `Tile` in `common.wgsl`, which explains them, and of `Draw` in `draw_stamps.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Place {
    pub(super) kernels: u32,
    pub(super) table: u32,
    /// Column and row.
    pub(super) corner: (usize, usize),
    /// First column and row of the result.
    pub(super) out: (i32, i32),
    /// Columns and rows of the result.
    pub(super) size: (usize, usize),
}

impl Place {
    fn words(&self) -> [u32; 8] {
        let Self { kernels, table, .. } = *self;
        let [column, row] = [self.corner.0 as u32, self.corner.1 as u32];
        let [x, y] = [self.out.0.cast_unsigned(), self.out.1.cast_unsigned()];
        let [width, height] = [self.size.0 as u32, self.size.1 as u32];
        [kernels, table, column, row, x, y, width, height]
    }
}

/// A tile and the kernels that a batch applies to it: `Tile` of `common.wgsl`, which explains the
/// fields.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Tile {
    pub(super) light: usize,
    /// Width and height.
    pub(super) size: (usize, usize),
    pub(super) plane: usize,
    pub(super) spectrum: usize,
    pub(super) place: Place,
    /// Column and row.
    pub(super) skip: (usize, usize),
    pub(super) back: f32,
}

impl Tile {
    pub(super) fn words(&self) -> Vec<u32> {
        let (light, (width, height)) = (self.light, self.size);
        let first = [light, width, height, self.plane, self.spectrum].map(|v| v as u32);
        let last = [self.skip.0 as u32, self.skip.1 as u32, self.back.to_bits()];
        [&first[..], &self.place.words(), &last].concat()
    }
}

/// The parameters of a dispatch: `Params` of `common.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Params {
    pub(super) first: u32,
    pub(super) flip: bool,
    pub(super) weighted: bool,
    /// Columns and rows.
    pub(super) panel: (usize, usize),
    /// Columns and rows.
    pub(super) stamp: (usize, usize),
}

impl Params {
    pub(super) fn words(&self) -> [u32; 8] {
        [
            self.first,
            self.flip.into(),
            self.weighted.into(),
            self.panel.0 as u32,
            self.panel.1 as u32,
            self.stamp.0 as u32,
            self.stamp.1 as u32,
            0,
        ]
    }
}

/// A tile whose single pixels are drawn: `Draw` of `draw_stamps.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Draw {
    pub(super) first_pixel: usize,
    pub(super) pixels: usize,
    pub(super) first_amount: usize,
    pub(super) stamps: usize,
    pub(super) place: Place,
}

impl Draw {
    pub(super) fn words(&self) -> Vec<u32> {
        let first = [self.first_pixel, self.pixels, self.first_amount, self.stamps];
        [&first.map(|v| v as u32)[..], &self.place.words()].concat()
    }
}
