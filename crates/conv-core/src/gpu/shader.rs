//! The shaders by name.

/// The shaders; each has a file of this name in `shaders`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shader {
    WeighRows,
    SpectrumColumns,
    SumColumns,
    SpreadColumns,
    AddRows,
    GatherRows,
    DrawStamps,
}

impl Shader {
    pub(super) const ALL: [Self; 7] = [
        Self::WeighRows,
        Self::SpectrumColumns,
        Self::SumColumns,
        Self::SpreadColumns,
        Self::AddRows,
        Self::GatherRows,
        Self::DrawStamps,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::WeighRows => "weigh_rows",
            Self::SpectrumColumns => "spectrum_columns",
            Self::SumColumns => "sum_columns",
            Self::SpreadColumns => "spread_columns",
            Self::AddRows => "add_rows",
            Self::GatherRows => "gather_rows",
            Self::DrawStamps => "draw_stamps",
        }
    }

    pub(super) fn text(self) -> &'static str {
        match self {
            Self::WeighRows => include_str!("shaders/weigh_rows.wgsl"),
            Self::SpectrumColumns => include_str!("shaders/spectrum_columns.wgsl"),
            Self::SumColumns => include_str!("shaders/sum_columns.wgsl"),
            Self::SpreadColumns => include_str!("shaders/spread_columns.wgsl"),
            Self::AddRows => include_str!("shaders/add_rows.wgsl"),
            Self::GatherRows => include_str!("shaders/gather_rows.wgsl"),
            Self::DrawStamps => include_str!("shaders/draw_stamps.wgsl"),
        }
    }

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

/// Threads that draw stamps, and the rows of a tile that they draw to.
pub(super) const DRAWING_THREADS: usize = 64;
pub(super) const STRIP: usize = 8;
