"""One streamed computation: points and faces out in blocks, rows back in order."""

from __future__ import annotations

from typing import Any, Iterator

from .connection import Connection
from .errors import BarycastError, translated
from .exchange import Exchange
from .rows import Rows


class Computation(Exchange):
    """Iterate it to receive the rows (`Rows`), in order and without gaps.

    header is there from the first block on, summary after the last one. The cage is named by its digest; a server
    that does not hold it gets an upload, and if it (or another replica) then still does not, the cage itself in the
    request. After a lost connection it goes on from the next row. Iterating throws InputError and ServerError; leaving
    the loop cancels the computation.
    """

    def __init__(self, connection: Connection, *arguments: Any, **more: Any) -> None:
        super().__init__(connection.memory, *arguments, **more)
        self._connection = connection

    def __iter__(self) -> Iterator[Rows]:
        self.begin()
        while True:
            call: Any = None
            try:
                call = self._connection.run(self.open())
                with translated():
                    for response in call:
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
            self._connection.run(self.failed(failure))
