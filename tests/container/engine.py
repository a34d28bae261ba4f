"""Containers for the checks: started as an operator would, reached over loopback, gone at the end whatever happens."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Dict, List

sys.path.append(str(Path(__file__).resolve().parents[1] / "python" / "support"))

from balanced import free_port, metrics_at  # noqa: E402  (found on the path above)

# What deploy/README.md tells operators to give every container of the service.
CONFINED = ["--read-only", "--cap-drop", "all", "--security-opt", "no-new-privileges", "--pids-limit", "256"]
MIB = 1 << 20


class Failed(Exception):
    """What is wrong, in a sentence."""


def check(condition: object, sentence: str) -> None:
    if not condition:
        raise Failed(sentence)


def podman(*arguments: object, timeout: float = 120) -> subprocess.CompletedProcess:
    return subprocess.run(["podman", *map(str, arguments)], capture_output=True, text=True, timeout=timeout)


def told(*arguments: object, timeout: float = 120) -> str:
    """What podman answers. Throws Failed when it refuses."""
    done = podman(*arguments, timeout=timeout)
    check(done.returncode == 0, f"podman {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip()


class Container:
    """Runs inside `with`; ready when it begins. seconds: from the command to the first good health check."""

    _count = itertools.count()

    def __init__(self, image: str, *options: object, memory: int = 512 * MIB, cpus: float = 1,
                 environment: Dict[str, object] = {}) -> None:
        self.memory = memory
        self.address, self.metrics_address = (f"127.0.0.1:{free_port()}" for _ in range(2))
        variables = {"BARYCASTD_LISTEN": self.address, "BARYCASTD_METRICS_LISTEN": self.metrics_address, **environment}
        settings = [f"--env={name}={value}" for name, value in variables.items()]
        self.id = f"barycast-test-{os.getpid()}-{next(self._count)}"
        self._command = ["run", "--detach", "--name", self.id, "--network", "host", *CONFINED, "--memory", memory,
                         "--memory-swap", memory, "--cpus", cpus, *options, *settings, image]

    def __enter__(self) -> Container:
        begin = time.monotonic()
        try:
            told(*self._command)
            while not self.healthy():
                check(self.state("Running"), f"the container ended while it started: {self.log()}")
                check(time.monotonic() - begin < 60, f"not ready after 60 seconds: {self.log()}")
                time.sleep(0.02)
        except BaseException:
            self.__exit__()
            raise
        self.seconds = time.monotonic() - begin
        return self

    def __exit__(self, *_: object) -> None:
        podman("rm", "--force", "--time", "0", self.id)

    def healthy(self) -> bool:
        """Runs the image's HEALTHCHECK, as an engine does."""
        return podman("healthcheck", "run", self.id).returncode == 0

    def health(self) -> str:
        """What the engine makes of the checks so far."""
        return str(json.loads(told("inspect", "--format", "{{json .State.Health}}", self.id))["Status"])

    def state(self, name: str) -> object:
        return json.loads(told("inspect", "--format", "{{json .State}}", self.id))[name]

    def log(self) -> str:
        done = podman("logs", self.id)
        return done.stdout + done.stderr

    def metric(self, name: str) -> float:
        return metrics_at(self.metrics_address)[name]

    def busy(self) -> bool:
        return self.metric("barycastd_admitted_requests") > 0

    def proc(self, name: str) -> str:
        """A file of the server's process, as the host sees it."""
        return Path(f"/proc/{self.state('Pid')}/{name}").read_text()

    def status(self, name: str) -> str:
        lines = dict(line.split(":\t", 1) for line in self.proc("status").splitlines() if ":\t" in line)
        return lines[name].strip()

    def peak_bytes(self) -> int:
        """The most memory that the process ever had at once."""
        return int(self.status("VmHWM").split()[0]) * 1024

    def stop(self, seconds: int) -> subprocess.Popen:
        """SIGTERM, and SIGKILL after that many seconds; returns at once."""
        return subprocess.Popen(["podman", "stop", "--time", str(seconds), self.id], stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL)


def wait_for(condition: object, sentence: str, seconds: float = 60) -> None:
    """Until condition() holds; throws Failed with the sentence when it does not."""
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        check(time.monotonic() < end, sentence)
        time.sleep(0.02)


class Client:
    """The command line of the Python client, in its own process."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program, self.folder = program, folder
        self._begun: List[subprocess.Popen] = []
        self.cage, self.model = folder / "cage.obj", folder / "character.obj"

    def begin_bind(self, name: str, *options: object, cage: Path = None, model: Path = None) -> subprocess.Popen:
        """barycast bind into NAME.npz."""
        command: List[object] = [self.program, "bind", cage or self.cage, model or self.model, "--quiet", "-o",
                                 self.folder / f"{name}.npz", *options]
        self._begun.append(subprocess.Popen([*map(str, command)], stderr=subprocess.PIPE, text=True))
        return self._begun[-1]

    def bind(self, name: str, *options: object, **files: Path) -> Path:
        """The file. Throws Failed when the client fails."""
        code, said = ended(self.begin_bind(name, *options, **files))
        check(code == 0, f"barycast bind failed with {code}: {said}")
        return self.folder / f"{name}.npz"

    def close(self) -> None:
        """Ends what a failed step left behind."""
        for process in self._begun:
            if process.poll() is None:
                process.kill()
                process.communicate()


def ended(process: subprocess.Popen, seconds: float = 180) -> tuple:
    """Its exit code, and what it said."""
    try:
        said = process.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise Failed(f"{process.args[0]} did not end within {seconds:g} seconds") from None
    return process.returncode, (said or "").strip()
