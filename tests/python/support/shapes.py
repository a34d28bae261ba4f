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


def grid_text(size: int) -> str:
    """A square of quads inside the unit box, with one triangle and one pentagon."""
    axis = np.linspace(0.2, 0.8, size)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    lines = [f"v {x!r} {y!r} {0.5 + 0.1 * np.sin(7 * x)!r}" for x, y in points.tolist()]
    for i in range(size - 1):
        for j in range(size - 1):
            a = size * i + j + 1
            corners = [a, a + 1, a + size + 1, a + size]
            lines.append("f " + " ".join(map(str, corners[:3] if (i, j) == (3, 3) else corners)))
    return "\n".join(lines + [f"f 1 2 3 {size + 3} {size + 1}"]) + "\n"


def polygon_cage_text() -> str:
    """The unit box: two triangles, two quads and a hexagon, which has a vertex more than the box needs."""
    vertices = np.r_[box_vertices(), [[0.5, 0, 1], [0.5, 1, 1]]]
    faces = [[0, 2, 3], [0, 3, 1], [0, 1, 5, 8, 4], [2, 6, 9, 7, 3], [4, 8, 5, 7, 9, 6], [0, 4, 6, 2], [1, 3, 7, 5]]
    return "\n".join(["v " + " ".join(map(repr, v)) for v in vertices.tolist()]
                     + ["f " + " ".join(str(c + 1) for c in f) for f in faces]) + "\n"
