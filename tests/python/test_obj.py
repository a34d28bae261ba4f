"""OBJ: what is read, what is kept, and what errors say."""

import numpy as np
import pytest

from barycast import InputError, load_cage, load_model
from barycast.mesh_io import points_for, save_model

TEXT = b"""# made in C:\\models\\\r
mtllib a.mtl\r
28388 56772 0\r
v 0 0 0 1 0.5 0 # red\r
v\t1  0 0\r
v 1 1 0\r
v 0 1 \\\r
0\r
vt 0 0\r
vn 0 0 1\r
g part one\r
usemtl skin\r
f 1/1/1 2/1/1 3/1/1 4/1/1\r
f 1//1 -2//1 \\\r
  4//1\r
s off\r
v 0.5 2 1e-1\r
f 1 2 3 -1 4\r
l 1 2 5\r
"""


def test_read(tmp_path):
    path = tmp_path / "a.obj"
    path.write_bytes(TEXT)
    model = load_model(path)
    np.testing.assert_array_equal(model.points, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0.1]])
    assert model.faces.counts.tolist() == [4, 3, 5]
    assert model.faces.corners.tolist() == [0, 1, 2, 3, 0, 2, 3, 0, 1, 2, 4, 3]
    assert model.segments.tolist() == [[0, 1], [1, 4]]
    cage = load_cage(path)
    assert (len(cage.triangles), len(cage.quads), len(cage.polygons), len(cage.segments)) == (1, 1, 1, 2)


def test_only_positions_change(tmp_path):
    path = tmp_path / "a.obj"
    path.write_bytes(TEXT)
    model = load_model(path)
    save_model(model, model.points + [0, 0, 0.25], tmp_path / "b.obj")
    written = (tmp_path / "b.obj").read_bytes()
    expected = TEXT.replace(b"v 0 0 0 1 0.5 0 # red", b"v 0.0 0.0 0.25 1 0.5 0 # red")
    expected = expected.replace(b"v\t1  0 0", b"v\t1.0  0.0 0.25").replace(b"v 1 1 0\r", b"v 1.0 1.0 0.25\r")
    expected = expected.replace(b"v 0 1 \\\r\n0\r", b"v 0.0 1.0  0.25\r").replace(b"v 0.5 2 1e-1", b"v 0.5 2.0 0.35")
    assert written == expected
    np.testing.assert_array_equal(load_model(tmp_path / "b.obj").points, model.points + [0, 0, 0.25])


def test_cage_in_the_plane(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 2 0 0\nv 0 2 0\nl 1 2 3 1\n")
    cage = load_cage(path)
    assert cage.dimension == 2 and cage.segments.tolist() == [[0, 1], [1, 2], [2, 0]]
    assert points_for(load_model(path), 2).shape == (3, 2)
    path.write_text("v 0 0 0\nv 2 0 0\nv 0 2 1\nl 1 2 3 1\n")
    assert load_cage(path).dimension == 3
    with pytest.raises(InputError, match="point 2"):
        points_for(load_model(path), 2)


@pytest.mark.parametrize("text, line, words", [
    ("v 0 0\n", 1, "three numbers"),
    ("v 0 0 0\nv 0 a 0\n", 2, "three numbers"),
    ("v 0 0 0\nv 0 nan 0\n", 2, "not finite"),
    ("v 0 0 0\n# comment\nf 1 2\n", 3, "at least 3"),
    ("v 0 0 0\nf 1 1 0\n", 2, "start at 1"),
    ("v 0 0 0\nf 1 1 -2\n", 2, "before the first"),
    ("v 0 0 0\nf 1 1 \\\n1\nf 1 1 7\n", 4, "vertex 7, the file has 1"),
    ("v 0 0 0\nf 1 x 1\n", 2, "whole numbers"),
    ("v 0 0 0\nl 1 2\n", 2, "vertex 2, the file has 1"),
    ("v 0 0 0\nl 1\n", 2, "at least 2"),
])
def test_errors_name_the_line(tmp_path, text, line, words):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_model(path)
    assert caught.value.field == f"{path}:{line}"


def test_other_errors_name_the_file(tmp_path):
    empty = tmp_path / "empty.obj"
    empty.write_text("# nothing\n")
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\n")
    for call, path, words in ((load_model, empty, "no vertices"), (load_cage, points, "no cage"),
                              (load_model, tmp_path / "absent.obj", "No such file"), (load_model, tmp_path, "ending")):
        with pytest.raises(InputError, match=words) as caught:
            call(path)
        assert caught.value.field == str(path)
    model = load_model(points)
    with pytest.raises(InputError, match="must end in .obj"):
        save_model(model, model.points, tmp_path / "out.ply")
    with pytest.raises(InputError, match="1 points where 2"):
        save_model(model, np.zeros((2, 3)), tmp_path / "out.obj")


@pytest.mark.parametrize("name, vertices, sizes", [
    ("qmvc/Beast_Cage.obj", 152, {3: 30, 4: 135}),
    ("spot/spot_control_mesh.obj", 188, {5: 16}),
    ("qmvc/Beast.obj", 28388, {}),
    ("spot/spot.obj", 11533, {}),
    ("ju2005/armadillo_cage.obj", 110, {3: 216}),
])
def test_files_in_the_wild(data_folder, name, vertices, sizes):
    model = load_model(data_folder / name)
    assert model.points.shape == (vertices, 3)
    for size, count in sizes.items():
        assert len(model.faces.of_size(size)) == count
    again = model.with_positions(model.points)
    original = (data_folder / name).read_bytes()
    assert [line for line in again.splitlines() if not line.startswith(b"v ")] == [
        line for line in original.splitlines() if not line.startswith(b"v ")]
