"""The figures of merit of estimates against a reference, as plain values.

E of a point is sqrt(sum_v (alpha_v - ref_v)^2). Over S seeds, noise^2 is the mean over points of the sample variance
summed over v, and bias^2 = mean over points of |mean alpha - ref|^2 - noise^2 / S, so that bias^2 + noise^2 = E rms^2.
The spread over points says how well bias^2 is known. bias_below is the bound that two standard errors put on the bias;
where bias^2 itself is less than two standard errors, that bound is all that is known (and bias is 0 where bias^2 came out
negative).
"""

import numpy as np


def figures(values, gradients, reference):
    """values: S x p x v; gradients: S x p x v x 3 or None. E_rms, E_median, E_p99, E_worst; noise, bias (None with one
    seed), bias_below, bias_found: whether it is more than its own error; gradient_error: root mean square of the difference over that of the reference (None without)."""
    squared = ((values - reference.values) ** 2).sum(axis=2)
    errors = np.sqrt(squared)
    gradient_error = None
    split = {"noise": None, "bias": None, "bias_below": None, "bias_found": None}
    if len(values) > 1:
        noise_squared = values.var(axis=0, ddof=1).sum(axis=1)
        bias_squared = squared.mean(axis=0) - noise_squared
        mean, spread = bias_squared.mean(), bias_squared.std() / np.sqrt(len(bias_squared))
        split = {"noise": float(np.sqrt(noise_squared.mean())), "bias": float(np.sqrt(max(0.0, mean))),
                 "bias_below": float(np.sqrt(max(0.0, mean) + 2 * spread)), "bias_found": bool(mean > 2 * spread)}
    if gradients is not None and reference.gradients is not None:
        gradient_error = float(np.sqrt(((gradients - reference.gradients) ** 2).mean()
                                       / (reference.gradients**2).mean()))
    return {"E_rms": float(np.sqrt(squared.mean())), "E_median": float(np.median(errors)),
            "E_p99": float(np.percentile(errors, 99)), "E_worst": float(errors.max()), **split,
            "reference_error": reference.own_error, "gradient_error": gradient_error}


def linear_precision_error(values, points, cage):
    """Largest |sum alpha_v x_v - x| / max(1, |x|) over seeds and points, in the cage's normalized frame."""
    used = cage.control_vertices[cage.used]
    low, high = used.min(axis=0), used.max(axis=0)
    centre, diagonal = (low + high) / 2, np.linalg.norm(high - low)
    x = (points - centre) / diagonal
    gap = np.linalg.norm(values @ ((cage.control_vertices - centre) / diagonal) - x, axis=2)
    return float((gap / np.maximum(1.0, np.linalg.norm(x, axis=1))).max())
