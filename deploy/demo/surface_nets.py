"""Quad meshes of implicit surfaces: surface nets on a regular grid, then relaxation on the surface.

A field maps coordinate arrays (x, y, z) to an array that is negative inside. Only operations that IEEE 754
rounds exactly (+ - * / sqrt, min, max, comparisons) and sums of fixed order are used here and in the fields, so
the mesh is the same, bit for bit, on every machine.
"""
import numpy as np


def _project(field, p, step, iterations):
    """Newton steps along the field's gradient, each no longer than half a grid cell."""
    for _ in range(iterations):
        x, y, z = p.T
        f = field(x, y, z)
        e = step * 1e-3
        g = np.stack([field(x + e, y, z) - field(x - e, y, z), field(x, y + e, z) - field(x, y - e, z),
                      field(x, y, z + e) - field(x, y, z - e)], axis=1) / (2 * e)
        squared = g[:, 0] * g[:, 0] + g[:, 1] * g[:, 1] + g[:, 2] * g[:, 2]
        move = np.clip(f / np.maximum(squared, 1e-6), -step / 2, step / 2)
        p = p - move[:, None] * g
    return p


def _neighbour_mean(p, quads):
    """Mean over the quad edges at each vertex; bincount adds in order, which keeps the bits fixed."""
    a = np.concatenate([quads, np.roll(quads, -1, axis=1)]).ravel()
    b = np.concatenate([np.roll(quads, -1, axis=1), quads]).ravel()
    count = np.bincount(a, minlength=len(p))
    return np.stack([np.bincount(a, p[b, k], len(p)) for k in range(3)], axis=1) / count[:, None]


def surface_net(field, lower, upper, step, relaxations=4):
    """Points (n x 3) and quads (m x 4, counter-clockwise from outside) of field = 0 within a box."""
    axes = [lo + step * np.arange(int((hi - lo) / step) + 2) for lo, hi in zip(lower, upper)]
    grid = np.meshgrid(*axes, indexing="ij")
    values = field(*grid)
    inside = values < 0
    cells = tuple(n - 1 for n in values.shape)

    # Each cell the surface crosses gets one vertex: the mean of the crossings on its twelve edges.
    total = np.zeros(cells + (3,))
    count = np.zeros(cells)
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        low, high = tuple(low), tuple(high)
        cross = inside[low] != inside[high]
        along = np.where(cross, values[low] / np.where(cross, values[low] - values[high], 1.0), 0.0)
        u, v = [k for k in range(3) if k != axis]
        for du in (0, 1):
            for dv in (0, 1):
                window = [slice(None)] * 3
                window[u] = slice(du, du + cells[u])
                window[v] = slice(dv, dv + cells[v])
                hit = cross[tuple(window)]
                count += hit
                total[..., axis] += along[tuple(window)]
                total[..., u] += du * hit
                total[..., v] += dv * hit
    active = count > 0
    number = np.full(cells, -1, dtype=np.int64)
    number[active] = np.arange(int(active.sum()))
    corner = np.argwhere(active)
    p = np.asarray(lower) + step * (corner + total[active] / count[active][:, None])

    # Each grid edge that changes sign becomes the quad of the four cells around it.
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        edge = [slice(1, -1)] * 3
        edge[axis] = slice(None, -1)
        far = list(edge)
        far[axis] = slice(1, None)
        start, end = inside[tuple(edge)], inside[tuple(far)]
        at = np.argwhere(start != end)
        leaving = start[tuple(at.T)]
        at[:, u] += 1
        at[:, v] += 1
        around = []
        for du, dv in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cell = at.copy()
            cell[:, u] += du
            cell[:, v] += dv
            around.append(number[tuple(cell.T)])
        quad = np.stack(around, axis=1)
        quad[~leaving] = quad[~leaving][:, ::-1]
        quads.append(quad)
    quads = np.concatenate(quads)

    p = _project(field, p, step, 3)
    for _ in range(relaxations):
        p = _project(field, 0.5 * (p + _neighbour_mean(p, quads)), step, 2)
    return p, quads
