"""PLY, STL and npz: round trips that change nothing but positions, and errors."""

import io
import struct

import numpy as np
import pytest

from barycast import InputError, load_cage, load_model
from barycast.mesh_io import save_model

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0.25]], np.float64)
FACES = [[0, 1, 2, 3], [0, 2, 3], [0, 1, 2, 4, 3]]
MOVED = POINTS + [0.5, 0.25, -1]


def ply_header(form: str, kind: str, newline: str = "\n") -> bytes:
    lines = ["ply", f"format {form} 1.0", "comment kept", f"element vertex {len(POINTS)}", f"property {kind} x",
             f"property {kind} y", "property uchar red", f"property {kind} z", f"element face {len(FACES)}",
             "property int group", "property list uchar int vertex_indices", "element edge 1", "property int a",
             "end_header"]
    return (newline.join(lines) + newline).encode()


def ply(form: str, kind: str, points: np.ndarray) -> bytes:
    if form == "ascii":
        number = np.float32 if kind == "float" else np.float64
        body = "".join(f"{number(x)} {number(y)} {i} {number(z)}\r\n" for i, (x, y, z) in enumerate(points))
        body += "".join(f"7 {len(face)} {' '.join(map(str, face))}\r\n" for face in FACES) + "9\r\n"
        return ply_header(form, kind, "\r\n") + body.encode()
    order, code = "<" if "little" in form else ">", "f" if kind == "float" else "d"
    body = b"".join(struct.pack(f"{order}2{code}B{code}", x, y, i, z) for i, (x, y, z) in enumerate(points))
    body += b"".join(struct.pack(f"{order}iB{len(face)}i", 7, len(face), *face) for face in FACES)
    return ply_header(form, kind) + body + struct.pack(order + "i", 9)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kind", ["float", "double"])
