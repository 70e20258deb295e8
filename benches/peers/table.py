"""The results as a table and as JSON."""


def rows(entries, size, grid):
    """One dictionary per method, as written to JSON."""
    unit = next((e.minimum for e in entries if e.method.name == "single"), None)
    out = []
    for entry in entries:
        out.append(
            {
                "method": entry.method.name,
                "detail": entry.method.describe(),
                "size": [size, size],
                "grid": [grid, grid],
                "seconds_prepare": entry.prepare,
                "seconds_min": entry.minimum,
                "seconds_median": entry.median,
                "seconds_processor": min(entry.processor),
                "ratio_to_single": None if unit is None else entry.minimum / unit,
                "relative_l2": entry.error,
                "relative_l2_own_model": entry.own_error,
            }
        )
    return out


def show(title, results):
    print(f"\n{title}")
    print(
        f"{'method':<20} {'prepare s':>10} {'min s':>9} {'median s':>9} {'cpu s':>9} {'ratio':>8} {'rel. L2':>9} {'own model':>9}  detail"
    )
    for row in results:
        print(
            f"{row['method']:<20} {_number(row['seconds_prepare'], '10.2f')} {_number(row['seconds_min'], '9.4f')} "
            f"{_number(row['seconds_median'], '9.4f')} {_number(row['seconds_processor'], '9.4f')} "
            f"{_number(row['ratio_to_single'], '8.2f')} "
            f"{_number(row['relative_l2'], '9.1e')} {_number(row['relative_l2_own_model'], '9.1e')}  {row['detail']}"
        )


def _number(value, form):
    return "-".rjust(int(form.split(".")[0])) if value is None else format(value, form)
