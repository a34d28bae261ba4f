"""The demo's cage: 86 quads over 88 control vertices around the character, and the same cage in a pose.

The topology is the boundary of a flat figure of 23 boxes:

    row 6       H H H          H head, N neck, A arm, T torso, L leg;
    row 5       H H H          columns 0 to 8 from the character's right to its left
    row 4         N
    row 3   A A A T T T A A A
    row 2         T T T
    row 1         L   L
    row 0         L   L

A corner (i, j) of the figure has a back and a front control vertex. Positions are given for the character's left
half and mirrored.
"""
import math

import numpy as np

CELLS = ([(c, 3) for c in range(9)] + [(c, 2) for c in (3, 4, 5)] + [(c, r) for c in (3, 5) for r in (0, 1)]
         + [(4, 4)] + [(c, r) for c in (3, 4, 5) for r in (5, 6)])

# Corner (i, j) with i >= 5: x, y, z at the back, z at the front.
HALF = {
    # leg, from the sole up; the boot's toe needs room in front
    (5, 0): (0.032, -0.055, -0.21, 0.365), (6, 0): (0.398, -0.055, -0.21, 0.365),
    (5, 1): (0.028, 0.235, -0.20, 0.225), (6, 1): (0.385, 0.275, -0.20, 0.225),
    # torso: hips, waist and armpits, shoulders
    (5, 2): (0.034, 0.350, -0.32, 0.315), (6, 2): (0.390, 0.445, -0.24, 0.235),
    (5, 3): (0.130, 0.720, -0.31, 0.365), (6, 3): (0.380, 0.620, -0.17, 0.200),
    (5, 4): (0.255, 1.035, -0.25, 0.300), (6, 4): (0.345, 0.960, -0.16, 0.180),
    # arm: above the elbow, wrist, fingertips
    (7, 3): (0.475, 0.505, -0.16, 0.180), (7, 4): (0.545, 0.860, -0.16, 0.180),
    (8, 3): (0.605, 0.395, -0.16, 0.230), (8, 4): (0.790, 0.715, -0.16, 0.230),
    (9, 3): (0.790, 0.330, -0.13, 0.220), (9, 4): (0.935, 0.545, -0.13, 0.220),
    # head: chin and jaw, eyes, crown with room for the tuft
    (5, 5): (0.290, 1.085, -0.44, 0.380), (6, 5): (0.490, 1.165, -0.29, 0.260),
    (5, 6): (0.285, 1.570, -0.56, 0.510), (6, 6): (0.550, 1.560, -0.32, 0.300),
    (5, 7): (0.210, 2.215, -0.36, 0.290), (6, 7): (0.440, 2.030, -0.30, 0.240),
}


def corners():
    """The figure's corners in the order of the control vertices: each gives a back and a front vertex."""
    return sorted({(c + di, r + dj) for c, r in CELLS for di in (0, 1) for dj in (0, 1)}, key=lambda c: (c[1], c[0]))


def build():
    """Control vertices (88 x 3) and quads (86 x 4, counter-clockwise from outside)."""
    vertices = []
    for i, j in corners():
        x, y, back, front = HALF[max(i, 9 - i), j]
        vertices += [(math.copysign(x, i - 4.5), y, back), (math.copysign(x, i - 4.5), y, front)]
    first = {c: 2 * k for k, c in enumerate(corners())}
    quads = []
    for c, r in sorted(CELLS):
        ring = [(c, r), (c + 1, r), (c + 1, r + 1), (c, r + 1)]
        quads.append([first[p] + 1 for p in ring])
        quads.append([first[p] for p in reversed(ring)])
        for (a, b), beyond in zip(zip(ring, ring[1:] + ring[:1]), [(c, r - 1), (c + 1, r), (c, r + 1), (c - 1, r)]):
            if beyond not in CELLS:
                quads.append([first[b], first[b] + 1, first[a] + 1, first[a]])
    return np.array(vertices), np.array(quads)


def _rotation(axis, degrees):
    """The matrix of a turn about a unit axis (Rodrigues)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y, z = axis
    return ((c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s),
            (y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s),
            (z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)))


def _turn(p, pivot, axis, degrees):
    m = _rotation(axis, degrees)
    q = [a - b for a, b in zip(p, pivot)]
    return tuple(o + (r[0] * q[0] + r[1] * q[1] + r[2] * q[2]) for o, r in zip(pivot, m))


# The pose: turns applied from the tips towards the trunk. Each has a pivot, an axis, an angle and, per corner (i, j),
# the share of the angle, so that the corners at a joint turn half as far and the bend stays smooth.
def _arm(side, shares):
    return {(i if side > 0 else 9 - i, j): share for i, share in shares.items() for j in (3, 4)}


def _columns(side, shares):
    return {(i if side > 0 else 9 - i, j): share for j, share in shares.items() for i in (5, 6)}


HEAD = {(i, j): share for j, share in ((4, 0.25), (5, 0.75), (6, 1.0), (7, 1.0)) for i in (3, 4, 5, 6)
        if not (j == 4 and i in (3, 6))}
UPPER = {(i, j): share for j, share in ((3, 0.5), (4, 1.0), (5, 1.0), (6, 1.0), (7, 1.0)) for i in range(10)}
POSE = (
    # left arm raised in a wave: elbow, then shoulder
    ((0.40, 0.77, 0.0), (0, 0, 1), 50.0, _arm(1, {7: 0.35, 8: 0.9, 9: 1.15})),
    ((0.24, 0.87, 0.0), (0, 0, 1), 44.0, _arm(1, {6: 0.30, 7: 0.95, 8: 1.0, 9: 1.0})),
    # right arm swung back and out a little
    ((-0.40, 0.76, 0.0), (0, 1, 0), -18.0, _arm(-1, {7: 0.4, 8: 1.0, 9: 1.2})),
    ((-0.24, 0.87, 0.0), (0, 0, 1), -6.0, _arm(-1, {6: 0.3, 7: 1.0, 8: 1.0, 9: 1.0})),
    # right leg lifted: knee, then hip
    ((-0.19, 0.27, -0.02), (1, 0, 0), 26.0, _columns(-1, {0: 1.0, 1: 0.45})),
    ((-0.18, 0.48, 0.0), (1, 0, 0), -60.0, _columns(-1, {0: 1.0, 1: 1.0, 2: 0.25})),
    # head tilted away from the raised arm and turned a little
    ((0.0, 1.10, 0.0), (0, 0, 1), 16.0, HEAD),
    ((0.0, 1.10, 0.0), (0, 1, 0), 12.0, HEAD),
    # the trunk leans and counter-turns
    ((0.0, 0.55, 0.0), (0, 0, 1), -5.0, UPPER),
    ((0.0, 0.55, 0.0), (0, 1, 0), -8.0, UPPER),
)


def posed(vertices):
    """The control vertices of the pose."""
    result = []
    for k, p in enumerate(vertices):
        p = tuple(float(t) for t in p)
        for pivot, axis, degrees, shares in POSE:
            share = shares.get(corners()[k // 2], 0.0)
            if share:
                p = _turn(p, pivot, axis, share * degrees)
        result.append(p)
    return np.array(result)
