"""The command line: `barycast bind`, `deform`, `inspect`, `capabilities`.

Exit codes: 0 done, 2 usage, 3 input (a file, a cage, an option), 4 server, 130 Ctrl-C, 143 terminated. Errors are one
sentence on standard error. Results are files; a summary goes to standard output.
"""

from __future__ import annotations

import argparse
import signal
import sys
from typing import Any, List, Optional

from . import __version__, commands
from .errors import BarycastError, InputError
from .options import COORDINATES, DTYPES, ESTIMATORS, PRESETS
from .retry import RETRY_SECONDS

Verbs = Any  # argparse does not name this type in public
EXIT_INPUT, EXIT_SERVER, EXIT_INTERRUPTED, EXIT_TERMINATED = 3, 4, 130, 143


class _Parser(argparse.ArgumentParser):
    """Takes no option for a longer one: `--sample` is a mistake, and not `--samples`."""

    def __init__(self, **more: Any) -> None:
        super().__init__(allow_abbrev=False, **more)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="barycast", description="Binds models to cages and poses them.")
    parser.add_argument("--version", action="version", version=f"barycast {__version__}")
    verbs = parser.add_subparsers(dest="command", required=True, metavar="bind|deform|inspect|capabilities")
    bind, deform, inspect = _add_bind(verbs), _add_deform(verbs), _add_inspect(verbs)

    capabilities = verbs.add_parser("capabilities", help="show what a server computes and refuses")
    capabilities.set_defaults(run=commands.capabilities)

    for command in (bind, capabilities):
        command.add_argument("--server", metavar="ADDR",
                             help="host:port or unix:/path (default: a private local server)")
        command.add_argument("--retry-seconds", type=float, default=RETRY_SECONDS, metavar="SECONDS",
                             help="how much time lost connections and busy answers may cost (default: %(default)g)")
    for command in (bind, inspect, capabilities):
        command.add_argument("--json", action="store_true", help="print JSON instead of text")
    for command in (bind, deform):
        command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return parser


def _add_bind(verbs: Verbs) -> argparse.ArgumentParser:
    bind: argparse.ArgumentParser = verbs.add_parser("bind",
                                                      help="compute a model's coordinates with respect to a cage")
    bind.add_argument("cage", metavar="CAGE", help=".obj, .ply, .stl or .npz")
    bind.add_argument("model", metavar="MODEL", help=".obj, .ply, .stl or .npz; without faces: loose points")
    bind.add_argument("-o", "--output", metavar="BIND.npz", help="required, except with --estimate")
    bind.add_argument("--coordinates", choices=COORDINATES, default="harmonic")
    bind.add_argument("--estimator", choices=ESTIMATORS, default="auto",
                      help="auto: the best that kind, preset and cage allow (default); sampling: every kind and cage; "
                           "predicted: harmonic, walks correct a prediction; boundary-element: harmonic, no noise; "
                           "exact: mean value, closed cages of triangles and polygons")
    bind.add_argument("--panels", type=int, help="boundary elements, at most (default: 1000)")
    bind.add_argument("--samples", type=int, help="walks or rays per point (default: 12 to correct a prediction, else 50)")
    bind.add_argument("--target-error", type=float, metavar="T",
                      help="predicted, instead of --samples: walks until a point's standard error is T, 1e-5 to 1")
    bind.add_argument("--errors", action="store_true", help="with --target-error: also store every point's error")
    bind.add_argument("--tables", action="store_true",
                      help="predicted, inside closed cages: tables that the server keeps with the cage instead of walks")
    bind.add_argument("--seed", type=int, default=0)
    bind.add_argument("--preset", choices=PRESETS, default="default")
    bind.add_argument("--denoise", choices=("auto", "none"), default="auto",
                      help="auto: over the model's faces, when it has any (default)")
    bind.add_argument("--gradients", action="store_true", help="also store the gradient of every coordinate")
    bind.add_argument("--dtype", choices=DTYPES, default="float32")
    bind.add_argument("--thickness", type=float, help="relative to the cage's diagonal (default: 1e-3)")
    bind.add_argument("--walk-steps-max", type=int, help="longest walk (default: 300; preset paper: 20)")
    bind.add_argument("--prune-below", type=float, help="drop smaller coordinates (default: 1e-4; preset paper: 0)")
    bind.add_argument("--influences", type=int, default=0, metavar="N",
                      help="keep the N largest coordinates per point (default: all)")
    bind.add_argument("--estimate", action="store_true", help="print what it would cost, and compute nothing")
    bind.set_defaults(run=commands.bind)
    return bind


def _add_deform(verbs: Verbs) -> argparse.ArgumentParser:
    deform: argparse.ArgumentParser = verbs.add_parser("deform", help="pose a model with its binding")
    deform.add_argument("binding", metavar="BIND.npz")
    deform.add_argument("posed_cage", metavar="POSED_CAGE", help="only its vertices count")
    deform.add_argument("model", metavar="MODEL", help="the model that was bound; everything but positions is kept")
    deform.add_argument("-o", "--output", metavar="OUT", required=True, help="of the model's format")
    deform.set_defaults(run=commands.deform)
    return deform


def _add_inspect(verbs: Verbs) -> argparse.ArgumentParser:
    inspect: argparse.ArgumentParser = verbs.add_parser("inspect", help="show what a binding holds")
    inspect.add_argument("binding", metavar="BIND.npz")
    inspect.add_argument("--cage", help="with --model: recompute the linear-precision error")
    inspect.add_argument("--model")
    inspect.set_defaults(run=commands.inspect)
    return inspect


def _terminate(*_: object) -> None:
    sys.exit(EXIT_TERMINATED)  # unwinds, so that a private server and its folder go too


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs one command and returns the exit code; argparse exits with 2 by itself."""
    parser = _parser()
    parsed = parser.parse_args(arguments)
    if parsed.command == "inspect" and bool(parsed.cage) != bool(parsed.model):
        parser.error("inspect: --cage and --model belong together")
    if parsed.command == "bind" and not parsed.output and not parsed.estimate:
        parser.error("bind: the following arguments are required: -o/--output")
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
