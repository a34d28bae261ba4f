"""What the commands of the command line do; `cli` parses and maps errors to exit codes."""

from __future__ import annotations

import argparse
import json
import sys
import threading
from contextlib import ExitStack, contextmanager
from typing import Any, Dict, Iterator, List, Optional

from . import files
from .address import check_address
from .binding import Binding
from .client import Client
from .errors import InputError
from .exchange import ProgressCallback
from .mesh_io import load_cage, load_model, points_for, save_model
from .options import compute_options, output_options
from .report import capability_lines, capability_values, linear_precision_error, statistics, summary_lines

_WAIT_SECONDS_UNTOLD = 2.0  # longer than a daemon on this machine or a name's resolution takes
_POLL_SECONDS = 0.02


def bind(arguments: argparse.Namespace) -> None:
    """Computes a binding and writes it, or says what it would cost."""
    if not arguments.estimate:
        files.check_binding_output(arguments.output, (arguments.cage, arguments.model))
    if arguments.server is not None:
        check_address(arguments.server)  # before files are read
    cage = load_cage(arguments.cage)
    model = load_model(arguments.model)
    points = points_for(model, cage.dimension)
    if len(cage.control_vertices) > len(points):
        print(f"barycast: note: the cage has more vertices ({len(cage.control_vertices):,}) than the model has points "
              f"({len(points):,}); are they swapped?", file=sys.stderr)
    options = compute_options(arguments.coordinates, arguments.preset, arguments.samples, arguments.seed,
                              arguments.denoise, arguments.thickness, arguments.walk_steps_max, arguments.prune_below,
                              estimator=arguments.estimator, panels=arguments.panels,
                              target_error=arguments.target_error, tables=arguments.tables)
    output = output_options(arguments.dtype, arguments.gradients, arguments.influences, arguments.errors)
    with Client(arguments.server, retry_seconds=arguments.retry_seconds) as client, _waiting_line(client, arguments):
        if arguments.estimate:
            cost = client.estimate(cage, len(points), model.faces, options, output)
            values = {name: int(getattr(cost, name)) for name in ("memory_bytes", "samples", "output_bytes")}
            print(json.dumps(values, indent=2) if arguments.json else
                  f"{cost.memory_bytes / 1e6:,.1f} MB of the server's memory, "
                  f"{'at most ' if arguments.tables or arguments.target_error is not None else ''}{cost.samples:,} samples, "
                  f"{cost.output_bytes / 1e6:,.1f} MB of rows")
            return
        with _progress_bar(arguments.quiet) as progress:
            binding = client.bind_with(cage, points, model.faces, options, output, progress)
    binding.save(arguments.output)
    if arguments.json:
        print(json.dumps({**binding.report, **statistics(binding)}, indent=2))
    elif not arguments.quiet:
        print("\n".join(summary_lines(binding)))


def deform(arguments: argparse.Namespace) -> None:
    """Poses a model."""
    files.check_output(arguments.output, (arguments.binding, arguments.posed_cage, arguments.model))
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


def capabilities(arguments: argparse.Namespace) -> None:
    """Shows what a server computes and refuses."""
    with Client(arguments.server, retry_seconds=arguments.retry_seconds) as client, _waiting_line(client, arguments):
        answer = client.capabilities()
    print(json.dumps(capability_values(answer), indent=2) if arguments.json else "\n".join(capability_lines(answer)))


def inspect(arguments: argparse.Namespace) -> None:
    """Shows what a binding holds."""
    binding = Binding.load(arguments.binding)
    values: Dict[str, Any] = {**binding.report, **statistics(binding), "cage_digest": binding.cage_digest}
    warnings: List[str] = []
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
            message = "is not the cage that was bound"  # it may be a pose of it
            warnings.append(f"warning: {arguments.cage}: {message}")
            values["warnings"] = [{"field": arguments.cage, "message": message}, *binding.report["warnings"]]
    print(json.dumps(values, indent=2) if arguments.json else "\n".join(warnings + lines))


@contextmanager
def _waiting_line(client: Client, arguments: argparse.Namespace) -> Iterator[None]:
    """While a server that was named does not answer for a while, one line on standard error says so, where somebody
    watches."""
    done = threading.Event()

    def watch() -> None:
        waited = 0.0
        while waited < _WAIT_SECONDS_UNTOLD:
            if done.wait(_POLL_SECONDS):
                return
            waited = 0.0 if client.connection.memory.answered else waited + _POLL_SECONDS
        print(f"\r\x1b[Kwaiting for a server at {arguments.server} (up to {arguments.retry_seconds:g} s)",
              file=sys.stderr, flush=True)

    if arguments.server is None or getattr(arguments, "quiet", False) or not sys.stderr.isatty():
        yield
        return
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


@contextmanager
def _progress_bar(quiet: bool) -> Iterator[Optional[ProgressCallback]]:
    """A progress callback that draws on standard error, or None when nobody watches."""
    try:
        from tqdm import tqdm
    except ImportError:  # it is optional
        tqdm = None
    if tqdm is None or quiet or not sys.stderr.isatty():
        yield None
        return
    with ExitStack() as stack:
        bars: List[Any] = []

        def show(stage: str, done: int, total: int) -> None:
            if not bars:  # not before there is anything to show
                bars.append(stack.enter_context(
                    tqdm(total=1, leave=False, bar_format="{desc:<10}{percentage:3.0f}%|{bar}| {elapsed}")))
            [bar] = bars
            bar.set_description_str(stage, refresh=False)
            bar.total, bar.n = max(total, 1), done
            bar.refresh()

        yield show