def test_ply(tmp_path, form, kind):
    path = tmp_path / "a.ply"
    path.write_bytes(ply(form, kind, POINTS))
    model = load_model(path)
    np.testing.assert_array_equal(model.points, POINTS)
    assert model.faces.counts.tolist() == [4, 3, 5]
    assert model.faces.corners.tolist() == sum(FACES, [])
    assert (len(load_cage(path).quads), len(load_cage(path).polygons)) == (1, 1)
    save_model(model, MOVED, tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == ply(form, kind, MOVED)


def test_ply_with_faces_of_one_size(tmp_path):
    head = b"ply\nformat binary_big_endian 1.0\nelement face 2\nproperty list uchar ushort vertex_index\n"
    head += b"property uchar q\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    body = struct.pack(">B3HBB3HB", 3, 0, 1, 2, 5, 3, 0, 2, 3, 6) + struct.pack(">12d", *POINTS[:4].ravel())
    path = tmp_path / "a.ply"
    path.write_bytes(head + body)
    assert load_model(path).faces.corners.tolist() == [0, 1, 2, 0, 2, 3]


GOOD_PLY = ply("ascii", "float", POINTS)


@pytest.mark.parametrize("data, words", [
    (b"", "does not end"),
    (b"plx\n", "header"),
    (GOOD_PLY.replace(b"property float x", b"property quad x"), "a.ply:5: "),
    (GOOD_PLY.replace(b"property float x", b"property int x"), "float or double"),
    (GOOD_PLY.replace(b"property float x", b"property float w"), "x, y, z"),
    (GOOD_PLY.replace(b"format ascii 1.0", b"comment"), "no format"),
    (GOOD_PLY.replace(b"7 3 0 2 3", b"7 3 0 2"), "a.ply:21: "),
    (GOOD_PLY.replace(b"7 3 0 2 3", b"7 3 0 2 9"), "not in 0 ... 4"),
    (GOOD_PLY.replace(b"7 3 0 2 3", b"7 2 0 2"), "fewer than three"),
    (GOOD_PLY.replace(b"1.0 0.0 1 0.0", b"inf 0.0 1 0.0"), "vertex 1 is not finite"),
    (GOOD_PLY.replace(b"1.0 0.0 1 0.0", b"1.0 0.0 1"), "a.ply:16: "),
    (GOOD_PLY[:-3], "ends before"),
    (ply("binary_little_endian", "float", POINTS)[:-5], "ends before"),
    (ply("binary_big_endian", "double", POINTS)[:-70], "ends before"),
], ids=range(14))
def test_broken_ply(tmp_path, data, words):
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert words in str(caught.value) and str(path) in str(caught.value)


TRIANGLES = POINTS[np.array([[0, 1, 2], [0, 2, 3]])]


def stl(binary: bool, triangles: np.ndarray) -> bytes:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    if binary:
        facets = b"".join(struct.pack("<12fH", *normal, *corners.ravel(), 1 + i)
                          for i, (normal, corners) in enumerate(zip(normals, triangles)))
        return b"solid but binary".ljust(80) + struct.pack("<I", len(triangles)) + facets
    text = "solid thing\n"
    for normal, corners in zip(normals.tolist(), triangles.tolist()):
        text += " facet normal {} {} {}\n  outer loop\n".format(*normal)
        text += "".join("   vertex {} {} {}\n".format(*corner) for corner in corners) + "  endloop\n endfacet\n"
    return (text + "endsolid thing\n").encode()


@pytest.mark.parametrize("binary", [False, True])
def test_stl(tmp_path, binary):
    path = tmp_path / "a.stl"
    path.write_bytes(stl(binary, TRIANGLES))
    model = load_model(path)
    np.testing.assert_array_equal(model.points, POINTS[:4])
    assert model.faces.corners.tolist() == [0, 1, 2, 0, 2, 3]
    assert load_cage(path).triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    turned = model.points[:, [2, 0, 1]] * 2
    save_model(model, turned, tmp_path / "b.stl")
    assert (tmp_path / "b.stl").read_bytes() == stl(binary, TRIANGLES[:, :, [2, 0, 1]] * 2)


@pytest.mark.parametrize("data, words", [
    (b"nothing", "no STL"),
    (stl(True, TRIANGLES)[:-1], "184"),
    (stl(False, TRIANGLES).replace(b"vertex 1.0 0.0 0.0", b"vertex 1.0 0.0"), "a.stl:5: "),
    (stl(False, TRIANGLES).replace(b"vertex 1.0 0.0 0.0", b"vertex 1.0 nan 0.0"), "facet 1 "),
    (stl(False, TRIANGLES).replace(b"   vertex 1.0 0.0 0.0\n", b""), "three vertices"),
    (b"solid\nendsolid\n", "no facets"),
], ids=range(6))
def test_broken_stl(tmp_path, data, words):
    path = tmp_path / "a.stl"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert words in str(caught.value) and str(path) in str(caught.value)


def npz(**entries) -> bytes:
    file = io.BytesIO()
    np.savez(file, **entries)
    return file.getvalue()


def test_npz(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(npz(points=POINTS.astype(np.float32), face_offsets=[0, 4, 7, 12], face_corners=sum(FACES, []),
                         colour=np.arange(5)))
    model = load_model(path)
    assert model.faces.counts.tolist() == [4, 3, 5]
    save_model(model, MOVED, tmp_path / "b.npz")
    with np.load(tmp_path / "b.npz") as written:
        assert set(written.files) == {"points", "face_offsets", "face_corners", "colour"}
        assert written["points"].dtype == np.float32
        np.testing.assert_array_equal(written["points"], MOVED)
        np.testing.assert_array_equal(written["colour"], np.arange(5))


def test_npz_cages(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(npz(control_vertices=[[0, 0], [2, 0], [0, 2.0]], segments=[[0, 1], [1, 2], [2, 0]]))
    assert load_cage(path).dimension == 2
    with pytest.raises(InputError, match="cannot hold a third"):
        load_model(path).with_positions(np.ones((3, 3)))
    path.write_bytes(npz(control_vertices=POINTS, triangles=[[0, 1, 2]], quads=[[0, 1, 2, 3]]))
    cage = load_cage(path)
    assert (len(cage.triangles), len(cage.quads)) == (1, 1)


@pytest.mark.parametrize("data, words", [
    (b"", "no .npz"),
    (b"PK\x03\x04", "no .npz"),
    (npz(other=[1]), "points"),
    (npz(points=[1.0, 2.0]), "points: must be"),
    (npz(points=np.array([object()])), "no .npz"),
    (npz(points=POINTS, face_offsets=[0, 3]), "belong together"),
    (npz(points=POINTS, face_offsets=[0, 3], face_corners=[0, 1, 9]), "face_corners[2]"),
    (npz(points=POINTS, triangles=[[0, 1]]), "triangles"),
], ids=range(8))
def test_broken_npz(tmp_path, data, words):
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert words in str(caught.value) and str(path) in str(caught.value)
