"""The blocking transport: a channel, and runs of flows over it."""

from __future__ import annotations

import os
import time
from typing import Any, List, Optional, TypeVar

import grpc

from barycast.v1 import barycast_pb2_grpc

from .address import check_address
from .errors import BarycastError, translated
from .flows import Call, Flow, Memory, Pause
from .local_server import LocalServer

T = TypeVar("T")

CHANNEL_OPTIONS = (
    ("grpc.enable_http_proxy", 0),  # a farm's proxy is for the web, not for a service beside us
    ("grpc.max_receive_message_length", -1),  # blocks of rows are bounded by the server
    ("grpc.max_send_message_length", -1),  # blocks are cut to the server's limit
    ("grpc.use_local_subchannel_pool", 1),  # so that a channel made after a fork has connections of its own
    ("grpc.initial_reconnect_backoff_ms", 100),  # pauses between attempts are ours
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.keepalive_time_ms", 360_000),  # servers tolerate a ping every five minutes unless told otherwise
    ("grpc.keepalive_timeout_ms", 20_000),
)

# Channels that a fork left behind: closing one here would shut its parent's sockets.
_abandoned: List[object] = []


class Endpoint:
    """Where the server is: the given address, or a private local server, started by `start`. Throws InputError on an
    address that none can have."""

    def __init__(self, address: Optional[str], threads: Optional[int]) -> None:
        self._given = None if address is None else check_address(address)
        self._threads = threads
        self.local: Optional[LocalServer] = None

    @property
    def address(self) -> str:
        """What a channel takes; after `start`."""
        if self._given is not None:
            return self._given
        assert self.local is not None
        return self.local.address

    def start(self) -> bool:
        """Makes sure that the private server runs; returns whether it had to be started. Throws InputError,
        ServerError."""
        if self._given is not None or (self.local is not None and self.local.alive()):
            return False
        self.close()
        self.local = LocalServer(self._threads)
        return True

    def close(self) -> None:
        """Ends the private server, if this process started it."""
        if self.local is not None:
            self.local.close()


class Connection:
    """A channel to one server. It reconnects by itself; in a process that was forked it is made anew, and the
    parent's is left alone."""

    def __init__(self, address: Optional[str], threads: Optional[int]) -> None:
        self.memory = Memory()
        self._endpoint = Endpoint(address, threads)
        self._endpoint.start()
        self._open()

    @property
    def local(self) -> Optional[LocalServer]:
        """The private server, or None."""
        return self._endpoint.local

    def _open(self) -> None:
        self._pid = os.getpid()
        self._channel = grpc.insecure_channel(self._endpoint.address, options=CHANNEL_OPTIONS)
        self._stub: Any = barycast_pb2_grpc.BarycastServiceStub(self._channel)  # type: ignore[no-untyped-call]

    def _close_channel(self) -> None:
        if self._pid == os.getpid():
            self._channel.close()
        else:
            _abandoned.extend((self._channel, self._stub))

    def close(self) -> None:
        """Closes the channel and ends the private server. May be called again."""
        self._close_channel()
        self._endpoint.close()

    def run(self, flow: Flow[T]) -> T:
        """The flow's result. Throws what it throws."""
        outcome: Any = None
        error: Optional[BarycastError] = None
        while True:
            try:
                step = flow.send(outcome) if error is None else flow.throw(error)
            except StopIteration as stop:
                result: T = stop.value
                return result
            outcome, error = None, None
            try:
                if isinstance(step, Call):
                    outcome = self._call(step)
                else:
                    self._pause(step)
            except BarycastError as failure:
                error = failure

    def _call(self, call: Call) -> Any:
        if self._pid != os.getpid():
            self._close_channel()
            self._open()
        with self.memory.listening(), translated():
            return getattr(self._stub, call.method)(call.request, timeout=call.timeout, metadata=call.metadata)

    def _pause(self, pause: Pause) -> None:
        self.memory.forget()
        time.sleep(pause.seconds)
        if self._endpoint.start():
            self._close_channel()
            self._open()
