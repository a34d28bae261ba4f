#!/usr/bin/env python3
"""Error of coordinates against references, through the service: accuracy.py CAGE MODEL [options]

Binds four sets of points (query_sets.py: inside, near, on, outside) with every kind, preset, number of samples and
smoothing asked for, and prints E against the reference of that kind (references.py), split into bias and noise
(measure.py; `<` where only a bound on the bias is known). Rows are float64 with gradients.
Seconds are the median request's; the cage has been uploaded and indexed before, boundary elements are solved within
the request. Without denoising only the evaluation points are bound, unless --whole.

    accuracy.py cage.obj model.obj --coordinates harmonic --samples 20 50 200 --denoise none --seeds 5 --json out.json
"""
import argparse
import json
import sys
import time
from pathlib import Path

import checkout  # before barycast: where it is
import numpy as np

from barycast import BarycastError, Client, InputError, files, load_cage, load_model
from measure import measure
from query_sets import NAMES, make_query_set
from references import NoReference, References, row_error
from surface import Surface
from table import HEAD, line_of

KINDS = ("harmonic", "mean-value", "positive-mean-value")
# What each preset of this program asks of the service, and for which kinds. `predicted` is what it does for harmonic
# coordinates by default, `sampling` for the others.
PRESETS = {"paper": ({"preset": "paper"}, KINDS), "sampling": ({"estimator": "sampling"}, KINDS),
           "paper-300": ({"preset": "paper", "walk_steps_max": 300}, ("harmonic",)),
           "predicted": ({"estimator": "predicted"}, ("harmonic",))}
ESTIMATORS = {"boundary-element": ({"estimator": "boundary-element"}, ("harmonic",)),
              "exact": ({"estimator": "exact"}, ("mean-value",))}
TIMEOUT_SECONDS = 1800


def arguments_of(command_line):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cage")
    parser.add_argument("model", help="with faces, where denoising is asked for")
    parser.add_argument("--coordinates", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--sets", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--preset", nargs="*", choices=PRESETS, default=["paper", "sampling"])
    parser.add_argument("--estimator", nargs="*", choices=ESTIMATORS, default=[], help="also, without samples")
    parser.add_argument("--estimator-panels", nargs="+", type=int, default=[1000], help="of boundary-element")
    parser.add_argument("--samples", nargs="+", type=int, default=[50])
    parser.add_argument("--thickness", type=float, help="of all that samples, in diagonals")
    parser.add_argument("--prune-below", type=float, help="instead of the preset's; references are not pruned")
    parser.add_argument("--denoise", nargs="+", choices=("auto", "none"), default=["auto", "none"])
    parser.add_argument("--seeds", type=int, default=1, help="from 0 on; bias and noise want two or more")
    parser.add_argument("--points", type=int, default=100, help="evaluation points of each set")
    parser.add_argument("--surface-points", type=int, default=10000, help="of the cut cage, about")
    parser.add_argument("--whole", action="store_true", help="bind whole meshes without denoising, too, for its time")
    parser.add_argument("--panels", type=int, default=2500, help="of the harmonic reference")
    parser.add_argument("--directions", type=int, default=100000, help="of the positive mean value reference")
    parser.add_argument("--stored", help="npz of stored references at points of the model, to check ours against")
    parser.add_argument("--cache", default=checkout.ROOT / "build" / "references", help="folder of references")
    parser.add_argument("--reference-rows", default=checkout.BIN / "reference_rows", help="the program")
    parser.add_argument("--server", help="host:port; without it a private one is started")
    parser.add_argument("--json", help="file for all figures")
    parser.add_argument("--plot", help="PNG file: error against samples and time")
    arguments = parser.parse_args(command_line)
    for name in ("seeds", "points", "surface_points", "panels", "directions"):
        if getattr(arguments, name) < 1:
            parser.error(f"--{name.replace('_', '-')} must be 1 or more")
    return arguments


def note(text):
    print(f"note: {text}", file=sys.stderr, flush=True)


