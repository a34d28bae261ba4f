"""The transport for asyncio: a channel, runs of flows over it, and one streamed computation."""

from __future__ import annotations

import asyncio
from typing import Any, AsyncIterator, Optional, TypeVar

import grpc

from barycast.v1 import barycast_pb2_grpc

from .connection import CHANNEL_OPTIONS, Endpoint
from .errors import BarycastError, translated
from .exchange import Exchange
from .flows import Call, Flow, Memory, Pause
from .local_server import LocalServer
from .rows import Rows

T = TypeVar("T")


class AsyncConnection:
    """A channel to one server, made when it is first used; it reconnects by itself."""

    def __init__(self, address: Optional[str], threads: Optional[int]) -> None:
        self.memory = Memory()
        self._endpoint = Endpoint(address, threads)
        self._channel: Optional[grpc.aio.Channel] = None
        self._stub: Any = None
        self._starting: Optional[asyncio.Lock] = None

    @property
    def local(self) -> Optional[LocalServer]:
        """The private server; None before the first use, or where an address was given."""
        return self._endpoint.local

    async def _ready(self, look: bool) -> None:
        """A channel to a server that was started. look: whether the private server may have ended."""
        if self._channel is not None and not look:
            return
        if self._starting is None:  # made here, where there is an event loop
            self._starting = asyncio.Lock()
        async with self._starting:  # many calls, one private server
            started = await asyncio.get_running_loop().run_in_executor(None, self._endpoint.start)
            if self._channel is None or started:
                await self._close_channel()
                self._channel = grpc.aio.insecure_channel(self._endpoint.address, options=CHANNEL_OPTIONS)
                self._stub = barycast_pb2_grpc.BarycastServiceStub(self._channel)  # type: ignore[no-untyped-call]

    async def _close_channel(self) -> None:
        channel, self._channel = self._channel, None
        if channel is not None:
            await channel.close()

    async def close(self) -> None:
        """Closes the channel and ends the private server. May be called again."""
        await self._close_channel()
        await asyncio.get_running_loop().run_in_executor(None, self._endpoint.close)

    async def run(self, flow: Flow[T]) -> T:
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
                    outcome = await self._call(step)
                else:
                    await self._pause(step)
            except BarycastError as failure:
                error = failure

    async def _call(self, call: Call) -> Any:
        await self._ready(look=False)
        with self.memory.listening(), translated():
            begun = getattr(self._stub, call.method)(call.request, timeout=call.timeout, metadata=call.metadata)
            # Streamed answers are iterated by the caller; a single one is awaited here.
            return begun if hasattr(begun, "__aiter__") else await begun

    async def _pause(self, pause: Pause) -> None:
        self.memory.forget()
        await asyncio.sleep(pause.seconds)
        await self._ready(look=True)


class AsyncComputation(Exchange):
    """`Computation`, iterated with `async for`."""

    def __init__(self, connection: AsyncConnection, *arguments: Any, **more: Any) -> None:
        super().__init__(connection.memory, *arguments, **more)
        self._connection = connection

    async def __aiter__(self) -> AsyncIterator[Rows]:
        self.begin()
        while True:
            call: Any = None
            try:
                call = await self._connection.run(self.open())
                with translated():
                    async for response in call:
                        rows = self.receive(response)
                        if rows is not None:
                            yield rows
                self.finish()
                return
            except BarycastError as error:
                failure = error
            finally:
                if call is not None:
                    call.cancel()
            await self._connection.run(self.failed(failure))
