// Coefficients of a block's kernels as functions along its rows.

// Offsets of the words in a table's header, which `CoefficientTable::packed` explains.
const FUNCTIONS: u32 = 0u;
const DIVIDES: u32 = 1u;
const PLAIN: u32 = 2u;
const ROW_STARTS: u32 = 3u;
const RUNS: u32 = 4u;
const VALUES: u32 = 5u;

fn real(place: u32) -> f32 {
    return bitcast<f32>(tables[place]);
}

// Returns the index of the run that holds a column: the last of the row's runs that begins at this
// column or before it.
fn run_of(table: u32, row: u32, column: u32) -> u32 {
    let starts = table + tables[table + ROW_STARTS] + row;
    let columns = table + tables[table + RUNS];
    var low = tables[starts];
    var high = tables[starts + 1u];
    while (low + 1u < high) {
        let middle = (low + high) / 2u;
        if (tables[columns + middle] <= column) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

fn function_value(table: u32, function: u32, row: u32, column: u32) -> f32 {
    let values = table + tables[table + VALUES];
    let run = run_of(table, row, column);
    let of_run = values + run * (1u + 2u * tables[table + FUNCTIONS]);
    let place = of_run + 1u + 2u * function;
    let from_start = f32(column - tables[table + tables[table + RUNS] + run]);
    // No term cancels another, so that the faint end of a run keeps its relative accuracy.
    return (real(of_run) - from_start) * real(place) + from_start * real(place + 1u);
}

// Multiplies a value by the coefficient of a kernel at a pixel of the block.
fn weighted(value: f32, table: u32, kernel: u32, row: u32, column: u32) -> f32 {
    let plain = tables[table + PLAIN];
    if (kernel < plain) {
        return value;
    }
    let divides = tables[table + DIVIDES];
    let product = value * function_value(table, kernel - plain + divides, row, column);
    if (divides == 0u) {
        return product;
    }
    return product / function_value(table, 0u, row, column);
}
