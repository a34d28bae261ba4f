"""A client made before a fork works in the child, and the child leaves the parent's connection and server alone.
Run by test_fork.py, in a process of its own: gRPC's asyncio part, once used, does not survive forks."""

import multiprocessing
import os
import signal
import sys
import time

import pytest
from running import serving
from shapes import box_cage, points_inside

from barycast import Client

SECONDS_MAX = 8


def in_child(act):
    """Runs act in a forked process, which then ends as an interpreter ends (finalizers and all); its exit code."""
    pid = os.fork()
    if pid == 0:
        try:
            act()
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(9)
        # What sys.exit does, without unwinding into pytest.
        import atexit
        import gc
        act = None
        gc.collect()
        atexit._run_exitfuncs()
        os._exit(0)
    deadline = time.monotonic() + SECONDS_MAX
    while time.monotonic() < deadline:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return "hangs"


def bits(binding):
    matrix = binding.matrix
    return [part.tobytes() for part in (matrix.data, matrix.indices, matrix.indptr, binding.gradients, binding.flags)]


def bind(client):
    return client.bind(box_cage(), points_inside(300), gradients=True)


@pytest.mark.parametrize("how", ["private", "tcp"])
def test_a_client_survives_a_fork(real_daemon, how):
    with serving(real_daemon, "--threads", 1) as port:
        with Client(None if how == "private" else f"127.0.0.1:{port}", threads=1) as client:
            expected = bits(bind(client))
            local = client.connection.local
            channel = client.connection._channel

            def act():
                assert bits(bind(client)) == expected
                assert client.connection._channel is not channel
                client.close()

            for _ in range(5):
                assert in_child(act) == 0
                assert local is None or (local.alive() and os.path.exists(f"/proc/{local.pid}"))
                assert bits(bind(client)) == expected
            assert client.connection._channel is channel


def test_a_child_that_does_nothing(real_daemon):
    with Client(threads=1) as client:
        bind(client)
        folder = os.path.dirname(client.connection.local.address[len("unix:"):])
        assert in_child(lambda: None) == 0
        assert in_child(client.close) == 0
        assert client.connection.local.alive() and os.path.exists(folder)
        bind(client)
    assert not os.path.exists(folder)


def test_a_stream_goes_on_over_a_fork(real_daemon):
    """The child's end must not shut the sockets that it shares with its parent."""
    with serving(real_daemon, "--threads", 1) as port, Client(f"127.0.0.1:{port}") as client:
        computation = client.compute(box_cage(), points_inside(30000))
        count = 0
        for rows in computation:
            if count == 0:
                assert in_child(lambda: None) == 0
            count += len(rows.flags)
        assert count == 30000 and computation.resumed_rows == []


def test_a_child_outlives_the_private_server(real_daemon):
    with Client(threads=1) as client:
        bind(client)
        os.kill(client.connection.local.pid, signal.SIGKILL)

        def act():
            bind(client)  # by a private server of its own
            own = client.connection.local.pid
            client.close()
            assert not os.path.exists(f"/proc/{own}")

        assert in_child(act) == 0


CLIENT = None  # of the forked pool


def _rows(count):
    return CLIENT.bind(box_cage(), points_inside(count)).matrix.shape[0]


def test_a_pool_of_forked_processes(real_daemon):
    global CLIENT
    with Client(threads=1) as CLIENT:
        _rows(3)
        with multiprocessing.get_context("fork").Pool(3) as pool:
            assert pool.map_async(_rows, range(1, 13)).get(SECONDS_MAX) == list(range(1, 13))
        assert _rows(3) == 3
