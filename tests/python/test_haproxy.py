"""Both clients behind deploy/haproxy.cfg with two real daemons: cages stay with a replica, refusals arrive as they were
sent, and a replica's death costs nothing but time."""

import json
import subprocess
import time

import balanced
import numpy as np
import pytest
from daemon import Daemon
from running import COMMAND, run, write_box
from shapes import BOX_QUADS, box_vertices, obj_text, points_inside

pytestmark = pytest.mark.skipif(balanced.PROGRAM is None, reason="no haproxy (package haproxy)")
# Enough work for a second and more, in several blocks of rows.
LONG = ["--estimator", "sampling", "--samples", 200, "--denoise", "none"]


@pytest.fixture
def replicas(real_daemon, tmp_path):
    daemons = []
    for name in "ab":
        (tmp_path / name).mkdir()
        daemons.append(Daemon(real_daemon, tmp_path / name, "--threads", "1", "--cage-bytes-max", "500KB"))
        daemons[-1].__enter__()
    yield daemons
    for daemon in daemons:
        daemon.channel.close()
        if daemon.process.poll() is None:
            daemon.process.kill()
        daemon.process.wait(20)


@pytest.fixture
def balancer(replicas, tmp_path):
    with balanced.Balancer([replica.address for replica in replicas], tmp_path / "haproxy.log") as balancer:
        yield balancer


def test_each_cage_lands_on_one_replica(environment, balancer, replicas, tmp_path):
    count = 8
    model = tmp_path / "model.obj"
    model.write_text(obj_text(points_inside(20), []))
    for _ in range(2):
        for number in range(count):
            cage = tmp_path / f"cage{number}.obj"
            cage.write_text(obj_text(box_vertices() * (1 + number), BOX_QUADS))
            done = run(environment, "bind", cage, model, "-o", tmp_path / "bind.npz", "--server", balancer.address)
            assert done.returncode == 0, done.stderr
    held = [balanced.cages_built(replica.metrics_address) for replica in replicas]
    assert sum(held) == count and min(held) > 0


def test_refusals_are_those_of_the_server(environment, cpp, balancer, replicas, tmp_path):
    cage, model = write_box(tmp_path, 30_000)
    arguments = [cage, model, "-o", tmp_path / "bind.npz", "--estimator", "sampling", "--samples", 200_000, "--server"]
    for call in (lambda *given: run(environment, "bind", *given), cpp):
        direct = call(*arguments, replicas[0].address)
        for _ in range(10):  # whether a status is lost is a matter of microseconds
            behind = call(*arguments, balancer.address)
            assert (behind.returncode, behind.stderr) == (direct.returncode, direct.stderr)
        assert direct.returncode == 3 and "100000" in direct.stderr.replace(",", "")


def test_a_cage_over_the_limit_is_refused_as_such(environment, cpp, balancer, replicas, tmp_path):
    cage, model = write_box(tmp_path, 200_000)
    cage.write_text(obj_text(np.random.default_rng(1).random((100_000, 3)), np.arange(99_999).reshape(-1, 3)))
    arguments = [cage, model, "-o", tmp_path / "bind.npz", "--estimator", "sampling", "--server"]
    for call in (lambda *given: run(environment, "bind", *given), cpp):
        for _ in range(3):
            behind = call(*arguments, balancer.address)
            assert behind.returncode == 3 and "limit of 512000 bytes" in behind.stderr, behind.stderr


@pytest.mark.parametrize("client", ["python", "cpp"])
def test_another_replica_goes_on_when_one_is_killed(environment, program, balancer, replicas, tmp_path, client):
    cage, model = write_box(tmp_path, 40_000)
    command = [*COMMAND, "bind"] if client == "python" else [program]
    command = [*map(str, [*command, cage, model, *LONG, "--server", balancer.address, "-o"])]
    begin = time.monotonic()
    alone = subprocess.run([*command, tmp_path / "alone.npz"], env=environment, stderr=subprocess.PIPE, timeout=120)
    assert alone.returncode == 0, alone.stderr
    seconds = time.monotonic() - begin
    with subprocess.Popen([*command, tmp_path / "killed.npz"], env=environment, stderr=subprocess.PIPE) as bind:
        deadline = time.monotonic() + 60
        busy = None
        while busy is None and time.monotonic() < deadline:
            time.sleep(0.02)
            for replica in replicas:
                # Both are still alive: rows leave as their blocks are done.
                if replica.metrics()["barycastd_admitted_requests"] == 1:
                    busy = replica
        assert busy is not None
        time.sleep(0.4 * seconds)  # so that rows have left
        assert busy.metrics()["barycastd_admitted_requests"] == 1, "done too early for this test"
        busy.process.kill()
        assert bind.wait(120) == 0, bind.stderr.read()
    ours, theirs = np.load(tmp_path / "killed.npz"), np.load(tmp_path / "alone.npz")
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    assert json.loads(str(ours["report"]))["resumed_rows"] != []
