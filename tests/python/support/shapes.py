"""Small cages and models that tests generate."""

import numpy as np

from barycast import Cage

BOX_QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


def box_vertices() -> np.ndarray:
    """8 x 3, corner i at the bits of i (x lowest)."""
    return np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], np.float64)


def box_cage() -> Cage:
    """The unit cube as six quads, oriented outwards. Its harmonic coordinates are the trilinear ones."""
    return Cage.from_faces(box_vertices(), BOX_QUADS)


def trilinear(points: np.ndarray) -> np.ndarray:
    """n x 8: the exact harmonic coordinates of the unit cube."""
    factors = [np.stack([1 - points[:, axis], points[:, axis]]) for axis in range(3)]
    return np.stack([factors[0][i & 1] * factors[1][i >> 1 & 1] * factors[2][i >> 2] for i in range(8)], axis=1)


def points_inside(count: int, seed: int = 1) -> np.ndarray:
    """count x 3, at least 0.1 from the cube's faces."""
    return 0.1 + 0.8 * np.random.default_rng(seed).random((count, 3))


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = ["v " + " ".join(repr(float(x)) for x in vertex) for vertex in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"
