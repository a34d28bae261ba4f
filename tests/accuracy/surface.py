"""A cage's surface as a fine welded triangle mesh: positions, the cage's basis there, normals, distances to it.

Every triangle and bilinear patch is cut n x n, with one n for the whole cage, so that neighbours fit along their edges.
Polygons are fans of triangles about the mean of their corners, as in the library. Numbers are in the cage's units.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class Elements:
    """A cage of triangles and quads only. nodes: k x 3, the control vertices and after them a middle for each polygon;
    stencil: k x control vertices, what each node is of them."""

    nodes: np.ndarray
    stencil: scipy.sparse.csr_matrix
    triangles: np.ndarray
    quads: np.ndarray

    @classmethod
    def of(cls, cage):
        count, polygons = len(cage.control_vertices), cage.polygons
        triangles, middles = [cage.triangles.astype(np.int64)], []
        for k, (begin, end) in enumerate(zip(polygons.offsets[:-1], polygons.offsets[1:])):
            corners = polygons.corners[begin:end].astype(np.int64)
            fan = np.stack([corners, np.roll(corners, -1), np.full(len(corners), count + k)], axis=1)
            triangles.append(fan)
            middles.append(np.bincount(corners, minlength=count) / len(corners))
        stencil = scipy.sparse.vstack([scipy.sparse.identity(count), *map(scipy.sparse.csr_matrix, middles)]).tocsr()
        return cls(stencil @ cage.control_vertices, stencil, np.concatenate(triangles), cage.quads.astype(np.int64))

    def closed(self):
        """Whether every edge has one face on either side, and they face one way."""
        sides = [faces[:, [i, (i + 1) % faces.shape[1]]] for faces in (self.triangles, self.quads)
                 for i in range(faces.shape[1])]
        edges, twice = np.unique(np.concatenate(sides), axis=0, return_counts=True)
        return bool((twice == 1).all()) and set(map(tuple, edges)) == set(map(tuple, edges[:, ::-1]))


@dataclass(frozen=True, eq=False)
class Surface:
    """points: n x 3. basis: n x control vertices. faces: k x 3 triangles. normals: n x 3, averaged over the faces by
    area, pointing outwards for a closed cage. diagonal: of the bounding box of the used control vertices."""

    points: np.ndarray
    basis: scipy.sparse.csr_matrix
    faces: np.ndarray
    normals: np.ndarray
    diagonal: float

    @classmethod
    def of(cls, cage, points_wanted):
        """About as many points as wanted, at least 8 x 8 triangles or squares an element."""
        elements = Elements.of(cage)
        area_units = len(elements.quads) + len(elements.triangles) / 2
        n = max(8, round((points_wanted / area_units) ** 0.5))
        patches = [_cut_triangles(elements.triangles, n), _cut_quads(elements.quads, n)]
        shift = np.cumsum([0, patches[0][0].shape[0]])
        nodes = scipy.sparse.vstack([_weights(corners, shares, len(elements.nodes)) for corners, shares, _ in patches])
        faces = np.concatenate([faces + first for first, (_, _, faces) in zip(shift, patches)])
        points = nodes @ elements.nodes
        low, high = cage.control_vertices[cage.used].min(axis=0), cage.control_vertices[cage.used].max(axis=0)
        diagonal = float(np.linalg.norm(high - low))
        # Points of one edge, computed from either side, differ by rounding only.
        _, kept, merged = np.unique(np.round((points - low) / diagonal * 1e9), axis=0, return_index=True,
                                    return_inverse=True)
        points, faces = points[kept], merged.ravel()[faces]
        corners = points[faces]
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(points)
        for i in range(3):
            np.add.at(normals, faces[:, i], areas)
        outwards = 1.0 if np.einsum("ij,ij->", corners[:, 0] - corners.mean(axis=(0, 1)), areas) >= 0 else -1.0
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = outwards * np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        return cls(points, (nodes @ elements.stencil).tocsr()[kept], faces, normals, diagonal)

    def distances(self, points):
        """Distance of points (n x 3) to the mesh, by the 16 triangles with the nearest middles, in diagonals. Far away
        that may be a little too far, by less than a triangle's size squared over the distance."""
        corners = self.points[self.faces]
        _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(16, len(corners)))
        distances = triangle_distances(points[:, None, :], corners[near.reshape(len(points), -1)])
        return distances.min(axis=1) / self.diagonal


def triangle_distances(points, corners):
    """Distance of points (... x 3) to triangles (... x 3 x 3)."""
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    above = np.ones(normal.shape[:-1], bool)
    nearest = np.full(normal.shape[:-1], np.inf)
    for i in range(3):
        start, edge = corners[..., i, :], corners[..., (i + 1) % 3, :] - corners[..., i, :]
        to = points - start
        squared = np.maximum((edge**2).sum(-1), 1e-300)
        along = np.clip((to * edge).sum(-1) / squared, 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(to - along[..., None] * edge, axis=-1))
        above &= (np.cross(edge, to) * normal).sum(-1) >= 0
    length = np.linalg.norm(normal, axis=-1)
    height = np.abs(((points - corners[..., 0, :]) * normal).sum(-1)) / np.maximum(length, 1e-300)
    return np.where(above & (length > 0), height, nearest)


def _cut_triangles(triangles, n):
    """Corners and shares of n-cut triangles' points, one row a point, and the faces between the points."""
    steps = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)])
    shares = np.column_stack([n - steps.sum(axis=1), steps]) / n
    at = {tuple(step): k for k, step in enumerate(steps.tolist())}
    faces = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i in range(n) for j in range(n - i)]
    faces += [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i in range(n) for j in range(n - 1 - i)]
    return _repeat(triangles, shares, np.array(faces))


def _cut_quads(quads, n):
    """The same for bilinear patches."""
    u, v = (axis.ravel() / n for axis in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=1)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    a, b, c, d = corner, corner + n + 1, corner + n + 2, corner + 1
    return _repeat(quads, shares, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def _repeat(elements, shares, faces):
    corners = np.repeat(elements, len(shares), axis=0)
    first = np.arange(len(elements)) * len(shares)
    return corners, np.tile(shares, (len(elements), 1)), (faces[None] + first[:, None, None]).reshape(-1, 3)


def _weights(corners, shares, columns):
    rows = np.repeat(np.arange(len(corners)), corners.shape[1])
    return scipy.sparse.csr_matrix((shares.ravel(), (rows, corners.ravel())), shape=(len(corners), columns))
