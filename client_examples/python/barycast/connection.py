"""One connection to one server: single attempts of the calls that everything else is made of."""

from __future__ import annotations

import random
import time
from typing import Callable, Iterator, Optional, TypeVar

import grpc

from barycast.v1 import barycast_pb2, barycast_pb2_grpc, cage_pb2

from .cage import Cage
from .errors import ServerError, translated
from .local_server import LocalServer

T = TypeVar("T")

_UPLOAD_PIECE_BYTES = 1 << 20
_CHANNEL_OPTIONS = (
    ("grpc.enable_http_proxy", 0),  # a farm's proxy is for the web, not for a service beside us
    ("grpc.max_receive_message_length", -1),  # blocks of rows are bounded by the server
    ("grpc.max_send_message_length", -1),  # blocks are cut to the server's limit
    ("grpc.use_local_subchannel_pool", 1),  # so that a new channel is a new connection
    ("grpc.keepalive_time_ms", 360_000),  # servers tolerate a ping every five minutes unless told otherwise
    ("grpc.keepalive_timeout_ms", 20_000),
)
_DELAYS_SECONDS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # about 6 s: a daemon that restarts
_RETRY_SECONDS_MAX = 30.0


class Backoff:
    """A bounded number of waits, each longer and jittered so that a farm's clients do not return together."""

    def __init__(self) -> None:
        self._delays = iter(_DELAYS_SECONDS)

    def wait(self, error: ServerError) -> bool:
        """Sleeps and returns True when another attempt makes sense: no connection, or a busy server that said when
        to come back (at most 30 s)."""
        if error.code != "UNAVAILABLE" and error.retry_seconds is None:
            return False
        delay = next(self._delays, None)
        if delay is None:
            return False
        time.sleep(max(delay * random.uniform(0.5, 1.0), min(error.retry_seconds or 0.0, _RETRY_SECONDS_MAX)))
        return True


class Connection:
    """A channel, and the private local server behind it when no address was given.

    `stub` is replaced by `reconnect`. The calls here are one attempt each; `retried` makes more.
    """

    def __init__(self, address: Optional[str], threads: Optional[int], timeout_seconds: Optional[float]) -> None:
        self.timeout_seconds = timeout_seconds
        self._threads = threads
        self._local = LocalServer(threads) if address is None else None
        self._address = self._local.address if self._local else address
        self._connect()

    def _connect(self) -> None:
        self._capabilities: Optional[barycast_pb2.GetCapabilitiesResponse] = None
        self._channel = grpc.insecure_channel(self._address, options=_CHANNEL_OPTIONS)
        self.stub = barycast_pb2_grpc.BarycastServiceStub(self._channel)

    @property
    def local(self) -> Optional[LocalServer]:
        """The private server, or None."""
        return self._local

    def reconnect(self) -> None:
        """Drops the connection and makes a new one; starts the private server again if it ended."""
        self._channel.close()
        if self._local and not self._local.alive():
            self._local.close()
            self._local = LocalServer(self._threads)
            self._address = self._local.address
        self._connect()

    def close(self) -> None:
        """Closes the channel and ends the private server. May be called again."""
        self._channel.close()
        if self._local:
            self._local.close()

    def retried(self, call: Callable[[], T]) -> T:
        """The result of call, again after lost connections and busy answers, a bounded number of times."""
        backoff = Backoff()
        while True:
            try:
                return call()
            except ServerError as error:
                if not backoff.wait(error):
                    raise
                self.reconnect()

    def capabilities(self) -> barycast_pb2.GetCapabilitiesResponse:
        """Asked once per connection. Throws ServerError."""
        if self._capabilities is None:
            with translated():
                self._capabilities = self.stub.GetCapabilities(barycast_pb2.GetCapabilitiesRequest(),
                                                               timeout=self.timeout_seconds)
        return self._capabilities

    def upload(self, cage: Cage) -> barycast_pb2.UploadCageResponse:
        """Sends the cage in pieces. Throws InputError, ServerError."""
        data = cage.to_message().SerializeToString()

        def pieces() -> Iterator[barycast_pb2.UploadCageRequest]:
            digest: Optional[cage_pb2.CageDigest] = cage.digest
            for begin in range(0, len(data), _UPLOAD_PIECE_BYTES):
                piece = data[begin:begin + _UPLOAD_PIECE_BYTES]
                yield barycast_pb2.UploadCageRequest(expected_digest=digest, piece=piece)
                digest = None

        with translated():
            return self.stub.UploadCage(pieces(), timeout=self.timeout_seconds, metadata=digest_metadata(cage))


def digest_metadata(cage: Cage) -> tuple[tuple[str, str], ...]:
    """The cage's name as plain metadata, so that a balancer can send a cage's requests to one replica."""
    return (("x-cage-digest", cage.digest.sha256.hex()),)
