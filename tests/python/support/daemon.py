"""The real daemon as operators run it, and the few calls that its tests make."""

import os
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Dict, List, Optional

import grpc
import numpy as np
from barycast.v1 import barycast_pb2, barycast_pb2_grpc, cage_pb2, options_pb2


def clean_environment(**variables: str) -> Dict[str, str]:
    """Without settings of ours from outside."""
    return {**{k: v for k, v in os.environ.items() if not k.startswith("BARYCASTD_")}, **variables}


def run(program: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess:
    return subprocess.run([program, *arguments], env=clean_environment(**variables), capture_output=True, text=True,
                          timeout=60)


class Daemon:
    """Serves inside `with`, on any free port, with a metrics page; `log_lines()` after its end."""

    def __init__(self, program: Path, folder: Path, *arguments: str, **variables: str):
        self.log = folder / "log"
        self.port_file, self.metrics_file = folder / "port", folder / "metrics"
        self.command = [program, "--listen", "127.0.0.1:0", "--port-file", self.port_file, "--metrics-listen",
                        "127.0.0.1:0", "--metrics-port-file", self.metrics_file, *arguments]
        self.environment = clean_environment(**variables)

    def __enter__(self) -> "Daemon":
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(self.command, stderr=log, env=self.environment)
        deadline = time.monotonic() + 40
        while not self.metrics_file.exists():
            assert self.process.poll() is None and time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)
        self.address = self.port_file.read_text().strip()
        self.metrics_address = self.metrics_file.read_text().strip()
        self.channel = grpc.insecure_channel(self.address)
        self.stub = barycast_pb2_grpc.BarycastServiceStub(self.channel)
        return self

    def __exit__(self, *_: object) -> None:
        self.channel.close()
        self.process.terminate()
        assert self.process.wait(40) == 0

    def log_lines(self) -> List[str]:
        return self.log.read_text().splitlines()

    def metrics(self) -> Dict[str, float]:
        """Samples of the page by name with labels."""
        with urllib.request.urlopen(f"http://{self.metrics_address}/metrics", timeout=20) as page:
            lines = page.read().decode().splitlines()
        return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if not line.startswith("#")}

    def settled_metrics(self) -> Dict[str, float]:
        """The page once every call is counted: a client has its answer before its call is."""
        deadline = time.monotonic() + 20
        while (page := self.metrics())["barycastd_requests_active"] > 0:
            assert time.monotonic() < deadline, "calls are still running"
            time.sleep(0.02)
        return page

    def compute(self, count: int = 3, metadata: Optional[list] = None, **options: object) -> list:
        """Points inside a tetrahedron; the answer's messages."""
        header = barycast_pb2.ComputeHeader(inline_cage=tetrahedron(),
                                            queries=barycast_pb2.QuerySet(point_count=count),
                                            options=options_pb2.ComputeOptions(**options))
        points = np.tile([0.1, 0.2, 0.3], (count, 1)) * np.linspace(0.5, 1, count)[:, None]
        block = barycast_pb2.PointBlock(points=array(points))
        request = barycast_pb2.ComputeCoordinatesRequest
        return list(self.stub.ComputeCoordinates(iter([request(header=header), request(points=block)]), timeout=60,
                                                 metadata=metadata))


def array(values: np.ndarray) -> cage_pb2.Array:
    kind = cage_pb2.DATA_TYPE_FLOAT64 if values.dtype == np.float64 else cage_pb2.DATA_TYPE_UINT32
    return cage_pb2.Array(type=kind, rows=values.shape[0], columns=values.shape[1], data=values.tobytes())


def tetrahedron() -> cage_pb2.Cage:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint32)
    return cage_pb2.Cage(control_vertices=array(corners), triangles=array(faces))
