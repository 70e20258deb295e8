//! What shaders read, as words.

/// A tile and the kernels that a batch applies to it: `Tile` of `common.wgsl`, which says what the fields are.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
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
    pub(super) fn words(&self) -> [u32; 16] {
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

/// What holds for a dispatch: `Params` of `common.wgsl`.
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
    pub(super) fn words(&self) -> [u32; 12] {
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
