#!/usr/bin/env python3
"""How often rows are within the error that they state: intervals.py CAGE MODEL [options]

Binds three sets of points (query_sets.py: inside, near, outside) to target errors, and counts the rows whose distance
from those of many more walks is within the bound that they state for 95 in 100 of them. That is noise. Bias, of which
the bound knows nothing, is stated apart: E of the many walks against the reference (references.py).

    intervals.py cage.obj model.obj --targets 1 2e-3 --points 200
"""
import argparse
import sys

import checkout  # before barycast: where it is
import numpy as np

from accuracy import TIMEOUT_SECONDS, note
from barycast import BarycastError, Client, load_cage, load_model
from query_sets import NAMES, make_query_set
from references import References, row_error
from surface import Surface

SETS = [name for name in NAMES if name != "on"]  # rows on the cage have no noise
MANY_SEED = 1000  # of the many walks


def arguments_of(command_line):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cage")
    parser.add_argument("model")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--targets", nargs="+", type=float, default=[1.0, 2e-3],
                        help="the largest, 1, is met by the fewest rounds there can be")
    parser.add_argument("--points", type=int, default=200, help="of each set")
    parser.add_argument("--seeds", type=int, default=4, help="bindings whose rows are counted together")
    parser.add_argument("--samples", type=int, default=60000, help="of the many walks")
    parser.add_argument("--panels", type=int, default=2500, help="of the reference")
    parser.add_argument("--cache", default=checkout.ROOT / "build" / "references", help="folder of references")
    parser.add_argument("--server", help="host:port; without it a private one is started")
    return parser.parse_args(command_line)


def run(client, cage, model, arguments):
    options = {"estimator": "predicted", "prune_below": 0.0, "dtype": "float64"}
    surface = Surface.of(cage, 10000)
    references = References(client, cage, arguments.cache, "", arguments.panels, 1)
    print("set      target    points  walks a point  within, %  rms noise  rms stated  bias", flush=True)
    for name in arguments.sets:
        query = make_query_set(name, client, cage, surface, model, arguments.points)
        points = query.evaluation_points
        if len(points) == 0:
            note(f"{name}: no point qualifies")
            continue
        many = client.bind(cage, points, samples=arguments.samples, seed=MANY_SEED, denoise="none",
                           **options).matrix.toarray()
        bias = row_error(many, references.get("harmonic", points, name).values)
        for target in arguments.targets:
            bindings = [client.bind(cage, points, target_error=target, errors=True, seed=seed, **options)
                        for seed in range(arguments.seeds)]
            off = np.concatenate([np.linalg.norm(binding.matrix.toarray() - many, axis=1) for binding in bindings])
            standard, bound = np.concatenate([binding.errors for binding in bindings]).T.astype(float)
            walks = np.mean([binding.report["samples"] for binding in bindings]) / len(points)
            print(f"{name:8} {target:<9.2g} {len(points):6} {walks:14.0f} {100 * np.mean(off <= bound):10.1f} "
                  f"{np.sqrt(np.mean(off**2)):10.5f} {np.sqrt(np.mean(standard**2)):11.5f}  {bias:.5f}", flush=True)


def main():
    arguments = arguments_of(sys.argv[1:])
    try:
        with Client(arguments.server, timeout_seconds=TIMEOUT_SECONDS) as client:
            run(client, load_cage(arguments.cage), load_model(arguments.model), arguments)
    except BarycastError as error:
        sys.exit(f"intervals.py: {error}")


if __name__ == "__main__":
    main()
