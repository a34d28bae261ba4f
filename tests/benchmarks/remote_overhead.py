#!/usr/bin/env python3
"""What the service costs: remote_overhead.py CAGE MODEL [--coordinates K] [--samples M] [--repeats N]

Runs the same binding through a daemon on loopback (the Python client, cage already uploaded, all rows received) and in
process (barycast_bench, less the building of the index), in turns, and prints the medians, their ratio, and where the
difference goes: the server's stages against what is left. Gradients, denoised, float32 rows. Wants build/bin and build/python, and a quiet machine.
"""
import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "client_examples/python"), str(ROOT / "build/python")]
BIN = ROOT / "build/bin"

from barycast import Client, load_cage, load_model  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cage")
    parser.add_argument("model")
    parser.add_argument("--coordinates", default="harmonic")
    parser.add_argument("--samples", type=int, default=50)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    cage, model = load_cage(arguments.cage), load_model(arguments.model)
    remote, local, server = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        daemon = subprocess.Popen([BIN / "barycastd", "--listen", "127.0.0.1:0", "--exit-on-stdin-close",
                                   "--port-file", Path(folder) / "port"], stdin=subprocess.PIPE,
                                  stderr=subprocess.DEVNULL)
        try:
            for _ in range(200):
                if (Path(folder) / "port").exists():
                    break
                time.sleep(0.05)
            with Client((Path(folder) / "port").read_text().strip()) as client:
                client.upload(cage)
                for _ in range(arguments.repeats):
                    start = time.perf_counter()
                    binding = client.bind(cage, model.points, model.faces, coordinates=arguments.coordinates,
                                          samples=arguments.samples, gradients=True)
                    remote.append(time.perf_counter() - start)
                    server.append(sum(v for k, v in binding.report["seconds"].items() if k != "total"))
                    done = subprocess.run([BIN / "barycast_bench", "--cage", arguments.cage, "--model", arguments.model,
                                           "--coordinates", arguments.coordinates, "--samples",
                                           str(arguments.samples), "--json"], check=True, capture_output=True)
                    figures = json.loads(done.stdout)
                    local.append(figures["total_s"] - figures["stages"]["build"])
        finally:
            daemon.stdin.close()
            daemon.wait(timeout=60)
    through, inside, stages = (statistics.median(times) for times in (remote, local, server))
    print(f"{arguments.coordinates}, {len(model.points):,} points, m = {arguments.samples}: daemon {through:.3f} s, "
          f"in process {inside:.3f} s, ratio {through / inside:.3f}; the server's stages {stages:.3f} s, transport, "
          f"decoding and client {through - stages:.3f} s (medians of {arguments.repeats}, interleaved; spread "
          f"{min(remote):.3f} to {max(remote):.3f} and {min(local):.3f} to {max(local):.3f})")


if __name__ == "__main__":
    main()