def settings_of(kind, arguments):
    """(preset's name, m or None, denoise, options of bind) of everything asked for of this kind."""
    for name in arguments.preset:
        options, kinds = PRESETS[name]
        if kind not in kinds:
            note(f"{kind} is not predicted: skipped" if name == "predicted" else
                 f"{name} differs from paper in walks only, and {kind} has none: skipped")
            continue
        for m in arguments.samples:
            for denoise in arguments.denoise:
                yield name, m, denoise, {**options, "samples": m, "denoise": denoise,
                                         "thickness": arguments.thickness, "prune_below": arguments.prune_below}
    for name in arguments.estimator:
        options, kinds = ESTIMATORS[name]
        if kind not in kinds:
            note(f"{name} does not compute {kind}: skipped")
            continue
        for panels in arguments.estimator_panels if name == "boundary-element" else [None]:
            yield name, None, "none", {**options, "panels": panels, "prune_below": arguments.prune_below}


def check_stored(path, kinds, model, references):
    """Prints E between our references and stored ones, at their points."""
    with np.load(path) as stored:
        for kind in kinds:
            try:
                ours = references.get(kind, model.points[stored["index"]], "stored")
            except NoReference as reason:
                note(reason)
                continue
            print(f"{kind}: E {row_error(ours.values, stored[kind.replace('-', '_')]):.5f} between {ours.method} "
                  f"(own error {ours.own_error:.1e}) and {Path(path).name}", flush=True)


def run(client, cage, model, arguments):
    """All records, printed as they come."""
    surface = Surface.of(cage, arguments.surface_points)
    references = References(client, cage, arguments.cache, arguments.reference_rows, arguments.panels,
                            arguments.directions)
    queries = [make_query_set(name, client, cage, surface, model, arguments.points) for name in arguments.sets]
    for query in queries:
        if len(query.chosen) < arguments.points:
            note(f"{query.name}: {len(query.chosen)} points qualify, of {arguments.points} wanted")
    if arguments.stored:
        check_stored(arguments.stored, arguments.coordinates, model, references)
    records = []
    print(HEAD, flush=True)
    for kind in arguments.coordinates:
        settings = list(settings_of(kind, arguments))
        for query in (q for q in queries if len(q.chosen)):
            try:
                reference = references.get(kind, query.evaluation_points, query.name, query.basis)
            except NoReference as reason:
                note(f"{reason}: set {query.name} skipped")
                continue
            client.bind(cage, query.evaluation_points[:1], coordinates=kind, samples=1)  # the index is built now
            for setting in settings:
                try:
                    records.append(measure(client, cage, query, reference, kind, setting, arguments.seeds,
                                           arguments.whole))
                except InputError as error:
                    note(f"{kind}, {setting[0]}, m = {setting[1]}, set {query.name}: {error}: skipped")
                    continue
                print(line_of(records[-1]), flush=True)
    return records


def main():
    arguments = arguments_of(sys.argv[1:])
    started = time.monotonic()
    try:
        for output in filter(None, (arguments.json, arguments.plot)):  # before anything is measured
            files.check_output(output, (arguments.cage, arguments.model))
        cage, model = load_cage(arguments.cage), load_model(arguments.model)
        if cage.dimension != 3:
            sys.exit(f"accuracy.py: {arguments.cage}: cages in space only")
        if "auto" in arguments.denoise and "inside" in arguments.sets and len(model.faces) == 0:
            sys.exit(f"accuracy.py: {arguments.model} has no faces to denoise over; use --denoise none")
        with Client(arguments.server, timeout_seconds=TIMEOUT_SECONDS) as client:
            records = run(client, cage, model, arguments)
    except BarycastError as error:
        sys.exit(f"accuracy.py: {error}")
    if not records:
        sys.exit("accuracy.py: nothing was measured")
    names = {"cage": Path(arguments.cage).name, "model": Path(arguments.model).name}
    if arguments.json:
        Path(arguments.json).write_text(json.dumps([{**names, **record} for record in records], indent=1) + "\n")
    if arguments.plot:
        from figure import draw  # matplotlib is wanted for this alone
        draw(records, arguments.plot, f'{names["cage"]}, {names["model"]}')
    note(f"{len(records)} lines in {time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    main()
