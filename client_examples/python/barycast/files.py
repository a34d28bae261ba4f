"""Reading inputs and writing outputs, with errors that name the file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, Callable, Iterable, Union

from .errors import InputError

PathLike = Union[str, "os.PathLike[str]"]


def read(path: PathLike) -> BinaryIO:
    """The file, open. Throws InputError naming it."""
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", field=str(path), code="NOT_FOUND") from error


def check_output(path: PathLike, inputs: Iterable[PathLike] = ()) -> Path:
    """Where path leads, if a file can be put there; throws InputError otherwise, so that long work can ask first: also
    when it is one of the inputs, by whatever path."""
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise InputError("cannot be written: it exists and is no regular file", field=str(path))
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise InputError(f"cannot be written: {target.parent} is not a folder that you may write to", field=str(path))
    for read_from in inputs:
        if target.exists() and os.path.exists(read_from) and os.path.samefile(target, read_from):
            raise InputError(f"would overwrite the input {read_from}; choose another name", field=str(path))
    return target


def check_binding_output(path: PathLike, inputs: Iterable[PathLike] = ()) -> Path:
    """As check_output, for a binding. It must end in .npz, so that no mistyped name overwrites a model or a cage."""
    if Path(path).suffix.lower() != ".npz":
        raise InputError("must end in .npz: a binding is a numpy archive", field=str(path))
    return check_output(path, inputs)


def write_atomically(path: PathLike, write: Callable[[BinaryIO], object]) -> None:
    """Calls write with a new file beside path and then renames it: readers see the old file or the whole new one.
    Throws InputError when the file cannot be written."""
    target = check_output(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        try:
            with open(temporary, "xb") as file:
                write(file)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", field=str(path), code="UNKNOWN") from error
