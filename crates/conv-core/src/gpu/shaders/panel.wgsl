
// Adds a value to a pixel of a tile's result if the pixel lies within the panel.
fn add_to_panel(out_row: i32, out_column: i32, row: u32, column: u32, value: f32) {
    let y = out_row + i32(row);
    let x = out_column + i32(column);
    if (y < 0 || y >= i32(params.panel_height) || x < 0 || x >= i32(params.panel_width)) {
        return;
    }
    panel[u32(y) * params.panel_width + u32(x)] += value;
}
