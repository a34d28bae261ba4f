"""The demo's character: a small winter explorer made of smooth implicit shapes, one mesh per material.

Faces +z, stands on y = 0, about two units tall; x > 0 is the character's left.
"""
import numpy as np

from fields import ball, curve, cut, grow, half_space, mirror, ring, tube, union
from surface_nets import surface_net

SHOULDER = (0.165, 0.90, 0.0)
ELBOW = (0.395, 0.770, 0.0)
WRIST = (0.590, 0.620, 0.02)
ARM = (0.7926, -0.6097, 0.0)  # unit direction of the forearm, for what is worn on it
HEAD = (0.0, 1.43, 0.0)


def _along(point, by):
    return tuple(p + by * a for p, a in zip(point, ARM))


def _head():
    skull = ball(HEAD, (0.385, 0.355, 0.345))
    cheeks = mirror(ball((0.17, 1.325, 0.09), (0.22, 0.18, 0.21)))
    return union([skull, cheeks], 0.12)


def _front(field, x, y):
    """Depth of a surface's front at (x, y), by bisection: places what sits on a face or a coat."""
    inside, outside = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (inside + outside)
        if field(np.array([x]), np.array([y]), np.array([middle]))[0] < 0:
            inside = middle
        else:
            outside = middle
    return inside


def _skin():
    neck = tube([(0, 0.95, 0), (0, 1.15, 0)], [0.10, 0.11])
    ears = mirror(ball((0.385, 1.375, -0.02), (0.06, 0.085, 0.055)))
    nose = ball((0, 1.355, _front(_head(), 0, 1.355) + 0.012), (0.052, 0.045, 0.045))
    return union([union([_head(), ears], 0.04), neck, nose], 0.035)


def _hair():
    shell = grow(ball((0, 1.445, -0.015), (0.385, 0.36, 0.35)), 0.04)
    # The hairline runs from the forehead down behind the ears to the nape.
    behind = half_space((0, 1.53, 0.17), (0.0, -0.52, 0.8542))
    cap = cut(shell, behind, 0.06)
    locks = []
    for control, radii in (
            # the tuft: locks that rise from the crown and sweep to the character's left
            ([(-0.06, 1.70, -0.06), (-0.16, 2.02, -0.10), (0.06, 2.16, -0.04), (0.29, 2.02, 0.04)], (0.135, 0.020)),
            ([(-0.10, 1.72, -0.02), (-0.24, 1.93, -0.04), (-0.13, 2.08, 0.02), (0.00, 2.09, 0.08)], (0.105, 0.020)),
            ([(0.04, 1.72, -0.10), (0.10, 1.92, -0.18), (0.24, 1.95, -0.18), (0.36, 1.86, -0.12)], (0.110, 0.020)),
            # the fringe, parted on the character's right
            ([(-0.13, 1.74, 0.10), (-0.06, 1.78, 0.30), (0.10, 1.74, 0.37), (0.21, 1.61, 0.330)], (0.085, 0.014)),
            ([(-0.10, 1.75, 0.08), (0.02, 1.80, 0.26), (0.24, 1.74, 0.32), (0.33, 1.56, 0.22)], (0.085, 0.016)),
            ([(-0.14, 1.74, 0.10), (-0.20, 1.75, 0.26), (-0.27, 1.66, 0.30), (-0.29, 1.53, 0.265)], (0.075, 0.014)),
            # the sides, in front of the ears
            ([(0.33, 1.60, 0.10), (0.41, 1.52, 0.12), (0.41, 1.42, 0.12), (0.375, 1.34, 0.13)], (0.065, 0.014)),
            ([(-0.33, 1.60, 0.10), (-0.41, 1.52, 0.12), (-0.41, 1.42, 0.12), (-0.375, 1.34, 0.13)], (0.065, 0.014)),
            # the nape
            ([(0.0, 1.35, -0.33), (0.0, 1.26, -0.36), (0.0, 1.22, -0.34), (0.02, 1.18, -0.32)], (0.10, 0.020)),
            ([(0.16, 1.35, -0.29), (0.17, 1.26, -0.32), (0.19, 1.22, -0.29), (0.21, 1.19, -0.26)], (0.09, 0.015)),
            ([(-0.16, 1.35, -0.29), (-0.17, 1.26, -0.32), (-0.19, 1.22, -0.29), (-0.21, 1.19, -0.26)], (0.09, 0.015))):
        line = curve(control, 10)
        locks.append(tube(line, [radii[0] + (radii[1] - radii[0]) * (i / 9) ** 2 for i in range(10)]))
    return union([cap] + locks, 0.045)


