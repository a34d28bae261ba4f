"""The four sets of query points that errors are stated for, each a mesh, so that denoising has something to run over.

    inside   the model's points inside the cage, 0.005 diagonals or more from it
    near     the cage's surface moved inwards by 0.0025 diagonals: inside, 0.001 to 0.005 from the cage
    on       the cage's surface: within 1e-6
    outside  the surface moved outwards by 0.05 diagonals: outside, 0.005 or more from the cage

A point counts by what it is, not by where it was meant to be: by its distance to the cage and by the service's own
inside test. Of those that qualify, some are chosen evenly over the mesh's numbering; the errors are theirs.
"""

from dataclasses import dataclass

import numpy as np

from barycast.cage import Faces
from barycast.options import FLAGS

NEAR = 0.005  # design: near is less than this
INWARDS, OUTWARDS = 0.0025, 0.05
THICKNESS = 0.001  # the service's default; nearer points count as on the cage
CANDIDATES_PER_POINT = 20

CRITERIA = {
    "inside": lambda distance, outside: ~outside & (distance >= NEAR),
    "near": lambda distance, outside: ~outside & (distance > THICKNESS) & (distance < NEAR),
    "on": lambda distance, outside: distance < 1e-6,
    "outside": lambda distance, outside: outside & (distance >= NEAR),
}
NAMES = tuple(CRITERIA)


@dataclass(frozen=True, eq=False)
class QuerySet:
    """points: n x 3; faces: the mesh over them; chosen: the points that errors are of; basis: for the set `on`, the
    cage's basis at the chosen ones (p x control vertices); distances: of the chosen ones, in diagonals;
    qualifying: the part of the points examined that meets the criterion."""

    name: str
    points: np.ndarray
    faces: Faces
    chosen: np.ndarray
    distances: np.ndarray
    qualifying: float
    basis: np.ndarray

    @property
    def evaluation_points(self):
        return self.points[self.chosen]


def make_query_set(name, client, cage, surface, model, count):
    """At most `count` chosen points; none where no point qualifies."""
    if name == "inside":
        points, faces = model.points, model.faces
    else:
        step = {"near": -INWARDS, "on": 0.0, "outside": OUTWARDS}[name]
        points, faces = surface.points + step * surface.diagonal * surface.normals, Faces.of(surface.faces)
    candidates = _evenly(np.arange(len(points)), count * CANDIDATES_PER_POINT)
    distances = surface.distances(points[candidates])
    # One walk: the inside test does not depend on it.
    flags = client.bind(cage, points[candidates], samples=1, denoise="none").flags
    meets = CRITERIA[name](distances, (flags & FLAGS["outside"]) != 0)
    taken = _evenly(np.flatnonzero(meets), count)
    chosen = candidates[taken]
    basis = surface.basis[chosen].toarray() if name == "on" else None
    return QuerySet(name, points, faces, chosen, distances[taken], float(meets.mean()), basis)


def _evenly(values, count):
    """At most that many, evenly over their order, the middle of each part."""
    if len(values) <= count:
        return values
    return values[((np.arange(count) + 0.5) * len(values) / count).astype(np.int64)]
