
// Columns of planes that have been transformed along x.

var<private> tile: Tile;
var<private> plane: u32;
var<private> first_column: u32;

// Returns a value for the transform along y, times the factor that makes planes negacyclic in y.
// Rows without light are not read.
fn load(line: u32, row: u32) -> vec2f {
    if (row >= min(tile.height, HALF)) {
        return vec2f(0.0);
    }
    return times(planes[(plane * HALF + row) * NX + first_column + line], roots[TWIST + row]);
}
