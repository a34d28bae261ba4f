"""Predicted coordinates to a target error, through the service, both clients and their command lines."""

import asyncio
import json

import numpy as np
import pytest
from cutting_proxy import CuttingProxy
from running import run, serving, write_box
from shapes import box_cage, grid_text, points_inside, trilinear

from barycast import AsyncClient, Binding, Client, InputError, load_model
from barycast.options import compute_options, output_options
from barycast.report import statistics, summary_lines

TARGET = {"estimator": "predicted", "target_error": 2e-3}


@pytest.fixture
def client(real_daemon):
    with Client(threads=2) as client:
        yield client


def around(count: int) -> np.ndarray:
    """Points on the box, inside it, and outside."""
    return np.r_[[[0.5, 0.5, 0.0]], points_inside(count), 3 * points_inside(count) - 1]


def arrays(binding) -> list:
    matrix = binding.matrix
    return [part.tobytes() for part in (matrix.indptr, matrix.indices, matrix.data, binding.flags, binding.errors)]


def test_errors_are_those_asked_for(client):
    points = around(60)
    loose, tight = (client.bind(box_cage(), points, estimator="predicted", target_error=target, errors=True,
                                dtype="float64") for target in (1e-1, 2e-3))
    for binding in (loose, tight):
        assert binding.errors.shape == (len(points), 2) and binding.errors.dtype == np.float32
        assert (binding.errors[:, 0] <= binding.errors[:, 1]).all()
        assert binding.report["rows_above_target"] == 0
    assert tight.errors[:, 0].max() <= np.float32(2e-3) < loose.errors[:, 0].max()
    assert tight.errors[:, 0].mean() < loose.errors[:, 0].mean()
    assert tight.report["samples"] > loose.report["samples"] > 0
    options = tight.report["options"]
    assert (options["target_error"], options["errors"], options["samples"]) == (2e-3, True, 0)
    inside = slice(1, 61)
    off = np.linalg.norm(tight.matrix.toarray()[inside] - trilinear(points[inside]), axis=1)
    assert np.median(off) < 2e-3


def test_without_errors_rows_are_the_same(client):
    with_errors = client.bind(box_cage(), around(30), errors=True, **TARGET)
    without = client.bind(box_cage(), around(30), **TARGET)
    assert without.errors is None and "errors" not in statistics(without)
    assert (without.matrix != with_errors.matrix).nnz == 0
    assert without.report["samples"] == with_errors.report["samples"]


def test_rows_above_the_target_are_counted(client):
    """A target that 512 rounds do not meet everywhere."""
    binding = client.bind(box_cage(), around(10), estimator="predicted", target_error=1e-5, errors=True)
    above = int((binding.errors[:, 0] > np.float32(1e-5)).sum())
    assert binding.report["rows_above_target"] == above > 0
    assert binding.report["samples"] <= 21 * 6144
    assert f"{above:,} above the target of 1e-05" in "\n".join(summary_lines(binding))


def test_a_model_is_not_denoised(client, tmp_path):
    (tmp_path / "model.obj").write_text(grid_text(10))
    model = load_model(str(tmp_path / "model.obj"))
    binding = client.bind(box_cage(), model.points, model.faces, errors=True, **TARGET)
    assert binding.report["options"]["denoise"] == "none"
    assert arrays(binding) == arrays(client.bind(box_cage(), model.points, errors=True, **TARGET))


def test_rows_do_not_depend_on_their_blocks(client):
    """Nor on which of the clients asks."""
    points = around(100)
    whole = client.bind(box_cage(), points, errors=True, dtype="float64", **TARGET)
    output = output_options("float64", errors=True)
    output.block_rows = 7
    assert arrays(client.bind_with(box_cage(), points, None, compute_options(**TARGET), output)) == arrays(whole)
    blocks = list(client.compute(box_cage(), points, options=compute_options(**TARGET), output=output))
    assert np.concatenate([rows.errors for rows in blocks]).tobytes() == whole.errors.tobytes()
    part = client.bind(box_cage(), points[50:80], errors=True, dtype="float64", **TARGET)
    assert part.errors.tobytes() == whole.errors[50:80].tobytes()

    async def bind():
        async with AsyncClient(threads=2) as other:
            return await other.bind(box_cage(), points, errors=True, dtype="float64", **TARGET)

    assert arrays(asyncio.run(bind())) == arrays(whole)


def test_a_resumed_binding_has_the_same_bits(real_daemon):
    points = points_inside(6000)
    options = dict(estimator="predicted", target_error=0.5, errors=True, dtype="float64")
    with serving(real_daemon, "--threads", 2, "--block-rows-max", 300) as port:
        with Client(f"127.0.0.1:{port}") as client:
            whole = client.bind(box_cage(), points, **options)
        with CuttingProxy(port, [200_000, 300_000, 250_000]) as proxy:
            with Client(proxy.address, retry_seconds=30) as client:
                pieced = client.bind(box_cage(), points, **options)
    assert pieced.report["resumed_rows"] and arrays(pieced) == arrays(whole)


