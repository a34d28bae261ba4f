"""The verbs as flows: generators that say what to do next and are told the outcome, so that the logic is written
once and a blocking and an asynchronous client run the same. A flow yields a `Call` or a `Pause`, is sent the answer
(or thrown the BarycastError of a failed call), and returns its result.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Callable, Generator, Iterator, Optional, TypeVar, Union

from barycast.v1 import barycast_pb2

from .cage import Cage
from .errors import BarycastError, InputError, MissingCageError, ServerError
from .requests import CageNaming, Metadata, digest_metadata, upload_pieces
from .retry import Retry

T = TypeVar("T")


@dataclass(frozen=True)
class Call:
    """Call a method of the service. request: a message, or an iterator of messages. The outcome is the answer, or,
    where answers are streamed, the call, to iterate."""

    method: str
    request: Any
    timeout: Optional[float]
    metadata: Metadata = ()


@dataclass(frozen=True)
class Pause:
    """Wait, and start the private server again if it ended. The outcome is None."""

    seconds: float


Flow = Generator[Union[Call, Pause], Any, T]


@dataclass
class Memory:
    """What is known of the server; forgotten when the connection is lost. answered: it has said anything since, so
    that while a call goes on, False says that the client waits for a server."""

    capabilities: Optional[barycast_pb2.GetCapabilitiesResponse] = None
    answered: bool = False

    def forget(self) -> None:
        """Another server may answer next, or the same one later."""
        self.capabilities, self.answered = None, False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Around a call: it was answered, with whatever, unless nobody was there."""
        try:
            yield
        except BarycastError as error:
            self.answered = error.code != "UNAVAILABLE"
            raise
        self.answered = True


def retried(retry: Retry, attempt: Callable[[], Flow[T]]) -> Flow[T]:
    """The result of attempt, again after lost connections and busy answers."""
    while True:
        try:
            return (yield from attempt())
        except ServerError as error:
            wait = retry.wait_after(error)
        yield Pause(wait)


def capabilities(memory: Memory, retry: Retry) -> Flow[barycast_pb2.GetCapabilitiesResponse]:
    """Asked once per connection."""
    if memory.capabilities is None:
        memory.capabilities = yield Call("GetCapabilities", barycast_pb2.GetCapabilitiesRequest(), retry.timeout())
    return memory.capabilities


def upload(cage: Cage, retry: Retry, fill_tables: bool = False) -> Flow[barycast_pb2.UploadCageResponse]:
    """Sends the cage in pieces."""
    response: barycast_pb2.UploadCageResponse = yield Call("UploadCage", upload_pieces(cage, fill_tables),
                                                           retry.timeout(), digest_metadata(cage))
    return response


def estimate(cage: Cage, request: barycast_pb2.EstimateCostRequest, retry: Retry
             ) -> Flow[barycast_pb2.EstimateCostResponse]:
    """Asks what the request would cost; it names the cage here. Throws InputError also when the server cannot tell."""
    naming = CageNaming(cage)
    while True:
        if naming.uploads:
            yield from upload(cage, retry)
        named = barycast_pb2.EstimateCostRequest()
        named.CopyFrom(request)
        naming.name(named)
        try:
            response: barycast_pb2.EstimateCostResponse = yield Call("EstimateCost", named, retry.timeout(),
                                                                     digest_metadata(cage))
            return response
        except MissingCageError as error:
            naming.missing(error)
        except InputError as error:
            if error.code == "UNIMPLEMENTED" and not error.field:
                raise InputError("this server does not estimate costs", code=error.code) from error
            raise
