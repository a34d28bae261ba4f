"""Names for people ("positive-mean-value", "paper") and the API's option messages."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional

import numpy as np

from barycast.v1 import barycast_pb2, cage_pb2, options_pb2

from .cage import Faces
from .errors import InputError
from .requests import query_set


def _names(enum: Any) -> Dict[str, int]:
    """"mean-value" -> COORDINATE_KIND_MEAN_VALUE and so on, without the unspecified value (0)."""
    unspecified = enum.Name(0)
    prefix = unspecified[:-len("UNSPECIFIED")]
    return {name[len(prefix):].lower().replace("_", "-"): number for name, number in enum.items() if number}


COORDINATES = _names(options_pb2.CoordinateKind)
PRESETS = _names(options_pb2.Preset)
ESTIMATORS = {"auto": options_pb2.ESTIMATOR_UNSPECIFIED, **_names(options_pb2.Estimator)}
DENOISE = _names(options_pb2.Denoise)
STAGES = _names(barycast_pb2.Stage)
FLAGS = _names(barycast_pb2.RowFlag)
DTYPES = {"float32": cage_pb2.DATA_TYPE_FLOAT32, "float64": cage_pb2.DATA_TYPE_FLOAT64}


def name_of(names: Mapping[str, int], number: int) -> str:
    """The name of an enum's value; the number as text when this client does not know it."""
    known = [name for name, value in names.items() if value == number]
    return known[0] if known else str(number)


def _number(names: Mapping[str, int], name: str, field: str) -> Any:
    number = names.get(name.replace("_", "-"))
    if number is None:
        raise InputError(f'"{name}" is not one of {", ".join(names)}', field=field)
    return number


def _whole(value: Optional[int], field: str, bits: int) -> Optional[int]:
    if value is not None and not 0 <= value < 2**bits:
        raise InputError(f"{value} is not a whole number from 0 to 2^{bits} - 1", field=field)
    return value


def compute_options(coordinates: str = "harmonic", preset: str = "default", samples: Optional[int] = None,
                    seed: int = 0, denoise: str = "auto", thickness: Optional[float] = None,
                    walk_steps_max: Optional[int] = None, prune_below: Optional[float] = None,
                    smoothing_time: Optional[float] = None, estimator: str = "auto",
                    panels: Optional[int] = None, target_error: Optional[float] = None, tables: bool = False
                    ) -> options_pb2.ComputeOptions:
    """What to compute; None follows the preset. Ranges are the server's to check, names and whole numbers are
    checked here. Throws InputError naming the field."""
    return options_pb2.ComputeOptions(
        coordinates=_number(COORDINATES, coordinates, "options.coordinates"),
        preset=_number(PRESETS, preset, "options.preset"),
        estimator=_number(ESTIMATORS, estimator, "options.estimator"),
        panels=_whole(panels, "options.panels", 32),
        samples=_whole(samples, "options.samples", 32),
        seed=_whole(seed, "options.seed", 64),
        denoise=_number(DENOISE, denoise, "options.denoise"),
        thickness=thickness,
        walk_steps_max=_whole(walk_steps_max, "options.walk_steps_max", 32),
        prune_below=prune_below,
        smoothing_time=smoothing_time,
        target_error=target_error,
        tables=tables)


def output_options(dtype: Any = "float32", gradients: bool = False, influences_max: int = 0, errors: bool = False
                   ) -> options_pb2.OutputOptions:
    """How rows are written. dtype: float32 or float64, as a name or numpy type. influences_max: 0, or d + 1 or
    more. errors: with a target error only."""
    name = dtype if isinstance(dtype, str) else np.dtype(dtype).name
    return options_pb2.OutputOptions(type=_number(DTYPES, name, "output.type"), gradients=gradients,
                                     influences_max=_whole(influences_max, "output.influences_max", 32),
                                     errors=errors)


def estimate_request(point_count: int, faces: Any, options: options_pb2.ComputeOptions,
                     output: options_pb2.OutputOptions) -> barycast_pb2.EstimateCostRequest:
    """What would be computed, the cage still to be named. faces: anything `Faces.of` takes."""
    return barycast_pb2.EstimateCostRequest(queries=query_set(int(point_count), Faces.of(faces)), options=options,
                                            output=output)


def describe(options: options_pb2.ComputeOptions, output: options_pb2.OutputOptions) -> Dict[str, Any]:
    """The options as plain values for a report."""
    return {
        "coordinates": name_of(COORDINATES, options.coordinates),
        "preset": name_of(PRESETS, options.preset),
        "estimator": name_of(ESTIMATORS, options.estimator),
        "samples": options.samples,
        "panels": options.panels,
        "seed": options.seed,
        "denoise": name_of(DENOISE, options.denoise),
        "thickness": options.thickness,
        "walk_steps_max": options.walk_steps_max,
        "prune_below": options.prune_below,
        "smoothing_time": options.smoothing_time,
        "dtype": name_of(DTYPES, output.type),
        "gradients": output.gradients,
        "influences_max": output.influences_max,
        "target_error": options.target_error,
        "errors": output.errors,
        "tables": options.tables,
    }


def flag_names() -> List[str]:
    """Names of the bits of a row's flag byte, in the order of the bits."""
    return sorted(FLAGS, key=FLAGS.__getitem__)
