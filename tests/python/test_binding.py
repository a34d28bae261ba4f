"""Bindings: posing, and the file."""

import numpy as np
import pytest
import scipy.sparse
from shapes import box_vertices, points_inside, trilinear

from barycast import Binding, InputError


def make(points: np.ndarray, dtype=np.float32, gradients: bool = False) -> Binding:
    matrix = scipy.sparse.csr_matrix(trilinear(points).astype(dtype))
    return Binding(matrix, np.ones((matrix.nnz, 3), dtype) if gradients else None, np.zeros(len(points), np.uint8),
                   "ab" * 32, {"options": {"samples": 50}, "warnings": []})


def test_deform_reproduces_linear_maps():
    points = points_inside(100)
    linear = np.array([[1.0, 0.5, 0.0], [0.0, 2.0, 0.1], [-1.0, 0.0, 1.0]])
    posed = make(points, np.float64).deform(box_vertices() @ linear + [5, 6, 7])
    np.testing.assert_allclose(posed, points @ linear + [5, 6, 7], atol=1e-14)


def test_float32_rows_do_not_multiply_the_offset():
    points = points_inside(1000)
    offset = np.array([1e6, -2e6, 3e6])
    assert np.abs(make(points).deform(box_vertices() + offset) - (points + offset)).max() < 1e-6


def test_deform_refuses_another_cage():
    with pytest.raises(InputError) as caught:
        make(points_inside(3)).deform(np.zeros((9, 3)))
    assert "9" in str(caught.value) and "8" in str(caught.value)


@pytest.mark.parametrize("gradients", [False, True])
def test_save_and_load(tmp_path, gradients):
    path = tmp_path / "bind.npz"
    binding = make(points_inside(10), gradients=gradients)
    binding.save(path)
    loaded = Binding.load(path)
    assert (loaded.matrix != binding.matrix).nnz == 0 and loaded.matrix.dtype == np.float32
    assert (scipy.sparse.load_npz(path) != binding.matrix).nnz == 0
    assert loaded.report == binding.report and loaded.cage_digest == binding.cage_digest
    assert (loaded.gradients is not None) == gradients
    assert not gradients or loaded.gradients.shape == (binding.matrix.nnz, 3)
    assert [entry.name for entry in tmp_path.iterdir()] == ["bind.npz"]


def test_load_refuses_other_files(tmp_path):
    other = tmp_path / "other.npz"
    for content in (b"", b"no zip", b"PK\x03\x04 broken"):
        other.write_bytes(content)
        with pytest.raises(InputError, match="is not a binding"):
            Binding.load(other)
    scipy.sparse.save_npz(other, scipy.sparse.eye(3, format="csr"))
    with pytest.raises(InputError, match="is not a binding"):
        Binding.load(other)
    with pytest.raises(InputError, match="No such file"):
        Binding.load(tmp_path / "absent.npz")


def test_a_failed_save_leaves_the_old_file(tmp_path):
    path = tmp_path / "bind.npz"
    path.write_bytes(b"old")
    binding = make(points_inside(3))
    binding.flags = np.array([object()])  # pickles are refused on load, not on save: break the JSON instead
    binding.report = {"bad": object()}
    with pytest.raises(TypeError):
        binding.save(path)
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InputError, match="no regular file"):
        binding.report = {}
        binding.save(tmp_path)
