#!/usr/bin/env python3
"""Error of a binding against reference coordinates: reference_error.py BIND.npz REFERENCE.npz

Prints E = sqrt(mean over reference points of sum_v (alpha_v - ref_v)^2), its median and its worst point, for the kind of
coordinates that the binding holds. The reference holds `index` (points of the model) and `harmonic`, `mean_value`,
`positive_mean_value` (points x control vertices).
"""
import json
import sys

import numpy as np
import scipy.sparse


def point_errors(matrix, reference, kind="harmonic"):
    """sqrt(sum_v (alpha_v - ref_v)^2) of every reference point; matrix has one row per reference point."""
    return np.sqrt((np.asarray(matrix.todense() - reference[kind]) ** 2).sum(axis=1))


def summary(errors):
    return {"rms": float(np.sqrt((errors**2).mean())), "median": float(np.median(errors)), "worst": float(errors.max())}


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    reference = np.load(sys.argv[2])
    kind = json.loads(str(np.load(sys.argv[1])["report"]))["options"]["coordinates"].replace("-", "_")
    rows = scipy.sparse.load_npz(sys.argv[1])[reference["index"]]
    print("E " + " ".join(f"{name} {value:.4f}" for name, value in summary(point_errors(rows, reference, kind)).items()))
