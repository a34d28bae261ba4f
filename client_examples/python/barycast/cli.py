"""The command line: `barycast bind`, `deform`, `inspect`.

Exit codes: 0 done, 2 usage, 3 input (a file, a cage, an option), 4 server, 130 Ctrl-C, 143 terminated. Errors are one
sentence on standard error. Results are files; a summary goes to standard output.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from contextlib import contextmanager
from typing import Any, Dict, Iterator, List, Optional

from tqdm import tqdm

from . import files
from .binding import Binding
from .client import Client
from .errors import BarycastError, InputError
from .exchange import ProgressCallback
from .mesh_io import load_cage, load_model, points_for, save_model
from .options import COORDINATES, DTYPES, PRESETS
from .report import linear_precision_error, statistics, summary_lines

EXIT_INPUT, EXIT_SERVER, EXIT_INTERRUPTED, EXIT_TERMINATED = 3, 4, 130, 143


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="barycast", description="Binds models to cages and poses them.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="bind|deform|inspect")

    bind = commands.add_parser("bind", help="compute a model's coordinates with respect to a cage")
    bind.add_argument("cage", metavar="CAGE", help=".obj, .ply, .stl or .npz")
    bind.add_argument("model", metavar="MODEL", help=".obj, .ply, .stl or .npz; without faces: loose points")
    bind.add_argument("-o", "--output", metavar="BIND.npz", required=True)
    bind.add_argument("--coordinates", choices=COORDINATES, default="harmonic")
    bind.add_argument("--samples", type=int, help="walks or rays per point (default: 50)")
    bind.add_argument("--seed", type=int, default=0)
    bind.add_argument("--preset", choices=PRESETS, default="default")
    bind.add_argument("--denoise", choices=("auto", "none"), default="auto",
                      help="auto: over the model's faces, when it has any (default)")
    bind.add_argument("--gradients", action="store_true", help="also store the gradient of every coordinate")
    bind.add_argument("--dtype", choices=DTYPES, default="float32")
    bind.add_argument("--thickness", type=float, help="relative to the cage's diagonal (default: 1e-3)")
    bind.add_argument("--walk-steps-max", type=int, help="longest walk (default: 300; preset paper: 20)")
    bind.add_argument("--prune-below", type=float, help="drop smaller coordinates (default: 1e-4; preset paper: 0)")
    bind.add_argument("--server", metavar="ADDR", help="host:port or unix:/path (default: a private local server)")
    bind.set_defaults(run=_bind)

    deform = commands.add_parser("deform", help="pose a model with its binding")
    deform.add_argument("binding", metavar="BIND.npz")
    deform.add_argument("posed_cage", metavar="POSED_CAGE", help="only its vertices count")
    deform.add_argument("model", metavar="MODEL", help="the model that was bound; everything but positions is kept")
    deform.add_argument("-o", "--output", metavar="OUT", required=True, help="of the model's format")
    deform.set_defaults(run=_deform)

    inspect = commands.add_parser("inspect", help="show what a binding holds")
    inspect.add_argument("binding", metavar="BIND.npz")
    inspect.add_argument("--cage", help="with --model: recompute the linear-precision error")
    inspect.add_argument("--model")
    inspect.set_defaults(run=_inspect)

    for command in (bind, inspect):
        command.add_argument("--json", action="store_true", help="print JSON instead of text")
    for command in (bind, deform):
        command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return parser


def _bind(arguments: argparse.Namespace) -> None:
    files.check_output(arguments.output)
    cage = load_cage(arguments.cage)
    model = load_model(arguments.model)
    points = points_for(model, cage.dimension)
    with Client(arguments.server) as client, _progress_bar(arguments.quiet) as progress:
        binding = client.bind(
            cage, points, model.faces, coordinates=arguments.coordinates, samples=arguments.samples,
            seed=arguments.seed, preset=arguments.preset, denoise=arguments.denoise, gradients=arguments.gradients,
            dtype=arguments.dtype, thickness=arguments.thickness, walk_steps_max=arguments.walk_steps_max,
            prune_below=arguments.prune_below, progress=progress)
    binding.save(arguments.output)
    if arguments.json:
        print(json.dumps({**binding.report, **statistics(binding)}, indent=2))
    elif not arguments.quiet:
        print("\n".join(summary_lines(binding)))


def _deform(arguments: argparse.Namespace) -> None:
    files.check_output(arguments.output)
    binding = Binding.load(arguments.binding)
    posed = load_model(arguments.posed_cage)
    model = load_model(arguments.model)
    if len(model.points) != binding.matrix.shape[0]:
        raise InputError(f"has {len(model.points)} points, the binding has {binding.matrix.shape[0]} rows; give the "
                         "model that was bound", field=arguments.model)
    if len(posed.points) != binding.matrix.shape[1]:
        raise InputError(f"has {len(posed.points)} vertices, the binding's cage has {binding.matrix.shape[1]}; give a "
                         "pose of the cage that was bound", field=arguments.posed_cage)
    save_model(model, binding.deform(posed.points), arguments.output)
    if not arguments.quiet:
        print(f"{arguments.output}: {len(model.points):,} points posed")


def _inspect(arguments: argparse.Namespace) -> None:
    binding = Binding.load(arguments.binding)
    values: Dict[str, Any] = {**binding.report, **statistics(binding), "cage_digest": binding.cage_digest}
    lines = summary_lines(binding) + [f"cage: {binding.cage_digest}"]
    options = binding.report["options"]
    lines.append("options: " + ", ".join(f'{name.replace("_", " ")} {value}' for name, value in options.items()))
    if arguments.cage:
        cage = load_cage(arguments.cage)
        model = load_model(arguments.model)
        points = points_for(model, cage.dimension)
        if binding.matrix.shape != (len(points), len(cage.control_vertices)):
            raise InputError(f"{binding.matrix.shape[0]} rows and {binding.matrix.shape[1]} columns do not fit "
                             f"{len(points)} points and {len(cage.control_vertices)} control vertices",
                             field=arguments.binding)
        error = linear_precision_error(binding, cage, points)
        values["linear_precision_error_stored"] = error
        lines.append(f"linear-precision error of the stored rows: {error:.1e} diagonals")
        if cage.digest.sha256.hex() != binding.cage_digest:
            lines.append(f"warning: {arguments.cage}: is not the cage that was bound")
    print(json.dumps(values, indent=2) if arguments.json else "\n".join(lines))


@contextmanager
def _progress_bar(quiet: bool) -> Iterator[Optional[ProgressCallback]]:
    """A progress callback that draws on standard error, or None when nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    with tqdm(total=1, leave=False, bar_format="{desc:<10}{percentage:3.0f}%|{bar}| {elapsed}") as bar:

        def show(stage: str, done: int, total: int) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.total, bar.n = max(total, 1), done
            bar.refresh()

        yield show


def _terminate(*_: object) -> None:
    sys.exit(EXIT_TERMINATED)  # unwinds, so that a private server and its folder go too


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs one command and returns the exit code; argparse exits with 2 by itself."""
    parser = _parser()
    parsed = parser.parse_args(arguments)
    if parsed.command == "inspect" and bool(parsed.cage) != bool(parsed.model):
        parser.error("inspect: --cage and --model belong together")
    signal.signal(signal.SIGTERM, _terminate)
    try:
        parsed.run(parsed)
    except BarycastError as error:
        print(f"barycast: {error}", file=sys.stderr)
        return EXIT_INPUT if isinstance(error, InputError) else EXIT_SERVER
    except KeyboardInterrupt:
        print("barycast: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0
