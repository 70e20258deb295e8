//! Where samples lie.

use plotters::chart::ChartBuilder;
use plotters::prelude::Circle;
use plotters::style::{BLACK, Color};
use psf_types::{FrameShape, Position};

use super::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, draw_axes, title_room, under_title};
use super::figure::{Figure, PlotError};

const PANEL: u32 = 560;

/// Positions over the field, panels side by side, each with a heading.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn positions_figure(panels: &[(String, &[Position])], frame: FrameShape) -> Result<Figure, PlotError> {
    let (nx, ny) = (frame.nx() as f64, frame.ny() as f64);
    let plot = f64::from(PANEL - LABEL_ROOM_Y - 2 * MARGIN);
    let height = (plot * (ny / nx).clamp(0.3, 2.0)) as u32 + LABEL_ROOM_X + 2 * MARGIN;
    let head = panels
        .iter()
        .map(|(title, _)| title_room(title))
        .max()
        .unwrap_or(0);
    let count = panels.len().max(1);
    Figure::draw((PANEL * count as u32, head + height), |root| {
        for ((title, positions), area) in panels.iter().zip(root.split_evenly((1, count))) {
            let mut chart = ChartBuilder::on(&under_title(&area, title)?)
                .margin(MARGIN)
                .x_label_area_size(LABEL_ROOM_X)
                .y_label_area_size(LABEL_ROOM_Y)
                // Room for the dots on the edge.
                .build_cartesian_2d(-0.02 * nx..1.02 * nx, -0.02 * ny..1.02 * ny)?;
            draw_axes(&mut chart, "x, pixels", "y, pixels")?;
            let spacing = plot / (positions.len().max(1) as f64).sqrt();
            let radius = if spacing > 9.0 { 2 } else { 1 };
            chart.draw_series(
                positions
                    .iter()
                    .map(|p| Circle::new((p.x(), p.y()), radius, BLACK.filled())),
            )?;
        }
        Ok(Vec::new())
    })
}
