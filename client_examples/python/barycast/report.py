"""What a binding says about itself: as plain values, and as lines for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Dict, List, Optional

import numpy as np
from numpy.typing import NDArray

from barycast.v1 import barycast_pb2

from .cage import Cage
from .errors import InputError
from .exchange import Exchange
from .options import COORDINATES, ESTIMATORS, PRESETS, describe, flag_names, name_of

if TYPE_CHECKING:
    from .binding import Binding

_WALKS = ("samples", "walk_steps", "walks_capped", "walks_discarded", "walk_reentries")
_COUNTERS = (*_WALKS, "rows_above_target")
_SUMMARIZED = {"options", "seconds", "linear_precision_error_max", "warnings", *_WALKS}


def make_report(computation: Exchange, entry_count: int, flags: NDArray[Any]) -> Dict[str, Any]:
    """From a finished computation. Keys: dimension, points, control_vertices, entries, options (as resolved by the
    server), the counters of Summary, rows (by flag), linear_precision_error_max (diagonals), seconds (by stage),
    cage_cache_hit, numerics_version, build_version, warnings, and resumed_rows: where the computation went on after a
    lost connection; counters, error and seconds are then those of the last part."""
    header, summary = computation.header, computation.summary
    assert header is not None and summary is not None
    report: Dict[str, Any] = {
        "dimension": computation.cage.dimension,
        "points": len(computation),
        "control_vertices": header.control_vertex_count,
        "entries": entry_count,
        "options": describe(header.options, header.output),
        "rows": rows_by_flag(flags),
        "linear_precision_error_max": summary.linear_precision_error_max,
        "seconds": {time.stage: time.seconds for time in summary.times},
        "cage_cache_hit": header.cage_cache_hit,
        "numerics_version": header.numerics_version,
        "build_version": computation.build_version,
        "warnings": [{"field": warning.field, "message": warning.message} for warning in summary.warnings],
        "resumed_rows": list(computation.resumed_rows),
    }
    report.update({name: getattr(summary, name) for name in _COUNTERS})
    return report


def rows_by_flag(flags: NDArray[Any]) -> Dict[str, int]:
    """How many rows carry each flag."""
    return {name.replace("-", "_"): int(np.count_nonzero(flags & (1 << bit))) for bit, name in enumerate(flag_names())}


def statistics(binding: Binding) -> Dict[str, Any]:
    """Recounted from the arrays: points, control_vertices, entries, entries per row (mean, max), rows by flag, errors
    (median and largest standard error, median and largest 95 % bound) where the binding holds any."""
    per_row = np.diff(binding.matrix.indptr)
    values: Dict[str, Any] = {
        "points": binding.matrix.shape[0],
        "control_vertices": binding.matrix.shape[1],
        "entries": int(binding.matrix.nnz),
        "entries_per_row_mean": float(per_row.mean()) if len(per_row) else 0.0,
        "entries_per_row_max": int(per_row.max()) if len(per_row) else 0,
        "rows": rows_by_flag(binding.flags),
    }
    if binding.errors is not None and len(binding.errors):
        medians, worst = np.median(binding.errors, axis=0), binding.errors.max(axis=0)
        values["errors"] = {"standard_median": float(medians[0]), "standard_max": float(worst[0]),
                            "at_95_median": float(medians[1]), "at_95_max": float(worst[1])}
    return values


def linear_precision_error(binding: Binding, cage: Cage, points: NDArray[Any]) -> float:
    """Largest |sum a_v x_v - x| / max(1, |x|) over the rows, in double precision, in the cage's normalized frame:
    origin at the bounding-box centre of the used control vertices, unit its diagonal. points: n x d."""
    used = cage.control_vertices[cage.used]
    low, high = used.min(axis=0), used.max(axis=0)
    centre, diagonal = 0.5 * (low + high), float(np.linalg.norm(high - low))
    x = (points - centre) / diagonal
    error = np.linalg.norm(binding.matrix @ ((cage.control_vertices - centre) / diagonal) - x, axis=1)
    return float((error / np.maximum(1.0, np.linalg.norm(x, axis=1))).max())


def summary_lines(binding: Binding) -> List[str]:
    """A short account of a binding for people. Throws InputError when another program wrote a shorter report."""
    report, counts = binding.report, statistics(binding)
    absent = sorted(_SUMMARIZED.difference(report))
    if absent:
        raise InputError(f"lacks {', '.join(absent)}; bind again with this version", field="report")
    options, seconds = report["options"], report["seconds"]
    stages = ", ".join(f"{stage} {value:.3f}" for stage, value in seconds.items() if stage != "total")
    rows = ", ".join(f'{count:,} {name.replace("_", " ")}' for name, count in counts["rows"].items() if count)
    walks = ", ".join(f"{report[name]:,} {label}" for name, label in
                      (("walk_steps", "walk steps"), ("walks_capped", "capped"), ("walks_discarded", "discarded"),
                       ("walk_reentries", "re-entries")) if report[name])
    lines = [
        f'{counts["points"]:,} points, {counts["control_vertices"]:,} control vertices, {options["coordinates"]}, '
        f'{_method(options)}',
        f'seconds: {seconds.get("total", sum(seconds.values())):.3f} in all ({stages})',
        *([f'samples: {report["samples"]:,}' + (f", {walks}" if walks else "")] if report["samples"] else []),
        f'coordinates per row: {counts["entries_per_row_mean"]:.1f} mean, {counts["entries_per_row_max"]} max',
        f"rows flagged: {rows or 'none'}",
        f'linear-precision error: {report["linear_precision_error_max"]:.1e} diagonals before rounding to '
        f'{options["dtype"]}',
    ]
    if options.get("target_error"):
        lines.append(_errors_line(counts.get("errors"), report.get("rows_above_target", 0), options["target_error"]))
    if report.get("resumed_rows"):
        rows = ", ".join(f"{row:,}" for row in report["resumed_rows"])
        lines.append(f"resumed at row {rows} after lost connections; samples, seconds by stage and the error "
                     "are those of the last part")
    return lines + [f'warning: {warning["field"]}: {warning["message"]}' for warning in report["warnings"]]


def _errors_line(errors: Optional[Dict[str, float]], above: int, target: float) -> str:
    held = f'median {errors["standard_median"]:.1e}, worst {errors["standard_max"]:.1e}; ' if errors else ""
    return f"standard error of rows: {held}{above:,} above the target of {target:g}"


def _method(options: Dict[str, Any]) -> str:
    """How coordinates were found. Reports of the first versions name no estimator: they sampled."""
    estimator = options.get("estimator", "sampling") + (" with tables" if options.get("tables") else "")
    if options.get("target_error"):
        return (f'{estimator} to a standard error of {options["target_error"]:g}, preset {options["preset"]}, '
                f'denoise {options["denoise"]}, seed {options["seed"]}')
    if estimator != "sampling" and not options["samples"]:
        return estimator + (f', at most {options["panels"]:,} panels' if options["panels"] else "")
    named = "" if estimator == "sampling" else f"{estimator}, "
    where = " that no table serves" if options.get("tables") else ""
    return (f'{named}{options["samples"]} samples per point{where}, preset {options["preset"]}, '
            f'denoise {options["denoise"]}, seed {options["seed"]}')


def capability_values(answer: barycast_pb2.GetCapabilitiesResponse) -> Dict[str, Any]:
    """A server's capabilities as plain values; kinds and presets by the names that options take."""
    return {
        "build_version": answer.build_version,
        "numerics_version": answer.numerics_version,
        "coordinates": [name_of(COORDINATES, kind) for kind in answer.coordinates],
        "presets": [name_of(PRESETS, preset) for preset in answer.presets],
        "estimators": [name_of(ESTIMATORS, estimator) for estimator in answer.estimators],
        "elements": {str(support.dimension): list(support.kinds) for support in answer.elements},
        "limits": {field.name: getattr(answer.limits, field.name) for field in answer.limits.DESCRIPTOR.fields},
    }


def capability_lines(answer: barycast_pb2.GetCapabilitiesResponse) -> List[str]:
    """The same for people."""
    values = capability_values(answer)
    lines = [
        f'barycastd {values["build_version"]}, numerics version {values["numerics_version"]}',
        f'coordinates: {", ".join(values["coordinates"]) or "none"}',
        f'presets: {", ".join(values["presets"]) or "none"}',
        f'estimators: {", ".join(values["estimators"]) or "none"}',
    ]
    lines += [f'elements of cages in {dimension} dimensions: {", ".join(kinds)}'
              for dimension, kinds in values["elements"].items()]
    return lines + [f'at most: {limit:,} {_limit_words(name)}' for name, limit in values["limits"].items()]


def _limit_words(name: str) -> str:
    """"cage_bytes_max" -> "bytes of a cage"."""
    known = {
        "cage_bytes_max": "bytes of a cage", "points_max": "points of a request", "faces_max": "faces of a request",
        "samples_max": "samples per point", "block_rows_max": "rows per block", "message_bytes_max":
        "bytes of a message to the server", "digests_max": "digests of a question for missing cages",
        "request_bytes_max": "bytes of working memory of a request",
    }
    return known.get(name, name.replace("_max", "").replace("_", " "))
