"""A private `barycastd` for callers that name no server.

It listens on a Unix socket in a fresh folder that only this user can enter, and ends with its client: when
`close()` is called, or, whatever happens to the client, when the daemon's standard input closes. Forked processes may
use it; only the process that started it ends it.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import time
import weakref
from pathlib import Path
from typing import Optional

from barycast.v1 import cage_pb2

from .errors import InputError, ServerError

_START_SECONDS_MAX = 30.0  # a self-test runs first; far above what it takes even on a loaded machine
_STOP_SECONDS_MAX = 5.0
_POLL_SECONDS = 0.005
_SOCKET_PATH_BYTES_MAX = 100  # sun_path holds 108 on Linux, 104 elsewhere


def find_binary() -> str:
    """Path of `barycastd`: the environment variable BARYCASTD, else the `bin` folder of the build that generated the
    messages, else PATH. Throws InputError that says what to do."""
    named = os.environ.get("BARYCASTD")
    if named:
        found = shutil.which(named)
        if not found:
            raise InputError(f"{named} is not a program; let it name the barycastd binary", field="BARYCASTD")
        return found
    built = Path(cage_pb2.__file__).resolve().parents[3] / "bin" / "barycastd"
    found = shutil.which(str(built)) or shutil.which("barycastd")
    if not found:
        raise InputError("there is no barycastd: build it, put it on PATH, name it in the environment variable "
                         "BARYCASTD, or give the address of a running server, HOST:PORT", field="server")
    return found


def _fresh_folder() -> str:
    folder = tempfile.mkdtemp(prefix="barycast-")
    if len(os.fsencode(os.path.join(folder, "socket"))) <= _SOCKET_PATH_BYTES_MAX:
        return folder
    os.rmdir(folder)
    return tempfile.mkdtemp(prefix="barycast-", dir="/tmp")


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


class LocalServer:
    """A running daemon; `address` is what a gRPC channel takes.

    threads: worker threads, None lets the daemon choose. Throws InputError when there is no binary, ServerError
    when the daemon ends or does not serve in time, with the last line it wrote.
    """

    def __init__(self, threads: Optional[int] = None) -> None:
        binary = find_binary()
        self._owner = os.getpid()
        folder = _fresh_folder()
        self._remove_folder = weakref.finalize(self, _remove, folder, self._owner)  # at the latest at exit
        self._log = os.path.join(folder, "log")
        self._socket = os.path.join(folder, "socket")
        self.address = "unix:" + self._socket
        port_file = os.path.join(folder, "port")
        command = [binary, "--listen", self.address, "--port-file", port_file, "--exit-on-stdin-close",
                   "--log-level", "error"]
        if threads is not None:
            command += ["--threads", str(threads)]
        try:
            with open(self._log, "wb") as log:
                # Its own session: Ctrl-C at a terminal reaches the client only, which then ends the daemon.
                self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log,
                                                 start_new_session=True)
        except OSError as error:
            self._remove_folder()
            raise InputError(f"{binary} cannot be started: {error.strerror}", field="BARYCASTD") from error
        try:
            self._wait(port_file)
        except BaseException:
            self.close()
            raise

    def _wait(self, port_file: str) -> None:
        """Until the daemon has written its port file, which it does once it serves."""
        deadline = time.monotonic() + _START_SECONDS_MAX
        while time.monotonic() < deadline:
            if os.path.exists(port_file):
                return
            if self._process.poll() is not None:
                raise ServerError(f"barycastd ended at start with status {self._process.returncode}"
                                  f"{self._last_words()}", code="INTERNAL")
            time.sleep(_POLL_SECONDS)
        raise ServerError(f"barycastd did not serve within {_START_SECONDS_MAX:.0f} s{self._last_words()}",
                          code="DEADLINE_EXCEEDED")

    def _last_words(self) -> str:
        lines = Path(self._log).read_text(errors="replace").strip().splitlines()
        return f": {lines[-1]}" if lines else ""

    @property
    def pid(self) -> int:
        """Process number of the daemon."""
        return self._process.pid

    def alive(self) -> bool:
        """Whether the daemon still runs; in a forked process, whether it takes connections."""
        if os.getpid() == self._owner:
            return self._process.poll() is None
        with socket.socket(socket.AF_UNIX) as probe:
            return probe.connect_ex(self._socket) == 0

    def close(self) -> None:
        """Ends the daemon and removes its folder; in a forked process, does nothing. May be called again."""
        if os.getpid() != self._owner:
            return
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_SECONDS_MAX)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._process.stdin:
            self._process.stdin.close()
        self._remove_folder()
