#!/usr/bin/env python3
"""Checks an image of the service by running it: run.py IMAGE BUILD [STEP...]

Every step prints a line with its figure; the first that fails ends the run with a sentence and exit code 1. IMAGE is
compared with the daemon of the build folder BUILD, whose client calls it. Called by deploy/container_test.sh.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import List

import numpy as np
from engine import MIB, Client, Container, Failed, check, ended, metrics_at, podman, told, wait_for

import balanced  # noqa: E402  (engine puts its folder on the path)
from balanced import free_port  # noqa: E402

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

# Rows leave in blocks as they are done, for some seconds on one thread.
LONG = ["--estimator", "sampling", "--samples", 200, "--denoise", "none"]
DRAIN_SECONDS = 60


def same_bytes(first: Path, second: Path) -> int:
    """How many bytes of arrays the bindings hold. Throws Failed where one differs."""
    ours, theirs = np.load(first), np.load(second)
    check(ours.files == theirs.files, f"{first.name} holds {ours.files}, {second.name} {theirs.files}")
    names = set(ours.files) - {"report"}  # it has timings
    for name in names:
        check(ours[name].tobytes() == theirs[name].tobytes(), f"{name} of {first.name} and {second.name} differ")
    return sum(ours[name].nbytes for name in names)


def resumed_rows(binding: Path) -> List[int]:
    return list(json.loads(str(np.load(binding)["report"]))["resumed_rows"])


def starts(image: str, client: Client) -> str:
    with Container(image) as container:
        check(container.health() == "healthy", f"the engine calls it {container.health()}")
        return f"{container.seconds:.2f} s to ready, read-only, no capabilities, 512 MiB, 1 CPU"


def confined(image: str, client: Client) -> str:
    with Container(image) as container:
        check(container.status("Uid").split() == ["65532"] * 4, f"it runs as {container.status('Uid')}")
        for kind in ("CapPrm", "CapEff", "CapBnd"):
            check(int(container.status(kind), 16) == 0, f"{kind} is {container.status(kind)}")
        check(container.status("NoNewPrivs") == "1", "it may gain privileges")
        root = [line.split() for line in container.proc("mountinfo").splitlines() if line.split()[4] == "/"]
        check(root[-1][5].split(",")[0] == "ro", "its root can be written")
        shell = podman("exec", container.id, "/bin/sh", "-c", "true")
        check(shell.returncode != 0 and "no such file" in shell.stderr, "there is a shell")
        labels = json.loads(told("image", "inspect", "--format", "{{json .Labels}}", image))
        for name in ("title", "version", "revision", "created", "licenses"):
            check(labels.get(f"org.opencontainers.image.{name}"), f"no label for its {name}")
        version = told("exec", container.id, "/usr/bin/barycastd", "--version").split()[-1]
        check(labels["org.opencontainers.image.version"] == version, f"the label of {version} says another version")
        return f"user 65532, no shell, version {version}, revision {labels['org.opencontainers.image.revision'][:12]}"


def binds(image: str, client: Client) -> str:
    choices = [["--gradients"], ["--coordinates", "mean-value", "--dtype", "float64"]]
    with Container(image) as container:
        total = 0
        for choice in choices:
            here = client.bind("host", *choice)
            total += same_bytes(client.bind("container", *choice, "--server", container.address), here)
        return f"{len(choices)} bindings from outside, {total / 1e6:.1f} MB, equal to the host build's"


def metrics(image: str, client: Client) -> str:
    """What the operator's page and the autoscaler name is there to be asked."""
    named = {name for file in (DEPLOY / "README.md", DEPLOY / "kubernetes" / "base" / "horizontal-pod-autoscaler.yaml")
             for name in re.findall(r"\bbarycastd_[a-z0-9_]+\b", file.read_text())}
    # Made of it by the adapter's rule, which the page states.
    named.remove("barycastd_queue_wait_seconds_p90")
    with Container(image) as container:
        client.bind("counted", "--server", container.address)
        page = metrics_at(container.metrics_address)
        there = {sample.split("{")[0] for sample in page}
        there |= {name.removesuffix("_bucket") for name in there}
        check(named <= there, f"there is no {', '.join(sorted(named - there))}")
        waits = int(page["barycastd_queue_wait_seconds_count"])
        check(waits > 0, "a computation did not count its waits")
        return f"{len(named)} metrics that operators are told of; {waits} waits of a binding counted"


