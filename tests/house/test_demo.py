"""The demo's generated model and cage: what the demo and the picture rely on."""
import hashlib
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from scipy.spatial import cKDTree

DEMO = Path(__file__).resolve().parents[2] / "deploy" / "demo"


NAMES = ("character.obj", "character.mtl", "cage.obj", "cage_posed.obj")


def run(script, *arguments):
    subprocess.run([sys.executable, "-B", DEMO / script, *arguments], check=True)


def parse(text):
    lines = text.decode().splitlines()
    points = np.array([line.split()[1:] for line in lines if line.startswith("v ")], dtype=float)
    faces = [[int(c) - 1 for c in line.split()[1:]] for line in lines if line.startswith("f ")]
    return points, faces


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    run("generate.py", folder)
    return folder


@pytest.fixture(scope="module")
def files(folder):
    return {name: (folder / name).read_bytes() for name in NAMES}


@pytest.fixture(scope="module")
def model(files):
    return parse(files["character.obj"])


@pytest.fixture(scope="module")
def cage(files):
    points, faces = parse(files["cage.obj"])
    return points, np.array(faces)


def directed_edges(quads):
    return [(q[i], q[(i + 1) % 4]) for q in quads for i in range(4)]


def bilinear(points, quads, steps):
    """A lattice of points on each patch: quads x (steps + 1) x (steps + 1) x 3."""
    s = np.linspace(0, 1, steps + 1)
    u, v = s[:, None, None], s[None, :, None]
    a, b, c, d = (points[quads[:, k]][:, None, None] for k in range(4))
    return (1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d


def winding_numbers(points, triangles):
    """Sum of the signed solid angles of the triangles over 4 pi (van Oosterom and Strackee 1983)."""
    result = np.zeros(len(points))
    for start in range(0, len(points), 2000):
        a, b, c = (triangles[None, :, k] - points[start:start + 2000, None] for k in range(3))
        la, lb, lc = (np.sqrt((x * x).sum(axis=2)) for x in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=2)
        rest = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
        result[start:start + 2000] = np.arctan2(volume, rest).sum(axis=1) / (2 * np.pi)
    return result


def test_cage_is_a_closed_quad_mesh_of_88_control_vertices(cage):
    points, quads = cage
    assert points.shape == (88, 3)
    assert quads.shape == (86, 4)
    assert sorted(set(quads.ravel())) == list(range(88))
    edges = directed_edges(quads)
    # Each edge once in each direction: closed, manifold along edges, oriented alike.
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)
    # Around each vertex the quads form one fan.
    for vertex in range(88):
        ring = {}
        for q in quads:
            if vertex in q:
                i = list(q).index(vertex)
                ring[q[(i + 1) % 4]] = q[(i + 3) % 4]
        at, seen = next(iter(ring)), 0
        while seen == 0 or at != next(iter(ring)):
            at, seen = ring[at], seen + 1
        assert seen == len(ring)
    assert 88 - len(edges) // 2 + len(quads) == 2  # Euler: a sphere


def test_cage_is_not_flat_and_its_pose_differs(files, cage):
    points, quads = cage
    corners = points[quads]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    height = ((corners[:, 1] - corners[:, 0]) * normal).sum(axis=1) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    assert (np.abs(height) > 0.005).sum() > 20  # bilinear patches that no plane holds
    posed, faces = parse(files["cage_posed.obj"])
    assert faces == quads.tolist()
    moved = np.linalg.norm(posed - points, axis=1)
    assert moved.max() > 0.4 and moved.min() < 1e-6


def test_model_has_about_30k_points_in_several_closed_components(files, model):
    points, faces = model
    assert 28_000 <= len(points) <= 33_000
    assert files["character.obj"].count(b"\no ") >= 5
    assert all(len(set(f)) == 4 for f in faces)
    edges = directed_edges(faces)
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)


def test_all_points_are_inside_the_cage_with_a_margin(model, cage):
    points, _ = model
    vertices, quads = cage
    margin = 0.01 * np.linalg.norm(np.ptp(vertices, axis=0))
    # The lattice is finer than the margin, so the nearest lattice point is about as far as the patch.
    distance, _ = cKDTree(bilinear(vertices, quads, 40).reshape(-1, 3)).query(points)
    assert distance.min() >= margin
    # Each patch becomes 2 x 2 cells of two triangles, which depart from it by a sixteenth of its twist at most: less
    # than the margin, so that inside them is inside the patches.
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    assert np.linalg.norm(a - b + c - d, axis=1).max() / 16 < margin
    patch = bilinear(vertices, quads, 2)
    a, b, c, d = (patch[:, i:2 + i, j:2 + j].reshape(-1, 3) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    assert np.abs(winding_numbers(points, triangles) - 1).max() < 1e-6


def test_generation_is_deterministic(files, tmp_path):
    run("generate.py", tmp_path)
    for name in NAMES:
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == hashlib.sha256(files[name]).hexdigest()


def test_the_picture_is_drawn(folder, tmp_path):
    out = tmp_path / "demo.png"
    run("render.py", out, "--model", folder / "character.obj", "--cage", folder / "cage.obj",
        "--posed-model", folder / "character.obj", "--posed-cage", folder / "cage_posed.obj", "--size", "320x180")
    image = matplotlib.image.imread(out)
    assert image.shape[:2] == (180, 320)
    # The coat is seen in both halves.
    teal = (image[..., 1] > image[..., 0] + 0.2) & (image[..., 2] > image[..., 0] + 0.2)
    assert teal[:, :160].sum() > 300 and teal[:, 160:].sum() > 300