@pytest.mark.parametrize("options, field", [
    ({"samples": 12}, "header.options.samples"),
    ({"denoise": "mesh"}, "header.options.denoise"),
    ({"smoothing_time": 1e-3}, "header.options.denoise"),
    ({"estimator": "sampling"}, "header.options.target_error"),
    ({"coordinates": "mean-value", "estimator": "exact"}, "header.options.target_error"),
    ({"target_error": 1e-6}, "header.options.target_error"),
    ({"target_error": float("nan")}, "header.options.target_error"),
    ({"target_error": None}, "header.output.errors"),
])
def test_refusals(client, options, field):
    asked = {**TARGET, **options}
    with pytest.raises(InputError) as refused:
        client.bind(box_cage(), points_inside(10), errors=True, **asked)
    assert refused.value.field == field
    with pytest.raises(InputError) as refused:
        client.estimate(box_cage(), 10, options=compute_options(**asked), output=output_options(errors=True))
    assert refused.value.field == field


def test_a_server_may_take_fewer_samples(real_daemon):
    with serving(real_daemon, "--threads", 2, "--samples-max", 6000) as port:
        with Client(f"127.0.0.1:{port}") as client, pytest.raises(InputError) as refused:
            client.bind(box_cage(), points_inside(10), **TARGET)
    assert refused.value.field == "header.options.target_error" and "6144" in str(refused.value)


def test_the_estimate_says_the_most(client):
    cost = client.estimate(box_cage(), 1000, options=compute_options(**TARGET))
    assert cost.samples == 1000 * 12 * 512
    assert client.bind(box_cage(), points_inside(1000), **TARGET).report["samples"] < cost.samples


def test_a_binding_is_saved_with_its_errors(client, tmp_path):
    binding = client.bind(box_cage(), around(20), errors=True, **TARGET)
    binding.save(tmp_path / "b.npz")
    loaded = Binding.load(tmp_path / "b.npz")
    assert arrays(loaded) == arrays(binding) and loaded.errors.dtype == np.float32
    binding.errors = binding.errors[:-1]
    binding.save(tmp_path / "c.npz")
    with pytest.raises(InputError):
        Binding.load(tmp_path / "c.npz")


def test_both_command_lines(cpp, real_daemon, environment, tmp_path):
    """Equal bytes, equal words, and what inspect shows."""
    cage, model = write_box(tmp_path, 50)
    flags = ["--estimator", "predicted", "--target-error", "1e-3", "--errors"]
    shown = {}
    for name, call in (("py", lambda *a: run(environment, "bind", *a)), ("cpp", cpp)):
        done = call(cage, model, "-o", tmp_path / f"{name}.npz", *flags)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        assert "predicted to a standard error of 0.001, preset default, denoise none, seed 0" in done.stdout
        assert "0 above the target of 0.001" in done.stdout
        inspected = run(environment, "inspect", tmp_path / f"{name}.npz").stdout
        assert inspected.startswith(done.stdout) and "standard error of rows: median " in inspected
        shown[name] = [line for line in done.stdout.splitlines() if line.startswith("standard error")]
        refused = call(cage, model, "-o", tmp_path / "no.npz", *flags, "--samples", 12)
        assert refused.returncode == 3 and "options.samples" in refused.stderr
        refused = call(cage, model, "-o", tmp_path / "no.npz", "--errors")
        assert refused.returncode == 3 and "output.errors" in refused.stderr and refused.stderr.count("\n") == 1
    assert shown["py"] == shown["cpp"]
    ours, theirs = np.load(tmp_path / "cpp.npz"), np.load(tmp_path / "py.npz")
    assert ours.files == theirs.files and ours["errors"].dtype == np.float32 and ours["errors"].shape == (50, 2)
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    reports = [json.loads(str(file["report"])) for file in (ours, theirs)]
    assert reports[0]["options"] == reports[1]["options"]
    assert reports[0]["rows_above_target"] == reports[1]["rows_above_target"] == 0
    values = json.loads(run(environment, "inspect", tmp_path / "cpp.npz", "--json").stdout)
    assert 0 < values["errors"]["standard_median"] <= values["errors"]["standard_max"] <= 1e-3
    assert values["rows_above_target"] == 0


def test_the_command_line_says_what_it_would_cost_at_most(real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path, 50)
    done = run(environment, "bind", cage, model, "--estimate", "--estimator", "predicted", "--target-error", "1e-3")
    assert done.returncode == 0 and "at most 307,200 samples" in done.stdout