def threads(image: str, client: Client) -> str:
    found = []
    cores = len(os.sched_getaffinity(0))
    check(cores >= 2, "this step needs two CPUs")
    for options, cpus, expected in ([], 0.5, 1), ([], 2, 2), (["--cpuset-cpus", min(os.sched_getaffinity(0))], 2, 1):
        with Container(image, *options, cpus=cpus) as container:
            found.append(int(container.metric("barycastd_arena_threads")))
            check(found[-1] == expected, f"{found[-1]} threads with {cpus} CPUs and {options}, expected {expected}")
    return f"{found[0]} with 0.5 CPUs, {found[1]} with 2, {found[2]} on one of them"


def memory(image: str, client: Client) -> str:
    with Container(image, memory=512 * MIB, cpus=2) as container:
        large, pair = client.folder / "crowd.obj", client.folder / "pair.obj"
        write_crowd(client.model, large, 6)
        write_crowd(client.model, pair, 2)
        # As much as it admits at once, and more: busy answers are retried.
        server = ["--server", container.address, "--retry-seconds", 120]
        kinds = [({"model": pair}, []), ({}, ["--gradients"]), ({}, ["--denoise", "none", "--gradients"]),
                 ({}, ["--tables"]), ({}, ["--estimator", "sampling"]), ({}, ["--denoise", "none", "--samples", 100])]
        jobs = [client.begin_bind(f"job{number}", *options, *server, **files)
                for number, (files, options) in enumerate(2 * kinds)]
        code, said = ended(client.begin_bind("refused", "--server", container.address, model=large))
        check(code == 3 and "more than this server's limit" in said, f"a job over the limit ended with {code}: {said}")
        for job in jobs:
            code, said = ended(job)
            check(code == 0, f"a job within the limit ended with {code}: {said}")
        check(container.metric("barycastd_overload_refusals_total") > 0, "nothing had to wait for memory")
        peak = container.peak_bytes()
        check(peak < container.memory, f"{peak / MIB:.0f} MiB is not below the limit")
        check(container.state("Running") and not container.state("OOMKilled"), "the kernel ended it")
        return f"a job over the limit is refused; {len(jobs)} at once, of 6 kinds, peak at {peak / MIB:.0f} of 512 MiB"


def unhealthy(image: str, client: Client) -> str:
    with Container(image) as container:
        told("kill", "--signal", "STOP", container.id)
        checks = 0
        while container.health() == "healthy":
            check(not container.healthy(), "a server that hangs passes its health check")
            checks += 1
            check(checks < 10, "ten failed checks and still healthy")
        check(checks > 0 and container.health() == "unhealthy", f"a server that hangs is {container.health()}")
        told("kill", "--signal", "CONT", container.id)
        wait_for(container.healthy, "it does not recover")
        check(container.health() == "healthy", f"the engine calls it {container.health()}")
        return f"{container.health()} again after a hang that {checks} checks made unhealthy"


def drains(image: str, client: Client) -> str:
    with Container(image, environment={"BARYCASTD_DRAIN_SECONDS": DRAIN_SECONDS}) as container:
        server = ["--server", container.address, "--retry-seconds", 0]
        job = client.begin_bind("drained", *LONG, *server)
        wait_for(container.busy, "the job does not begin")
        begin = time.monotonic()
        stop = container.stop(DRAIN_SECONDS + 15)
        wait_for(lambda: "draining" in container.log(), "it does not drain")
        check(not container.healthy(), "it is healthy while it drains")
        code, said = ended(client.begin_bind("late", *LONG, *server))
        check(code == 4, f"a new job ended with {code} while the server drains: {said}")
        check(job.poll() is None, "the job was done before the drain could show")
        code, said = ended(job)
        check(code == 0, f"the running job ended with {code}: {said}")
        check(stop.wait(DRAIN_SECONDS + 30) == 0, "podman stop failed")
        seconds = time.monotonic() - begin
        check(container.state("ExitCode") == 0, f"exit code {container.state('ExitCode')}")
        check("stopped" in container.log(), "the log does not say that it stopped")
        same_bytes(client.folder / "drained.npz", client.bind("undisturbed", *LONG))
        return f"exit 0 after {seconds:.1f} s; the running job was finished, a new one turned away"


