"""What can go wrong, as exceptions with a code, the path of the field at fault, and one sentence.

`InputError` means that the same request would be refused again: change the input. `ServerError` means
that the input may be fine: the server is away, busy, or broke. `MissingCageError` is answered inside the
client by an upload.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator, Optional

import grpc

from . import rpc_details

# Refused whatever the server's load: changing the input helps, waiting does not.
_INPUT_CODES = ("INVALID_ARGUMENT", "OUT_OF_RANGE", "UNIMPLEMENTED")


# What gRPC says when there was no connection at all.
_NOBODY_THERE = ("failed to connect", "DNS resolution failed")
# What gRPC says when a stream broke off, and with which codes: a proxy lost the server behind it, or let a refusal pass
# and then reset the stream, because the client was still sending.
_STREAM_LOST = ("Stream removed", "RST_STREAM")
_STREAM_LOST_CODES = ("UNKNOWN", "INTERNAL", "CANCELLED")
_CODE_NAMES = {code.value[0]: code.name for code in grpc.StatusCode}


class BarycastError(Exception):
    """Base of all errors of this package.

    code: name of the gRPC status ("INVALID_ARGUMENT"), also for errors found before anything was sent.
    field: path of the field at fault ("cage.quads[12].vertex[3]"), a file with its line, or "".
    message: one sentence without the field.
    """

    def __init__(self, message: str, *, code: str, field: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.field = field
        self.message = message

    def __str__(self) -> str:
        if not self.field or self.message.startswith(self.field):
            return self.message
        return f"{self.field}: {self.message}"


class InputError(BarycastError):
    """The cage, the points, an option or a file cannot be used as they are."""

    def __init__(self, message: str, *, field: str = "", code: str = "INVALID_ARGUMENT") -> None:
        super().__init__(message, code=code, field=field)


class MissingCageError(BarycastError):
    """The server does not hold the cage that the request named by its digest."""

    def __init__(self, message: str, *, field: str = "", code: str = "FAILED_PRECONDITION") -> None:
        super().__init__(message, code=code, field=field)


class ServerError(BarycastError):
    """No server, a busy server, a deadline, or a fault of the server.

    retry_seconds: how long the server asks to wait before the next attempt; None where it did not say.
    """

    def __init__(self, message: str, *, code: str, field: str = "", retry_seconds: Optional[float] = None) -> None:
        super().__init__(message, code=code, field=field)
        self.retry_seconds = retry_seconds


def from_rpc_error(error: grpc.RpcError) -> BarycastError:
    """The exception for a failed call; reads the google.rpc details when the server sent them."""
    code = error.code().name
    details = rpc_details.decode(error.trailing_metadata() or ())
    message = error.details() or code.replace("_", " ").lower()
    if code == "UNAVAILABLE" and any(words in message for words in _NOBODY_THERE):
        message = f"no server answers at that address; is barycastd running, and the address right? ({message})"
    if code in _STREAM_LOST_CODES and any(words in message for words in _STREAM_LOST):
        if details.code in _CODE_NAMES and details.code != 0:
            code, message = _CODE_NAMES[details.code], details.message
        else:
            code, message = "UNAVAILABLE", f"the connection was lost ({message})"
    if details.missing:
        return MissingCageError(message, field="cage_digest", code=code)
    if details.field:
        message = details.description or message
    over_limit = code == "RESOURCE_EXHAUSTED" and details.retry_seconds is None
    if code in _INPUT_CODES or over_limit:
        return InputError(message, field=details.field, code=code)
    return ServerError(message, code=code, field=details.field, retry_seconds=details.retry_seconds)


@contextmanager
def translated() -> Iterator[None]:
    """Inside this context a grpc.RpcError leaves as a BarycastError."""
    try:
        yield
    except grpc.RpcError as error:
        raise from_rpc_error(error) from error
