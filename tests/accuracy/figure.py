"""Error against samples and against time, from the records of accuracy.py: a row of panels per kind of coordinates and
axis, a column per query set; of a single set a row per kind, a column per axis."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend comes first)
from matplotlib.ticker import NullFormatter  # noqa: E402

COLOURS = {"paper": "#b03a2e", "paper-300": "#d68910", "sampling": "#1f618d", "boundary-element": "#117a65",
           "exact": "#6c3483", "predicted": "#17202a"}
STYLES = {"auto": "-", "none": "--"}
ROUNDING = 1e-9  # below it there is nothing to see: rows on the cage are the basis


def draw(records, path, title):
    """One line per preset and smoothing, smoothed solid, raw dashed; deterministic estimators are levels. Against time
    only requests for whole meshes are drawn: those for the evaluation points alone tell no time."""
    records = [record for record in records if record["E_rms"] > ROUNDING]
    rows = [(kind, across) for kind in _values(records, "coordinates") for across in ("m", "seconds")
            if any(_shown(record, kind, across) for record in records)]
    sets = _values(records, "set")
    if not rows:
        return
    panels = [(kind, across, name) for kind, across in rows for name in sets]
    width = 2 if len(sets) == 1 and len(rows) % 2 == 0 else len(sets)
    height = len(panels) // width
    plots, axes = plt.subplots(height, width, figsize=(max(3.2 * width, 8.0), 2.7 * height), squeeze=False,
                               constrained_layout=True)
    for axis, (kind, across, name) in zip(axes.flat, panels):
        _panel(axis, [r for r in records if r["set"] == name and _shown(r, kind, across)], across)
        if across == "m":
            for record in records:  # a level that no number of samples moves
                if (record["coordinates"], record["set"], record["m"]) == (kind, name, None):
                    axis.axhline(record["E_rms"], color=COLOURS[record["preset"]], linewidth=0.8)
        axis.set_title(f"{kind}, {name}", fontsize=9)
        axis.set_xlabel("samples per point" if across == "m" else "seconds, the whole mesh", fontsize=8)
    for line in axes:
        line[0].set_ylabel("E, root mean square", fontsize=8)
    handles = [plt.Line2D([], [], color=COLOURS[preset], label=preset) for preset in _values(records, "preset")]
    handles += [plt.Line2D([], [], color="black", linestyle=STYLES[denoise], label=label)
                for denoise, label in (("auto", "denoised"), ("none", "raw"))
                if any(r["denoise"] == denoise and r["m"] for r in records)]
    plots.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), ncol=len(handles), fontsize=8,
                 frameon=False)
    plots.suptitle(title, fontsize=10)
    plots.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(plots)


def _shown(record, kind, across):
    return record["coordinates"] == kind and (record["m"] if across == "m" else record["whole_mesh"])


def _panel(axis, records, across):
    for preset, denoise in dict.fromkeys((r["preset"], r["denoise"]) for r in records):
        line = sorted((r[across], r["E_rms"]) for r in records if (r["preset"], r["denoise"]) == (preset, denoise))
        axis.plot(*zip(*line), STYLES[denoise], color=COLOURS[preset], marker="o", markersize=3, linewidth=1.2)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for span, limits in ((axis.get_xlim, axis.set_xlim), (axis.get_ylim, axis.set_ylim)):
        low, high = span()
        if high < 10 * low:  # a decade at least, so that there is a labelled tick
            middle = (low * high) ** 0.5
            limits(middle / 10**0.55, middle * 10**0.55)
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.grid(True, which="both", linewidth=0.3, alpha=0.6)
    axis.tick_params(labelsize=7)


def _values(records, name):
    """Distinct values, in order of appearance."""
    return list(dict.fromkeys(record[name] for record in records))
