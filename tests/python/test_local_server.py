"""The private server: started, found, restarted, and gone afterwards; with the fake daemon and the real one."""

import os
import signal
import stat
import time

import pytest
from shapes import box_cage, points_inside

from barycast import Client, InputError, ServerError, local_server
from barycast.options import compute_options


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def folder_of(client: Client) -> str:
    return os.path.dirname(client.connection.local.address[len("unix:"):])


def test_ends_with_its_client(daemon):
    with Client(threads=1) as client:
        local, folder = client.connection.local, folder_of(client)
        assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700
        assert client.bind(box_cage(), points_inside(5)).matrix.shape == (5, 8)
    assert gone(local.pid) and not os.path.exists(folder)
    client.close()  # again, harmless


def test_ends_after_an_exception(daemon):
    with pytest.raises(ZeroDivisionError):
        with Client() as client:
            pid = client.connection.local.pid
            raise ZeroDivisionError
    assert gone(pid)


def test_restarts_between_calls(daemon):
    with Client() as client:
        client.bind(box_cage(), points_inside(5))
        pid = client.connection.local.pid
        os.kill(pid, signal.SIGKILL)
        assert client.bind(box_cage(), points_inside(5)).matrix.shape == (5, 8)
        assert client.connection.local.pid != pid


def test_a_computation_goes_on_after_a_restart(real_daemon):
    """The new server lacks the cage and gets it again."""
    with Client(threads=2) as client:
        count, computation = 0, client.compute(box_cage(), points_inside(60_000), options=compute_options(samples=5))
        for rows in computation:
            if count == 0:
                os.kill(client.connection.local.pid, signal.SIGKILL)
            assert rows.first_row == count
            count += len(rows.flags)
        assert count == 60_000 and computation.resumed_rows


def test_ends_when_its_standard_input_closes(daemon):
    client = Client()
    process = client.connection.local._process
    process.stdin.close()
    assert process.wait(10) is not None
    client.close()


def test_a_long_temporary_folder(fake_daemon, tmp_path, monkeypatch):
    long = tmp_path / ("x" * 120)
    long.mkdir()
    monkeypatch.setattr(local_server.tempfile, "tempdir", str(long))
    with Client() as client:
        assert len(client.connection.local.address) < 100
    assert not list(long.iterdir())


def daemon_script(tmp_path, monkeypatch, text: str) -> None:
    program = tmp_path / "daemon"
    program.write_text("#!/bin/sh\n" + text)
    program.chmod(0o755)
    monkeypatch.setenv("BARYCASTD", str(program))


def test_a_daemon_that_ends_at_start(tmp_path, monkeypatch):
    daemon_script(tmp_path, monkeypatch, "echo this processor lacks AVX2 >&2; exit 7\n")
    with pytest.raises(ServerError, match="status 7: this processor lacks AVX2"):
        Client()


def test_a_daemon_that_never_serves(tmp_path, monkeypatch):
    daemon_script(tmp_path, monkeypatch, f"echo $$ > {tmp_path}/pid; exec sleep 60\n")
    monkeypatch.setattr(local_server, "_START_SECONDS_MAX", 0.5)
    started = time.monotonic()
    with pytest.raises(ServerError, match="did not serve"):
        Client()
    assert time.monotonic() - started < 5 and gone(int((tmp_path / "pid").read_text()))


def test_no_daemon(tmp_path, monkeypatch):
    monkeypatch.setenv("BARYCASTD", str(tmp_path / "absent"))
    with pytest.raises(InputError, match="absent is not a program"):
        Client()
    monkeypatch.delenv("BARYCASTD")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(local_server.cage_pb2, "__file__", str(tmp_path / "python/barycast/v1/cage_pb2.py"))
    with pytest.raises(InputError, match="build it"):
        Client()


def test_where_the_daemon_is_looked_for(tmp_path, monkeypatch):
    monkeypatch.delenv("BARYCASTD", raising=False)
    folders = [tmp_path / "bin", tmp_path / "path"]
    for folder in folders:
        folder.mkdir()
        (folder / "barycastd").write_text("#!/bin/sh\n")
        (folder / "barycastd").chmod(0o755)
    monkeypatch.setenv("PATH", str(folders[1]))
    monkeypatch.setattr(local_server.cage_pb2, "__file__", str(tmp_path / "python/barycast/v1/cage_pb2.py"))
    assert local_server.find_binary() == str(folders[0] / "barycastd")
    (folders[0] / "barycastd").unlink()
    assert local_server.find_binary() == str(folders[1] / "barycastd")