def _coat():
    body = union([ball((0, 0.66, -0.005), (0.265, 0.25, 0.225)), ball((0, 0.84, -0.01), (0.205, 0.19, 0.165))], 0.18)
    skirt = cut(grow(body, 0.012), half_space((0, 0.50, 0), (0, -1, 0)), 0.03)
    sleeve = mirror(tube([SHOULDER, ELBOW, WRIST], [0.098, 0.092, 0.088]))
    return union([skirt, sleeve], 0.09)


def _trim():
    hem = ring((0, 0.515, -0.005), (0, 1, 0), 0.228, 0.047, squash=1.16)
    cuffs = mirror(ring(_along(WRIST, 0.005), ARM, 0.068, 0.047))
    boot_tops = mirror(ring((0.194, 0.245, -0.005), (0, 1, 0), 0.088, 0.036))
    return union([hem, cuffs, boot_tops])


def _trousers():
    return union([ball((0, 0.52, 0), (0.240, 0.10, 0.18)),
                  mirror(tube([(0.160, 0.47, 0), (0.194, 0.20, -0.005)], [0.112, 0.092]))], 0.05)


def _boot():
    shaft = tube([(0.194, 0.24, -0.005), (0.199, 0.10, 0.0)], [0.088, 0.104])
    toe = ball((0.211, 0.075, 0.085), (0.115, 0.095, 0.165))
    return union([shaft, toe], 0.07)


def _boots():
    return mirror(cut(_boot(), half_space((0, 0.03, 0), (0, -1, 0)), 0.02))


def _soles():
    slab = cut(grow(_boot(), 0.014), half_space((0, 0.048, 0), (0, 1, 0)), 0.012)
    return mirror(cut(slab, half_space((0, 0.0, 0), (0, -1, 0)), 0.012))


def _mittens():
    palm = _along(WRIST, 0.115)
    tip = _along(WRIST, 0.185)
    hand = tube([_along(WRIST, 0.03), palm, tip], [0.062, 0.088, 0.072])
    thumb = tube([_along(WRIST, 0.06), (palm[0] + 0.055, palm[1] + 0.080, palm[2] + 0.085)], [0.045, 0.040])
    return mirror(union([hand, thumb], 0.05))


def _scarf():
    wrap = union([ring((0, 1.005, 0.005), (0.0872, 0.9962, 0.0), 0.135, 0.066),
                  ring((0, 1.055, 0.0), (-0.0698, 0.9976, 0.0), 0.115, 0.055)], 0.02)
    coat = _coat()
    knot = ball((0.085, 0.985, 0.175), (0.066, 0.062, 0.055))
    tails = []
    for top, bottom, end, width, count in ((0.110, 0.155, 0.585, 0.062, 12), (0.060, 0.010, 0.740, 0.052, 9)):
        line = []
        for i in range(count):
            t = i / (count - 1)
            x, y = top + (bottom - top) * t, 0.985 + (end - 0.985) * t
            line.append((x, y, max(_front(coat, x, y) + 0.018, 0.185 - 0.05 * t)))
        # A flat band: thin tubes side by side, melted together.
        tails.append(union([tube([(x + side * width * 0.55, y, z - 0.006 * side * side) for x, y, z in line],
                                 [0.030] * count) for side in (-1, 0, 1)], 0.05))
    return union([union([wrap, knot], 0.03)] + tails, 0.012)


def _buttons():
    coat = _coat()
    return union([ball((-0.075, y, _front(coat, -0.075, y) + 0.004), (0.027, 0.027, 0.018))
                  for y in (0.60, 0.70, 0.80)])


def _on_face(x, y, radii, lift=0.0):
    return ball((x, y, _front(_head(), x, y) + lift), radii)


