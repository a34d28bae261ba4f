"""Building blocks of implicit shapes: fields that are negative inside and roughly a distance near their surface."""
import numpy as np


def ball(centre, radii):
    """An ellipsoid; `radii` is one number or three."""
    cx, cy, cz = centre
    rx, ry, rz = (radii,) * 3 if np.isscalar(radii) else radii

    def field(x, y, z):
        x, y, z = (x - cx) / rx, (y - cy) / ry, (z - cz) / rz
        k = np.sqrt(x * x + y * y + z * z)
        x, y, z = x / rx, y / ry, z / rz
        slope = np.sqrt(x * x + y * y + z * z)
        return k * (k - 1.0) / np.maximum(slope, 1e-9)
    return field


def tube(points, radii):
    """A chain of segments whose radius runs linearly from point to point; round at both ends."""
    def field(x, y, z):
        best = None
        for a, b, ra, rb in zip(points, points[1:], radii, radii[1:]):
            dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            px, py, pz = x - a[0], y - a[1], z - a[2]
            t = np.clip((px * dx + py * dy + pz * dz) / (dx * dx + dy * dy + dz * dz), 0.0, 1.0)
            px, py, pz = px - t * dx, py - t * dy, pz - t * dz
            d = np.sqrt(px * px + py * py + pz * pz) - (ra + t * (rb - ra))
            best = d if best is None else np.minimum(best, d)
        return best
    return field


def ring(centre, axis, radius, thickness, squash=1.0):
    """A torus around `axis` (unit length); `squash` scales z before measuring, for oval rings."""
    def field(x, y, z):
        px, py, pz = x - centre[0], y - centre[1], (z - centre[2]) * squash
        h = px * axis[0] + py * axis[1] + pz * axis[2]
        qx, qy, qz = px - h * axis[0], py - h * axis[1], pz - h * axis[2]
        q = np.sqrt(qx * qx + qy * qy + qz * qz) - radius
        return np.sqrt(q * q + h * h) - thickness
    return field


def half_space(point, normal):
    """Inside is where the normal points away from."""
    def field(x, y, z):
        return (x - point[0]) * normal[0] + (y - point[1]) * normal[1] + (z - point[2]) * normal[2]
    return field


def union(fields, blend=0.0):
    """Smooth union: two surfaces closer than `blend` melt into each other."""
    def field(x, y, z):
        d = fields[0](x, y, z)
        for f in fields[1:]:
            d = smooth_min(d, f(x, y, z), blend)
        return d
    return field


def cut(a, b, blend):
    """The part of a inside b, with a rounded rim."""
    return lambda x, y, z: -smooth_min(-a(x, y, z), -b(x, y, z), blend)


def grow(a, by):
    return lambda x, y, z: a(x, y, z) - by


def mirror(a):
    """The shape and its mirror image in x; `a` describes the side x > 0."""
    return lambda x, y, z: a(np.abs(x), y, z)


def smooth_min(a, b, blend):
    if blend == 0.0:
        return np.minimum(a, b)
    h = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - h * h * blend * 0.25


def curve(control, count):
    """Points on the Bezier curve of the given control points (de Casteljau)."""
    points = []
    for i in range(count):
        t = i / (count - 1)
        layer = [tuple(map(float, c)) for c in control]
        while len(layer) > 1:
            layer = [tuple((1 - t) * u + t * v for u, v in zip(a, b)) for a, b in zip(layer, layer[1:])]
        points.append(layer[0])
    return points
