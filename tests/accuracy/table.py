"""The records as lines for people."""

HEAD = (f'{"coordinates":19} {"preset":16} {"m":>5} {"denoise":7} {"set":7} {"E rms":>8} {"median":>8} {"99 %":>8} '
        f'{"worst":>8} {"bias":>8} {"noise":>8} {"ref.":>8} {"gradient":>8} {"linear":>8} {"seconds":>8} '
        f'{"samples":>10}')


def line_of(record):
    def number(value):
        return f"{'-':>8}" if value is None else f"{value:8.1e}" if 0 < abs(value) < 1e-3 else f"{value:8.4f}"

    bias = number(record["bias"])
    if record["bias_found"] is False:
        bias = f"{'<' + number(record['bias_below']).strip():>8}"
    shown = [number(record[name]) for name in ("E_rms", "E_median", "E_p99", "E_worst", "noise", "reference_error",
                                               "gradient_error", "linear_precision_error", "seconds")]
    shown.insert(4, bias)
    panels = record["options"]["panels"]
    denoise = record["denoise"] if record["m"] else f"{panels} p." if panels else "-"
    return (f'{record["coordinates"]:19} {record["preset"]:16} {record["m"] or "-":>5} {denoise:7} {record["set"]:7} '
            f'{" ".join(shown)} {record["samples"]:10,}')