def processors(image: str, client: Client) -> str:
    root = told("image", "mount", image)
    try:
        def on(processor: str, *arguments: str) -> subprocess.CompletedProcess:
            command = ["qemu-x86_64", "-L", root, "-cpu", processor, f"{root}/usr/bin/barycastd", *arguments]
            return subprocess.run(command, capture_output=True, text=True, timeout=120)

        old = on("Nehalem")
        check(old.returncode == 3 and "this processor lacks AVX2" in old.stderr,
              f"on Nehalem it ends with {old.returncode}: {old.stderr.strip()}")
        new = on("Haswell", "--self-test")
        check(new.returncode == 0, f"on Haswell the self-test ends with {new.returncode}: {new.stderr.strip()}")
    finally:
        told("image", "unmount", image)
    return "Nehalem gets its sentence and exit 3, Haswell (AVX2 only) passes the self-test"


def replicas(image: str, client: Client) -> str:
    log = client.folder / "haproxy.log"
    with Container(image) as first, Container(image) as second, \
            balanced.Balancer([first.address, second.address], log) as balancer:
        both = [first, second]
        server = ["--server", balancer.address]
        count = 8
        for _ in range(2):
            for number in range(count):
                cage = client.folder / f"cage{number}.obj"
                write_scaled(client.cage, cage, 1 + 0.01 * number)
                client.bind("affine", "--estimator", "sampling", "--samples", 1, *server, cage=cage)
        held = [balanced.cages_built(replica.metrics_address) for replica in both]
        check(sum(held) == count and min(held) > 0, f"{count} cages were built {held[0]} and {held[1]} times")

        begin = time.monotonic()
        client.bind("alive", *LONG, *server)
        seconds = time.monotonic() - begin
        job = client.begin_bind("killed", *LONG, *server)
        wait_for(lambda: any(replica.busy() for replica in both), "the job does not begin")
        victim, other = both if first.busy() else both[::-1]
        rows_before = metrics_at(other.metrics_address)["barycastd_rows_total"]
        time.sleep(0.4 * seconds)  # so that rows have left
        check(victim.busy(), "the job was done before the replica could be killed")
        told("kill", victim.id)
        code, said = ended(job)
        check(code == 0, f"the client ended with {code}: {said}")
        rows = metrics_at(other.metrics_address)["barycastd_rows_total"] - rows_before
        check(rows > 0 and resumed_rows(client.folder / "killed.npz"), "the other replica made no rows")
        same_bytes(client.folder / "killed.npz", client.folder / "alive.npz")
        same_bytes(client.folder / "killed.npz", client.bind("host", *LONG))
        balancer.wait_for("DOWN")
        return (f"{count} cages on {held[0]} + {held[1]}, none on both; one replica killed, the bind went on at row "
                f"{resumed_rows(client.folder / 'killed.npz')[0]:,} on the other")


def composed(image: str, client: Client) -> str:
    address, metrics_address = (f"127.0.0.1:{free_port()}" for _ in range(2))
    project = f"barycast-test-{os.getpid()}"
    environment = {**os.environ, "BARYCASTD_IMAGE": image, "BARYCAST_ADDRESS": address,
                   "BARYCAST_METRICS_ADDRESS": metrics_address}

    def compose(*arguments: str) -> None:
        done = subprocess.run(["podman-compose", "-p", project, "-f", str(DEPLOY / "compose.yaml"), *arguments],
                              env=environment, capture_output=True, text=True, timeout=180)
        check(done.returncode == 0, f"podman-compose {arguments[0]} failed: {done.stderr.strip()}")

    try:
        compose("up", "--detach")
        name = told("ps", "--quiet", "--filter", f"label=io.podman.compose.project={project}")
        check(name, "podman-compose started no container")
        wait_for(lambda: podman("healthcheck", "run", name).returncode == 0, "the composed service is not healthy")
        same_bytes(client.bind("composed", "--server", address), client.bind("host"))
        check(metrics_at(metrics_address)["barycastd_serving"] == 1, "its metrics do not say that it serves")
        held = json.loads(told("inspect", "--format", "{{json .HostConfig}}", name))
        check(held["ReadonlyRootfs"] and held["Memory"] == 4096 * MIB, "it is not read-only, or has no memory limit")
        check(held["NanoCpus"] == 2_000_000_000 and held["CapDrop"], "it has capabilities, or no CPU limit")
        job = client.begin_bind("drained", *LONG, "--server", address, "--retry-seconds", 0)
        wait_for(lambda: metrics_at(metrics_address)["barycastd_admitted_requests"] > 0, "the job does not begin")
        compose("down", "-t", "75")
        code, said = ended(job)
        check(code == 0, f"the job that ran when it was stopped ended with {code}: {said}")
    finally:
        compose("down")
        podman("network", "rm", "--force", f"{project}_default")
    return "deploy/compose.yaml up, healthy, bound from outside through its published port, a job drained, down"


