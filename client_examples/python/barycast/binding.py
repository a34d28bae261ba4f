"""A binding: the rows of a model's points as one sparse matrix, and posing with it."""

from __future__ import annotations

import json
import time
import zipfile
from dataclasses import dataclass
from typing import Any, Dict, Optional

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from . import arrays, files
from .errors import InputError
from .exchange import Exchange
from .report import make_report
from .rows import RowCollector


@dataclass(eq=False)
class Binding:
    """Coordinates of n points with respect to a cage of v control vertices.

    matrix: n x v CSR of float32 or float64; rows sum to one. gradients: nnz x d in the order of matrix.data, per unit
    of the caller's length, or None. flags: n uint8, bits of RowFlag. cage_digest: SHA-256 in hexadecimal.
    report: how it was computed, plain values (see report.py). errors: n x 2 float32, or None: the standard error of a
    row's values, and what they are off by at most in 95 of 100 rows; of noise, not of bias.
    """

    matrix: scipy.sparse.csr_matrix
    gradients: Optional[NDArray[Any]]
    flags: NDArray[Any]
    cage_digest: str
    report: Dict[str, Any]
    errors: Optional[NDArray[Any]] = None

    def deform(self, control_vertices: Any) -> NDArray[Any]:
        """n x d float64: the points for posed control vertices (v x d). Throws InputError on another vertex count.

        Evaluated as c + W (V - c), c the centre of the posed cage: rows sum to one, so any c gives the same points,
        and this one keeps float32's rounding relative to the cage's size instead of its distance from the origin.
        """
        posed = arrays.positions(control_vertices, "posed.control_vertices")
        if len(posed) != self.matrix.shape[1]:
            raise InputError(f"the posed cage has {len(posed)} control vertices, the binding's cage has "
                             f"{self.matrix.shape[1]}", field="posed.control_vertices")
        centre = 0.5 * (posed.min(axis=0) + posed.max(axis=0))
        points: NDArray[Any] = centre + self.matrix @ (posed - centre)
        return points

    def save(self, path: files.PathLike) -> None:
        """Writes an .npz that `Binding.load` and `scipy.sparse.load_npz` read; whole or not at all. Throws InputError
        when it cannot be written."""
        matrix = self.matrix
        entries = {"format": np.array(b"csr"), "shape": np.array(matrix.shape), "data": matrix.data,
                   "indices": matrix.indices, "indptr": matrix.indptr, "flags": self.flags,
                   "cage_digest": np.array(self.cage_digest), "report": np.array(json.dumps(self.report))}
        if self.gradients is not None:
            entries["gradients"] = self.gradients
        if self.errors is not None:
            entries["errors"] = self.errors
        files.write_atomically(path, lambda file: np.savez(file, **entries))

    @classmethod
    def load(cls, path: files.PathLike) -> Binding:
        """Reads what `save` wrote. Throws InputError when the file is something else."""
        file = files.read(path)
        try:
            with file, np.load(file, allow_pickle=False) as entries:
                parts = (entries["data"], entries["indices"], entries["indptr"])
                matrix = scipy.sparse.csr_matrix(parts, shape=tuple(entries["shape"]), copy=False)
                matrix.check_format(full_check=True)  # products do not check indices
                gradients = entries["gradients"] if "gradients" in entries else None
                errors = entries["errors"] if "errors" in entries else None
                flags, report = entries["flags"], json.loads(str(entries["report"]))
                if flags.shape != matrix.shape[:1] or (gradients is not None and len(gradients) != matrix.nnz):
                    raise ValueError
                if errors is not None and errors.shape != (matrix.shape[0], 2):
                    raise ValueError
                return cls(matrix, gradients, flags, str(entries["cage_digest"]), report, errors)
        except (KeyError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
            raise InputError("is not a binding; write one with `barycast bind`", field=str(path)) from error


def gathered(collector: RowCollector, computation: Exchange, started: float) -> Binding:
    """The binding of a finished computation; started: monotonic time at which it began."""
    matrix = collector.matrix()
    binding = Binding(matrix, collector.gradients(), collector.flags, computation.cage.digest.sha256.hex(), {},
                      collector.errors)
    binding.report = make_report(computation, matrix.nnz, collector.flags)
    binding.report["seconds"]["total"] = time.monotonic() - started
    return binding
