"""Runs the command line as its users do: in its own process."""

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import tempfile
import termios
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator, Sequence, Tuple

from shapes import BOX_QUADS, box_vertices, obj_text, points_inside

COMMAND = [sys.executable, "-m", "barycast"]


# What no server can have for an address.
BAD_ADDRESSES = ["", "127.0.0.1", "127.0.0.1:port", "127.0.0.1:99999", "http://127.0.0.1:50051", "127.0.0.1:0",
                 "127.0.0.1:", "127.0.0.1:-1", ":50051", "50051", "::1:50051", "[::1]", "127.0.0.1:50051/", "a b:50051",
                 "unix:", "dns:///localhost", "dns:///localhost:0", "dns://8.8.8.8", "ipv4:127.0.0.1",
                 "ipv4:127.0.0.1:1,127.0.0.1", "passthrough:///127.0.0.1:50051"]


@contextmanager
def serving(daemon: Path, *flags: object) -> Iterator[int]:
    """The port on loopback of a daemon with these flags."""
    with tempfile.TemporaryDirectory() as folder:
        port_file = Path(folder) / "port"
        process = subprocess.Popen([str(daemon), "--listen", "127.0.0.1:0", "--port-file", str(port_file),
                                    "--log-level", "error", "--exit-on-stdin-close", *map(str, flags)], stdin=subprocess.PIPE)
        try:
            deadline = time.monotonic() + 30
            while not port_file.exists() and process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
            yield int(port_file.read_text().strip().rsplit(":", 1)[-1])
        finally:
            process.stdin.close()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def run(environment: dict, *arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run([*COMMAND, *map(str, arguments)], env=environment, capture_output=True, text=True,
                          timeout=120)


def run_on_terminal(environment: dict, *arguments: object, command: Sequence[object] = COMMAND) -> Tuple[int, str]:
    """Exit code and everything shown, with standard error on a terminal."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    process = subprocess.Popen([*map(str, (*command, *arguments))], env=environment, stdout=follower, stderr=follower)
    os.close(follower)
    shown = b""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        if select.select([leader], [], [], 0.1)[0]:
            try:
                shown += os.read(leader, 65536)
            except OSError:  # the other side is closed
                break
        elif process.poll() is not None:
            break
    os.close(leader)
    return process.wait(10), shown.decode()


def write_box(folder: Path, count: int = 50) -> Tuple[Path, Path]:
    """A cage file (the unit box) and a model file (loose points inside)."""
    cage, model = folder / "cage.obj", folder / "model.obj"
    cage.write_text(obj_text(box_vertices(), BOX_QUADS))
    model.write_text(obj_text(points_inside(count), []))
    return cage, model


def write_pose(folder: Path) -> Path:
    """The box, twice as long in x, without faces."""
    pose = folder / "pose.obj"
    pose.write_text(obj_text(box_vertices() * [2, 1, 1], []))
    return pose
