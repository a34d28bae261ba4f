"""One line of the table: estimates through the service, and their figures of merit against a reference.

E of a point is sqrt(sum_v (alpha_v - ref_v)^2). Over S seeds, noise^2 is the mean over points of the sample variance
summed over v, and bias^2 = mean over points of |mean alpha - ref|^2 - noise^2 / S, so that bias^2 + noise^2 = E rms^2.
The spread over points says how well bias^2 is known. bias_below is the bound that two standard errors put on the bias;
where bias^2 itself is less than two standard errors, that bound is all that is known (and bias is 0 where bias^2 came
out negative). A bias includes the reference's own error.
"""

import numpy as np
import scipy.sparse
from references import dense_gradients, gradient_error

from barycast import Binding
from barycast.options import FLAGS

COUNTED_FLAGS = ("few-samples", "no-samples", "rank-deficient")


def figures(values, gradients, reference):
    """values: S x p x v; gradients: S x p x v x 3. E_rms, E_median, E_p99, E_worst; noise, bias, bias_below, bias_found
    (None with one seed); gradient_error, over all points together, and gradient_error_median, of the points one by one,
    which singular gradients at the cage's edges do not dominate (None where the reference has no gradients)."""
    squared = ((values - reference.values) ** 2).sum(axis=2)
    errors = np.sqrt(squared)
    split = {"noise": None, "bias": None, "bias_below": None, "bias_found": None}
    if len(values) > 1:
        noise_squared = values.var(axis=0, ddof=1).sum(axis=1)
        bias_squared = squared.mean(axis=0) - noise_squared
        mean, spread = bias_squared.mean(), bias_squared.std() / np.sqrt(len(bias_squared))
        split = {"noise": float(np.sqrt(noise_squared.mean())), "bias": float(np.sqrt(max(0.0, mean))),
                 "bias_below": float(np.sqrt(max(0.0, mean) + 2 * spread)), "bias_found": bool(mean > 2 * spread)}
    slopes = {"gradient_error": None, "gradient_error_median": None}
    if reference.gradients is not None:
        sizes = np.sqrt(((gradients - reference.gradients) ** 2).sum(axis=(2, 3)))
        slopes = {"gradient_error": gradient_error(gradients, reference.gradients), "gradient_error_median": float(
            np.median(sizes / np.sqrt((reference.gradients**2).sum(axis=(1, 2)))))}
    return {"E_rms": float(np.sqrt(squared.mean())), "E_median": float(np.median(errors)),
            "E_p99": float(np.percentile(errors, 99)), "E_worst": float(errors.max()), **split,
            "reference_error": reference.own_error, **slopes,
            "reference_gradient_error": reference.gradient_own_error}


def linear_precision_error(values, points, cage):
    """Largest |sum alpha_v x_v - x| / max(1, |x|) over seeds and points, in the cage's normalized frame."""
    used = cage.control_vertices[cage.used]
    low, high = used.min(axis=0), used.max(axis=0)
    centre, diagonal = (low + high) / 2, np.linalg.norm(high - low)
    x = (points - centre) / diagonal
    gap = np.linalg.norm(values @ ((cage.control_vertices - centre) / diagonal) - x, axis=2)
    return float((gap / np.maximum(1.0, np.linalg.norm(x, axis=1))).max())


def measure(client, cage, query, reference, kind, setting, seeds, whole):
    """The record of one line of the table. setting: the preset's name, m or None for an estimator without samples,
    denoise, options of bind. seeds: how many, from 0 on. whole: bind all of the set's mesh even without denoising."""
    name, m, denoise, options = setting
    whole = whole or denoise == "auto"
    points, faces, rows = ((query.points, query.faces, query.chosen) if whole else
                           (query.evaluation_points, None, np.arange(len(query.chosen))))
    values, gradients, reports, flags = [], [], [], []
    for seed in range(seeds if m else 1):
        binding = client.bind(cage, points, faces, coordinates=kind, seed=seed, gradients=True, dtype="float64",
                              **options)
        values.append(binding.matrix[rows].toarray())
        gradients.append(chosen_gradients(binding, rows))
        flags.append(binding.flags[rows])
        reports.append(binding.report)
    seconds = [report["seconds"]["total"] for report in reports]
    middle = reports[int(np.argsort(seconds)[len(seconds) // 2])]
    return {"coordinates": kind, "preset": name, "m": m, "denoise": denoise, "set": query.name,
            **figures(np.array(values), np.array(gradients), reference), "reference": reference.method,
            "panels": middle["options"]["panels"] or None,
            "linear_precision_error": linear_precision_error(np.array(values), query.evaluation_points, cage),
            "seconds": float(np.median(seconds)), "seconds_by_stage": middle["seconds"], "samples": middle["samples"],
            "seeds": len(values), "points": len(rows), "points_bound": len(points), "whole_mesh": whole,
            "rows_flagged": {flag: int(np.count_nonzero(np.array(flags) & FLAGS[flag])) for flag in COUNTED_FLAGS},
            "distance_min": float(query.distances.min()), "distance_median": float(np.median(query.distances)),
            "options": middle["options"]}


def chosen_gradients(binding, rows):
    """Dense gradients of some rows: those of all the rows of a whole mesh would take gigabytes."""
    matrix = binding.matrix
    places = np.arange(1, matrix.nnz + 1)  # from 1 on: a zero would be no entry
    numbers = scipy.sparse.csr_matrix((places, matrix.indices, matrix.indptr), shape=matrix.shape)[rows]
    return dense_gradients(Binding(numbers, binding.gradients[numbers.data - 1], binding.flags[rows], "", {}))