def kube_played(image: str, client: Client) -> str:
    """The manifest of the overlay with exec probes, without ports, which a host's network does not map."""
    address, metrics_address = (f"127.0.0.1:{free_port()}" for _ in range(2))
    overlay, name = client.folder / "overlay", f"test-{os.getpid()}"
    overlay.mkdir()
    patch = [{"op": "remove", "path": "/spec/template/spec/containers/0/ports"},
             *[{"op": "add", "path": "/spec/template/spec/containers/0/env/-", "value": {"name": key, "value": value}}
               for key, value in (("BARYCASTD_LISTEN", address), ("BARYCASTD_METRICS_LISTEN", metrics_address))]]
    repository, tag = image.rsplit(":", 1)
    (overlay / "kustomization.yaml").write_text(json.dumps({
        "apiVersion": "kustomize.config.k8s.io/v1beta1", "kind": "Kustomization", "namePrefix": f"{name}-",
        "resources": [os.path.relpath(DEPLOY / "kubernetes" / "exec-probes", overlay.resolve())],
        "images": [{"name": "barycastd", "newName": repository, "newTag": tag}],
        "patches": [{"target": {"kind": "Deployment"}, "patch": json.dumps(patch)}]}))
    built = subprocess.run(["kubectl", "kustomize", str(overlay)], capture_output=True, text=True, timeout=60)
    check(built.returncode == 0, f"kubectl kustomize failed: {built.stderr.strip()}")
    manifest = client.folder / "manifest.yaml"
    manifest.write_text(built.stdout)
    try:
        told("kube", "play", "--network", "host", manifest)
        container = f"{name}-barycastd-pod-0-barycastd"
        # podman 4.3 runs exec probes by a shell, which the image does not have; kubelet does not, nor does this.
        probe = lambda: podman("exec", container, "/usr/bin/barycastd", "--probe").returncode == 0  # noqa: E731
        wait_for(probe, "the exec probe of the played manifest does not succeed")
        same_bytes(client.bind("played", "--server", address), client.bind("host"))
        held = json.loads(told("container", "inspect", container))[0]
        check(held["HostConfig"]["ReadonlyRootfs"] and not held["EffectiveCaps"], "it is not confined")
        check(held["HostConfig"]["Memory"] == 4096 * MIB, "it has no memory limit")
    finally:
        podman("kube", "down", manifest)
    return "the Deployment with exec probes, played by podman: probed, bound from outside, down"


def write_scaled(source: Path, target: Path, factor: float) -> None:
    """Another cage: the same, scaled."""
    lines = source.read_text().splitlines()
    target.write_text("".join(
        (f"v {' '.join(repr(factor * float(x)) for x in line.split()[1:])}" if line.startswith("v ") else line) + "\n"
        for line in lines))


def write_crowd(source: Path, target: Path, count: int) -> None:
    """The model that many times."""
    lines = [line for line in source.read_text().splitlines() if line.startswith(("v ", "f "))]
    points = sum(line.startswith("v ") for line in lines)
    with target.open("w") as file:
        for number in range(count):
            for line in lines:
                corners = [str(int(corner) + number * points) for corner in line.split()[1:]] if line[0] == "f" else []
                file.write((f"f {' '.join(corners)}" if corners else line) + "\n")


STEPS = {"start": starts, "confined": confined, "bind": binds, "metrics": metrics, "threads": threads, "memory": memory,
         "health": unhealthy, "drain": drains, "processor": processors, "replicas": replicas, "compose": composed,
         "kube": kube_played}


def main() -> int:
    image, build = sys.argv[1], Path(sys.argv[2]).resolve()
    steps = sys.argv[3:] or STEPS
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unwinds, so that containers go too
    os.environ["BARYCASTD"] = str(build / "bin" / "barycastd")
    with tempfile.TemporaryDirectory() as folder, contextlib.closing(
            Client(build / "bin" / "barycast", Path(folder))) as client:
        subprocess.run([sys.executable, "-B", str(DEPLOY / "demo" / "generate.py"), folder], check=True,
                       stdout=subprocess.DEVNULL)
        for name in steps:
            try:
                print(f"{name:<12} {STEPS[name](image, client)}", flush=True)
            except Failed as failure:
                print(f"{name:<12} FAILED: {failure}", flush=True)
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
