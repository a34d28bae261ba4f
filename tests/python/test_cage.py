"""Cages: validation, and the digest against bytes packed by hand as cage.proto lists them."""

import hashlib
import struct

import fake_server
import numpy as np
import pytest
from shapes import BOX_QUADS, box_vertices

from barycast import Cage, Faces, InputError


def test_digest_of_mixed_faces():
    vertices = [[0.0, 0.0, -0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0], [0.5, 0.5, 1.0]]
    cage = Cage.from_faces(vertices, [[0, 1, 2, 3, 4], [0, 1, 5], [1, 2, 3, 5], [3, 4, 0]])
    packed = b"BCCAGE01" + struct.pack("<8I", 3, 6, 0, 0, 2, 1, 1, 5)
    packed += struct.pack("<18d", *(abs(x) if x == 0 else x for vertex in vertices for x in vertex))
    packed += struct.pack("<6I", 0, 1, 5, 3, 4, 0) + struct.pack("<4I", 1, 2, 3, 5)
    packed += struct.pack("<2I", 0, 5) + struct.pack("<5I", 0, 1, 2, 3, 4)
    assert cage.canonical_bytes() == packed
    assert cage.digest.sha256 == hashlib.sha256(packed).digest()
    assert cage.digest.size_bytes == len(packed)
    assert fake_server.server_digest(cage.to_message()) == cage.digest.sha256


def test_digest_in_the_plane():
    cage = Cage([[0, 0], [2, 0], [0, 2]], segments=[[0, 1], [1, 2], [2, 0]])
    packed = b"BCCAGE01" + struct.pack("<8I", 2, 3, 0, 3, 0, 0, 0, 0) + struct.pack("<6d", 0, 0, 2, 0, 0, 2)
    assert cage.canonical_bytes() == packed + struct.pack("<6I", 0, 1, 1, 2, 2, 0)
    assert cage.dimension == 2


def test_float32_is_widened():
    vertices = box_vertices() * np.float32(0.1)
    assert (Cage.from_faces(vertices.astype(np.float32), BOX_QUADS).digest
            == Cage.from_faces(vertices.astype(np.float32).astype(np.float64), BOX_QUADS).digest)


def test_small_polygons_are_triangles_and_quads():
    cage = Cage(box_vertices(), triangles=[[0, 1, 2]], polygons=Faces.of([[4, 5, 6], [0, 1, 3, 2], [0, 1, 3, 2, 6]]))
    assert cage.triangles.tolist() == [[0, 1, 2], [4, 5, 6]]
    assert cage.quads.tolist() == [[0, 1, 3, 2]]
    assert cage.polygons.corners.tolist() == [0, 1, 3, 2, 6]
    assert not cage.used[7] and cage.used[:7].all()


@pytest.mark.parametrize("arguments, field", [
    (dict(control_vertices=[[0, 0, np.nan]]), "cage.control_vertices[0]"),
    (dict(control_vertices=[1, 2, 3]), "cage.control_vertices"),
    (dict(control_vertices="box"), "cage.control_vertices"),
    (dict(control_vertices=np.eye(3), triangles=[[0, 1, 3]]), "cage.triangles[0][2]"),
    (dict(control_vertices=np.eye(3), triangles=[[0, -1, 2]]), "cage.triangles[0][1]"),
    (dict(control_vertices=np.eye(3), triangles=[[0.0, 1.0, 2.0]]), "cage.triangles"),
    (dict(control_vertices=np.eye(3), quads=[[0, 1, 2]]), "cage.quads"),
])
def test_refused_cages(arguments, field):
    with pytest.raises(InputError) as caught:
        Cage(**arguments)
    assert caught.value.field == field


def test_faces():
    faces = Faces.of([[0, 1, 2], [2, 3, 4, 5, 6]])
    assert len(faces) == 2 and faces.counts.tolist() == [3, 5]
    assert Faces.of(np.arange(6).reshape(2, 3)).corners.tolist() == list(range(6))
    assert len(Faces.of(None)) == len(Faces.of([])) == 0
    for offsets, corners in (([0, 2], [0, 1]), ([0, 3], [0, 1]), ([1, 3], [0, 1, 2]), ([0, 4, 3], [0, 1, 2])):
        with pytest.raises(InputError):
            Faces(np.array(offsets), np.array(corners))