def _eyes():
    return mirror(_on_face(0.145, 1.43, (0.047, 0.068, 0.030), -0.002))


def _highlights():
    return union([_on_face(side * 0.145 + 0.016, 1.457, (0.0165, 0.0185, 0.012), 0.024) for side in (-1, 1)]
                 + [_on_face(side * 0.145 - 0.016, 1.405, (0.0085, 0.0095, 0.008), 0.024) for side in (-1, 1)])


def _face_line(points, radius):
    head = _head()
    return tube([(x, y, _front(head, x, y) + 0.002) for x, y in points], [radius] * len(points))


def _mouth():
    smile = [(0.085 * (i / 5 - 1), 1.262 - 0.030 * (1 - (i / 5 - 1) ** 2)) for i in range(11)]
    return _face_line(smile, 0.0120)


def _brows():
    arch = curve([(0.092, 1.548), (0.145, 1.580), (0.198, 1.543)], 8)
    return mirror(_face_line(arch, 0.0140))


def _blush():
    return mirror(cut(grow(_head(), 0.006), _on_face(0.235, 1.318, (0.060, 0.046, 0.060)), 0.008))


# name, colour (sRGB), field, bounding box, grid step
COMPONENTS = (
    ("skin", (0.96, 0.77, 0.64), _skin, (-0.5, 0.80, -0.45), (0.5, 1.85, 0.5), 0.0245),
    ("hair", (0.45, 0.24, 0.15), _hair, (-0.55, 0.95, -0.55), (0.55, 2.2, 0.55), 0.0215),
    ("coat", (0.14, 0.50, 0.55), _coat, (-0.75, 0.35, -0.4), (0.75, 1.15, 0.4), 0.0235),
    ("trim", (0.96, 0.92, 0.84), _trim, (-0.75, 0.12, -0.4), (0.75, 0.80, 0.4), 0.0185),
    ("trousers", (0.22, 0.25, 0.38), _trousers, (-0.4, 0.0, -0.3), (0.4, 0.75, 0.3), 0.0260),
    ("boots", (0.62, 0.33, 0.17), _boots, (-0.4, -0.1, -0.3), (0.4, 0.45, 0.4), 0.0215),
    ("soles", (0.25, 0.19, 0.17), _soles, (-0.4, -0.1, -0.3), (0.4, 0.15, 0.4), 0.0195),
    ("mittens", (0.93, 0.68, 0.22), _mittens, (-0.95, 0.3, -0.25), (0.95, 0.85, 0.3), 0.0195),
    ("scarf", (0.86, 0.26, 0.22), _scarf, (-0.35, 0.45, -0.35), (0.35, 1.25, 0.45), 0.0170),
    ("buttons", (0.96, 0.80, 0.36), _buttons, (-0.15, 0.5, 0.0), (0.05, 0.9, 0.4), 0.0110),
    ("eyes", (0.09, 0.07, 0.08), _eyes, (-0.25, 1.3, 0.1), (0.25, 1.55, 0.5), 0.0115),
    ("highlights", (1.0, 1.0, 1.0), _highlights, (-0.25, 1.3, 0.1), (0.25, 1.55, 0.5), 0.0065),
    ("mouth", (0.52, 0.20, 0.18), _mouth, (-0.15, 1.15, 0.1), (0.15, 1.35, 0.5), 0.0075),
    ("brows", (0.40, 0.21, 0.13), _brows, (-0.3, 1.45, 0.1), (0.3, 1.65, 0.5), 0.0095),
    ("blush", (0.95, 0.56, 0.50), _blush, (-0.4, 1.2, 0.0), (0.4, 1.45, 0.5), 0.0120),
)


def build():
    """Points (n x 3), quads (m x 4) and, per component, (name, colour, first quad, number of quads)."""
    points, quads, parts = [], [], []
    n_points = n_quads = 0
    for name, colour, make, lower, upper, step in COMPONENTS:
        p, q = surface_net(make(), lower, upper, step)
        points.append(p)
        quads.append(q + n_points)
        parts.append((name, colour, n_quads, len(q)))
        n_points += len(p)
        n_quads += len(q)
    return np.concatenate(points), np.concatenate(quads), parts
