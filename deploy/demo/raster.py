"""A z-buffer for triangles and antialiased lines, in numpy.

Triangles are grouped by the size of their bounding box and all pixels of a group are tested at once, so the cost is
proportional to the sum of the boxes. Coordinates are pixels, depth grows away from the eye.
"""
import numpy as np

_GROUP_PIXELS = 4_000_000  # pixels tested at once: some 200 MB of temporaries


def nearest_triangles(xy, depth, triangles, width, height):
    """For each pixel: the nearest triangle (-1 for none), its depth, and two barycentric weights there.

    `depth` must be linear on the screen (for perspective: -1/z), since it is interpolated with screen weights.
    """
    owner = np.full(width * height, -1, dtype=np.int64)
    nearest = np.full(width * height, np.inf)
    weight = np.zeros((width * height, 2), dtype=np.float32)
    t = xy[triangles]
    low = np.maximum(np.ceil(t.min(axis=1) - 0.5), 0).astype(np.int64)
    high = np.minimum(np.floor(t.max(axis=1) - 0.5), [width - 1, height - 1]).astype(np.int64)
    size = high - low + 1
    area = _cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    usable = (size > 0).all(axis=1) & (area != 0)
    side = np.maximum(size.max(axis=1), 1)
    group = np.where(usable, np.ceil(np.log2(side) * 2).astype(np.int64), -1)
    for g in np.unique(group[group >= 0]):
        members = np.flatnonzero(group == g)
        box = int(side[members].max())
        dx, dy = [a.ravel() for a in np.meshgrid(np.arange(box), np.arange(box))]
        for chunk in np.array_split(members, max(1, len(members) * box * box // _GROUP_PIXELS)):
            px = low[chunk, 0, None] + dx
            py = low[chunk, 1, None] + dy
            a, b, c = t[chunk, 0], t[chunk, 1], t[chunk, 2]
            x, y = px + 0.5, py + 0.5
            w1 = ((x - a[:, :1]) * (c[:, 1:] - a[:, 1:]) - (y - a[:, 1:]) * (c[:, :1] - a[:, :1])) / area[chunk, None]
            w2 = ((b[:, :1] - a[:, :1]) * (y - a[:, 1:]) - (b[:, 1:] - a[:, 1:]) * (x - a[:, :1])) / area[chunk, None]
            inside = (w1 >= 0) & (w2 >= 0) & (w1 + w2 <= 1)
            inside &= (px <= high[chunk, 0, None]) & (py <= high[chunk, 1, None])
            row, col = np.nonzero(inside)
            w1, w2 = w1[row, col], w2[row, col]
            d = depth[triangles[chunk]][row]
            d = d[:, 0] + w1 * (d[:, 1] - d[:, 0]) + w2 * (d[:, 2] - d[:, 0])
            pixel = py[row, col] * width + px[row, col]
            # Far to near: where a pixel occurs more than once, the last assignment, the nearest, stays.
            order = np.argsort(-d, kind="stable")
            order = order[d[order] < nearest[pixel[order]]]
            nearest[pixel[order]] = d[order]
            owner[pixel[order]] = chunk[row[order]]
            weight[pixel[order], 0] = w1[order]
            weight[pixel[order], 1] = w2[order]
    shape = (height, width)
    return owner.reshape(shape), nearest.reshape(shape), weight.reshape(shape + (2,))


def _cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def blend_line(image, nearest, a, b, depth_a, depth_b, radius, colour, opacity, hidden_opacity, bias):
    """Draws one antialiased segment; where the z-buffer is nearer, with `hidden_opacity`."""
    height, width = nearest.shape
    pad = radius + 1.5
    x0, y0 = np.maximum(np.floor(np.minimum(a, b) - pad), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(np.maximum(a, b) + pad) + 1, [width, height]).astype(int)
    if x0 >= x1 or y0 >= y1:
        return
    x, y = np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5)
    d = b - a
    t = np.clip(((x - a[0]) * d[0] + (y - a[1]) * d[1]) / max(d @ d, 1e-12), 0, 1)
    distance = np.hypot(x - a[0] - t * d[0], y - a[1] - t * d[1])
    cover = np.clip(radius + 0.5 - distance, 0, 1)
    hit = cover > 0
    line_depth = depth_a + t * (depth_b - depth_a)
    alpha = cover * np.where(line_depth <= nearest[y0:y1, x0:x1] + bias, opacity, hidden_opacity)
    window = image[y0:y1, x0:x1]
    window[hit] += alpha[hit, None] * (np.asarray(colour) - window[hit])
