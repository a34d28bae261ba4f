#!/usr/bin/env python3
"""How time and memory grow: sweep.py [--axes cages points samples threads] [--repeats N] [--json FILE]

Runs barycast_bench over spheres, one number varied at a time around a middle (harmonic, 600 triangles, 30,000 points in
a sphere of 0.8 of the cage's size, 50 samples, 2 threads, denoised but for the sizes of cages), and prints a table:
microseconds of the whole binding per point, of its walks and of their moments and fits, and bytes per point at the peak. Every setting runs in a
process of its own, so that peaks are its own; the medians of N repeats; the settings of an axis in turns. Wants
build/bin/barycast_bench and a quiet machine.
"""
import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

BENCH = Path(__file__).resolve().parents[2] / "build/bin/barycast_bench"

MIDDLE = {"triangles": 600, "points": 30_000, "samples": 50, "threads": 2}
AXES = {  # what varies, its values
    "cages": ("triangles", [12, 100, 600, 2_500, 10_000, 100_000]),  # denoised rows hold nearly all vertices
    "points": ("points", [10_000, 30_000, 100_000, 300_000, 1_000_000]),
    "samples": ("samples", [20, 50, 200, 1_000, 5_000]),
    "threads": ("threads", [1, 2]),
}
TIMEOUT_SECONDS = 1800


def arguments_of(command_line):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     allow_abbrev=False)
    parser.add_argument("--axes", nargs="+", choices=AXES, default=list(AXES))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--denoise", choices=("auto", "none"), default="auto")
    parser.add_argument("--most", type=int, help="leave out larger settings of an axis")
    parser.add_argument("--bench", type=Path, default=BENCH, help="the program")
    parser.add_argument("--json", help="file for what barycast_bench printed")
    return parser.parse_args(command_line)


def write_sphere(path, parallels, meridians, radius, triangles):
    """A sphere of quads between its polar caps, or all of triangles."""
    polar = np.pi * np.arange(1, parallels) / parallels
    azimuth = 2 * np.pi * np.arange(meridians) / meridians
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    around = radius * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    points = np.concatenate([[[0, 0, radius]], around.reshape(-1, 3), [[0, 0, -radius]]])
    corner = 1 + np.arange((parallels - 1) * meridians).reshape(parallels - 1, meridians)
    beside = np.roll(corner, -1, axis=1)
    last = np.full(meridians, len(points) - 1)
    first = np.zeros(meridians, int)
    faces = [np.stack([first, corner[0], beside[0]], -1), np.stack([last, beside[-1], corner[-1]], -1)]
    quads = np.stack([corner[:-1], corner[1:], beside[1:], beside[:-1]], -1).reshape(-1, 4)
    faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]] if triangles else [quads]
    with open(path, "w", encoding="ascii") as file:
        np.savetxt(file, points, "v %.9g %.9g %.9g")
        for list_of_faces in faces:
            np.savetxt(file, list_of_faces + 1, "f" + " %d" * list_of_faces.shape[1])


def write_cage(path, triangles):
    parallels = max(2, round((triangles / 4) ** 0.5) + 1)
    write_sphere(path, parallels, max(3, round(triangles / (2 * (parallels - 1)))), 1.0, True)


def write_model(path, points):
    parallels = max(3, round((points / 2) ** 0.5))
    write_sphere(path, parallels, round(points / (parallels - 1)), 0.8, False)


def run(bench, setting, denoise, folder):
    cage, model = folder / f"cage{setting['triangles']}.obj", folder / f"model{setting['points']}.obj"
    if not cage.exists():
        write_cage(cage, setting["triangles"])
    if not model.exists():
        write_model(model, setting["points"])
    done = subprocess.run([bench, "--cage", cage, "--model", model, "--samples", str(setting["samples"]), "--threads",
                           str(setting["threads"]), "--denoise", denoise, "--repeats", "1", "--json"],
                          capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    if done.returncode != 0:
        sys.exit(f"sweep.py: barycast_bench: {done.stderr.strip()}")
    return {"setting": setting, **json.loads(done.stdout)}


def line_of(value, runs):
    points = runs[0]["points"]

    def median(of):
        return statistics.median(of(run) for run in runs)

    micro = 1e6 / points
    return (f"{value:>10,} {runs[0]['elements']:>9,} {runs[0]['control_vertices']:>9,} {points:>10,} "
            f"{median(lambda r: r['total_s']):>9.3f} {micro * median(lambda r: r['total_s']):>10.2f} "
            f"{micro * median(lambda r: r['stages']['walk']):>10.2f} "
            f"{micro * median(lambda r: r['stages']['moments'] + r['stages']['solve']):>10.2f} "
            f"{median(lambda r: r['stages']['build']):>9.3f} {median(lambda r: r['peak_bytes']) / points:>10,.0f}")


def main():
    arguments = arguments_of(sys.argv[1:])
    if not arguments.bench.exists():
        sys.exit(f"sweep.py: there is no {arguments.bench}; run cmake --build build --target barycast_bench")
    records = []
    with tempfile.TemporaryDirectory() as name:
        for axis in arguments.axes:
            of, values = AXES[axis]
            denoise = "none" if axis == "cages" else arguments.denoise
            values = [value for value in values if arguments.most is None or value <= arguments.most]
            runs = {value: [] for value in values}
            for _ in range(arguments.repeats):
                for value in values:
                    runs[value].append(run(arguments.bench, {**MIDDLE, of: value}, denoise, Path(name)))
            print(f"{of:>10} {'elements':>9} {'vertices':>9} {'points':>10} {'seconds':>9} {'us/point':>10} "
                  f"{'walks':>10} {'fits':>10} {'build, s':>9} {'bytes/pt.':>10}", flush=True)
            for value in values:
                print(line_of(value, runs[value]), flush=True)
                records += runs[value]
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(records, indent=1) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
