"""What is right: reference coordinates at the chosen points of a query set.

Computed once and kept in a folder, by cage, kind, points, sizes and the service's version. After a change to the
service that does not move its version, empty the folder.

    on the cage          the basis: every kind interpolates it
    harmonic             the service's boundary elements, with many panels; gradients near a closed cage, where those
                         of boundary elements converge slowly, by `reference_rows` where it is built: predictions
                         corrected by many walks
    mean value           the service's closed form for closed cages of triangles and polygons; for closed cages with
                         quads quadrature by `reference_rows`; none for open cages
    positive mean value  `reference_rows`: brute-force visibility in many directions

The reference's own error is E between it and the same with half the panels, or a quarter of the directions: more than
the error itself where the method converges; 0 where it is exact but for rounding. Of gradients by walks it is the
difference to a quarter of them.
"""

import hashlib
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Optional

import numpy as np

from surface import Elements

TIMEOUT_SECONDS = 1800
GRADIENT_WALKS = 20000
# Of reference_rows.
METHODS = {"mean-value": "mean_value", "positive-mean-value": "positive", "harmonic": "harmonic_gradients"}


class NoReference(Exception):
    """Why there is none, as a sentence."""


@dataclass(frozen=True, eq=False)
class Reference:
    """values: p x control vertices. own_error: in E. method: its name and size. gradients: p x control vertices x 3 per
    unit of length, or None where the method has none; gradient_own_error: as the errors of gradients are stated."""

    values: np.ndarray
    own_error: float
    method: str
    gradients: Optional[np.ndarray] = None
    gradient_own_error: Optional[float] = None


def write_job(path, elements, points):
    """The file that `reference_rows` reads."""
    with open(path, "wb") as file:
        for array in (np.asarray(elements.nodes, "f8"), np.asarray(elements.triangles, "u4"),
                      np.asarray(elements.quads, "u4"), np.asarray(points, "f8")):
            file.write(np.uint64(array.size).tobytes() + np.ascontiguousarray(array).tobytes())


def dense_gradients(binding):
    """p x control vertices x 3 from a binding's entries."""
    gradients = np.zeros((*binding.matrix.shape, binding.gradients.shape[1]))
    rows = np.repeat(np.arange(binding.matrix.shape[0]), np.diff(binding.matrix.indptr))
    gradients[rows, binding.matrix.indices] = binding.gradients
    return gradients


def row_error(values, reference):
    """E: the root mean square over points of the distance between rows."""
    return float(np.sqrt(((values - reference) ** 2).sum(axis=1).mean()))


def gradient_error(gradients, reference):
    """The root mean square of the difference over that of the reference."""
    return float(np.sqrt(((gradients - reference) ** 2).mean() / (reference**2).mean()))


class References:
    """Computes references of one cage, or finds them in `folder`. client: of the service; program: reference_rows."""

    def __init__(self, client, cage, folder, program, panels, directions):
        self._client, self._cage = client, cage
        self._elements = Elements.of(cage)
        self._folder, self._program = Path(folder), Path(program)
        self._panels, self._directions = panels, directions
        server = client.capabilities()
        self._version = f"{server.build_version} {server.numerics_version}"

    def get(self, kind, points, label, basis=None):
        """The reference of a kind of coordinates at points (p x 3). label: what they are, for the file's name. basis:
        the cage's basis there, for points on the cage. Raises NoReference."""
        settings = f"3 {self._panels} {self._directions} {basis is not None} {self._version}"
        key = hashlib.sha256(settings.encode() + points.tobytes()).hexdigest()[:12]
        digest = self._cage.digest.sha256.hex()[:12]
        path = self._folder / f"{digest}-{label}-{kind}-{key}.npz"
        if path.exists():
            with np.load(path) as stored:
                return Reference(**{name: value if value.ndim else value.item() for name, value in stored.items()})
        reference = self._compute(kind, points, basis, near=label == "near")
        self._folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, **{name: value for name, value in vars(reference).items() if value is not None})
        return reference

    def _compute(self, kind, points, basis, near):
        if basis is not None:
            return self._on_cage(kind, points, basis)
        if kind == "harmonic":
            return self._harmonic(points, near)
        if kind == "mean-value":
            if not self._elements.closed():
                raise NoReference("mean-value: the cage is not closed, which quadrature and the closed form need")
            if len(self._cage.quads) == 0:
                binding = self._solve(points, kind, estimator="exact")
                return Reference(binding.matrix.toarray(), 0.0, "closed form", dense_gradients(binding), 0.0)
            return Reference(self._rows(kind, 0, points), 0.0, "quadrature")
        fine, coarse = (self._rows(kind, count, points) for count in (self._directions, self._directions // 4))
        return Reference(fine, row_error(coarse, fine), f"visibility, {self._directions} directions")

    def _on_cage(self, kind, points, basis):
        """Gradients there are one-sided, from the method that has them."""
        gradients = own_error = None
        if kind == "harmonic":
            solved = self._harmonic(points, near=False)
            gradients, own_error = solved.gradients, solved.gradient_own_error
        elif kind == "mean-value" and len(self._cage.quads) == 0 and self._elements.closed():
            gradients, own_error = dense_gradients(self._solve(points, kind, estimator="exact")), 0.0
        return Reference(basis, 0.0, "basis", gradients, own_error)

    def _harmonic(self, points, near):
        fine, coarse = (self._solve(points, "harmonic", estimator="boundary-element", panels=panels)
                        for panels in (self._panels, self._panels // 2))
        values, gradients, others = fine.matrix.toarray(), dense_gradients(fine), dense_gradients(coarse)
        method = f"boundary elements, at most {self._panels} panels"
        if near and self._elements.closed() and self._program.is_file():
            gradients, others = (self._gradients_near(walks, points) for walks in (GRADIENT_WALKS, GRADIENT_WALKS // 4))
            method += f"; gradients by {GRADIENT_WALKS} walks"
        return Reference(values, row_error(coarse.matrix.toarray(), values), method, gradients,
                         gradient_error(others, gradients))

    def _solve(self, points, kind, **options):
        return self._client.bind(self._cage, points, coordinates=kind, gradients=True, dtype="float64",
                                 prune_below=0.0, **options)

    def _gradients_near(self, walks, points):
        rows = self._rows("harmonic", walks, points, parts=3)
        return np.moveaxis(rows.reshape(len(points), 3, -1), 1, 2)

    def _rows(self, kind, argument, points, parts=1):
        """By reference_rows: points x control vertices, or so many parts of that, side by side. It takes triangles and
        quads: polygons go as fans about a vertex of their own, whose column is then handed on to the corners."""
        if not self._program.is_file():
            raise NoReference(f"{kind}: there is no program {self._program}; build it by `cmake --build build "
                              "--target reference_rows` or name it with --reference-rows")
        elements = self._elements
        with tempfile.TemporaryDirectory() as folder:
            job, out = Path(folder) / "job", Path(folder) / "rows"
            write_job(job, elements, points)
            done = subprocess.run([self._program, job, METHODS[kind], str(argument), out], capture_output=True,
                                  text=True, timeout=TIMEOUT_SECONDS)
            if done.returncode:
                raise NoReference(f"{kind}: {done.stderr.strip()}")
            rows = np.fromfile(out, "<f8").reshape(parts * len(points), len(elements.nodes))
        if not np.isfinite(rows).all():
            raise NoReference(f"{kind}: a row is not a number")
        return np.asarray(rows @ elements.stencil).reshape(len(points), -1)
