"""Soft light on a mesh: how much of a sky and of a wide key light each point sees.

For each of a few dozen directions the scene's surface is splatted into a small depth map; a point is lit from a
direction when nothing in its cell of the map lies clearly above it. Averaged over directions this gives ambient
occlusion, soft shadows and contact shadows on the ground in about a second.
"""
import numpy as np

KEY = np.array([-0.50, 0.74, 0.62])  # towards the key light, in the frame of the camera's heading
CELLS = 190  # along the longest side of the scene


def surface_samples(points, triangles, spacing):
    """Centroids of the triangles after bisecting longest edges until none is longer than `spacing`."""
    t = points[triangles]
    done = []
    while len(t):
        squared = ((np.roll(t, -1, axis=1) - t) ** 2).sum(axis=2)
        first = squared.argmax(axis=1)
        small = squared.max(axis=1) <= spacing * spacing
        done.append(t[small].mean(axis=1))
        t, first = t[~small], first[~small]
        row = np.arange(len(t))
        a, b, c = (t[row, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        t = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    p = np.concatenate(done)
    # One per small cell is enough; dense meshes have many.
    key = np.floor((p - p.min(axis=0)) / (0.7 * spacing)).astype(np.int64) @ [1, 1 << 20, 1 << 40]
    return p[np.unique(key, return_index=True)[1]]


def directions(count):
    """A Fibonacci spiral on the upper half sphere."""
    i = np.arange(count)
    up = (i + 0.5) / count
    angle = i * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - up * up)
    return np.stack([flat * np.cos(angle), up, flat * np.sin(angle)], axis=1)


class DepthMap:
    """The highest surface over each cell of the plane across `direction`."""

    def __init__(self, occluders, direction, cell):
        helper = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.7 else np.array([0, 0, 1.0])
        self.u = np.cross(direction, helper)
        self.u /= np.linalg.norm(self.u)
        self.v = np.cross(direction, self.u)
        self.direction, self.cell = direction, cell
        i, j = occluders @ self.u / cell, occluders @ self.v / cell
        self.corner = np.floor(i.min()) - 1, np.floor(j.min()) - 1
        i, j = (i - self.corner[0]).astype(np.int64), (j - self.corner[1]).astype(np.int64)
        self.shape = i.max() + 2, j.max() + 2
        height = occluders @ direction
        order = np.argsort(height)
        self.top = np.full(self.shape[0] * self.shape[1], -np.inf)
        self.top[(i * self.shape[1] + j)[order]] = height[order]  # the highest is assigned last

    def visible(self, targets, normals):
        """True where a target, lifted a little off its surface, sees the sky in this direction."""
        lifted = targets + 1.5 * self.cell * normals
        i = np.floor(lifted @ self.u / self.cell - self.corner[0]).astype(np.int64)
        j = np.floor(lifted @ self.v / self.cell - self.corner[1]).astype(np.int64)
        known = (i >= 0) & (i < self.shape[0]) & (j >= 0) & (j < self.shape[1])
        above = np.where(known, self.top[np.where(known, i * self.shape[1] + j, 0)], -np.inf)
        return above <= lifted @ self.direction + 1.5 * self.cell


def key_directions(heading):
    """Towards the key light's centre, and towards points spread over its disc."""
    towards = KEY[0] * heading[0] + np.array([0, KEY[1], 0]) + KEY[2] * heading[1]
    towards /= np.linalg.norm(towards)
    side = np.cross(towards, [0, 1.0, 0])
    side /= np.linalg.norm(side)
    up = np.cross(side, towards)
    lamps = 20
    spread = []
    for i in range(lamps):
        radius, angle = 0.17 * np.sqrt((i + 0.5) / lamps), i * np.pi * (3 - np.sqrt(5))
        d = towards + radius * (np.cos(angle) * side + np.sin(angle) * up)
        spread.append(d / np.linalg.norm(d))
    return towards, spread


def sky_and_key(targets, normals, occluders, heading, extent):
    """Sky light (0 to 1, 1 in the open) and key light with its cosine (0 to 1), per target."""
    cell = extent / CELLS
    sky = np.zeros(len(targets))
    total = np.zeros(len(targets))
    for d in directions(56):
        # The horizon counts too: a wall still sees half of the sky.
        cosine = np.maximum(0.15 + 0.85 * (normals @ d), 0)
        total += cosine
        sky += cosine * DepthMap(occluders, d, cell).visible(targets, normals)
    key = np.zeros(len(targets))
    _, spread = key_directions(heading)
    for d in spread:
        # Wrapped a little past the terminator, which reads as a soft, matt material.
        key += np.maximum((normals @ d + 0.12) / 1.12, 0) * DepthMap(occluders, d, cell).visible(targets, normals)
    return sky / np.maximum(total, 1e-9), key / len(spread)
