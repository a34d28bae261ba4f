"""deploy/haproxy.cfg in front of two replicas: what a balancer that hashes cages does to clients."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Dict, List

CONFIG = Path(__file__).resolve().parents[3] / "deploy" / "haproxy.cfg"
PROGRAM = shutil.which("haproxy", path=os.defpath + ":/usr/sbin:/usr/local/sbin")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def metrics_at(address: str) -> Dict[str, float]:
    """Samples of a daemon's metrics page by name with labels."""
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=20) as page:
        lines = page.read().decode().splitlines()
    return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if not line.startswith("#")}


def cages_built(address: str) -> int:
    page = metrics_at(address)
    return int(page["barycastd_cage_cache_entries"] + page["barycastd_cage_cache_evictions_total"])


class Balancer:
    """Serves inside `with` at `address`; two replicas by theirs."""

    def __init__(self, replicas: List[str], log: Path) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        self.log = log
        self._environment = {**os.environ, "BARYCAST_LISTEN": self.address, "REPLICA_A": replicas[0],
                             "REPLICA_B": replicas[1]}

    def __enter__(self) -> Balancer:
        with open(self.log, "wb") as log:
            self._process = subprocess.Popen([str(PROGRAM), "-f", str(CONFIG)], stderr=log, stdout=log,
                                             env=self._environment)
        try:
            self._wait_until_it_listens()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(20)

    def _wait_until_it_listens(self) -> None:
        host, port = self.address.rsplit(":", 1)
        deadline = time.monotonic() + 20
        while True:
            try:
                return socket.create_connection((host, int(port)), timeout=1).close()
            except OSError:
                assert self._process.poll() is None and time.monotonic() < deadline, self.log.read_text()
                time.sleep(0.05)

    def wait_for(self, words: str, seconds: float = 20) -> None:
        """Until HAProxy has said so."""
        deadline = time.monotonic() + seconds
        while words not in self.log.read_text():
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.05)
