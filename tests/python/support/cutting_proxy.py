"""A TCP proxy that cuts connections: what a lost network, a killed replica or an impatient balancer does."""

from __future__ import annotations

import socket
import struct
import threading
import time
from typing import List

_PIECE = 16384
# Before a cut: a reset throws away what a busy receiver has not read yet, and then nothing got through.
_READ_SECONDS = 0.1


class CuttingProxy:
    """Forwards to a port on loopback. cuts: of the next connections, how many of the server's bytes get through before
    both ends are reset; after the last, everything. `address` is where to connect, `connections` how many came."""

    def __init__(self, port: int, cuts: List[int]) -> None:
        self.cuts = list(cuts)
        self.connections = 0
        self._port = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: List[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> CuttingProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for each in self._open:
            each.close()

    def _accept(self) -> None:
        while True:
            try:
                client = self._listener.accept()[0]
            except OSError:
                return
            self.connections += 1
            server = socket.create_connection(("127.0.0.1", self._port))
            self._open += [client, server]
            limit = self.cuts.pop(0) if self.cuts else None
            threading.Thread(target=self._forward, args=(client, server, None), daemon=True).start()
            threading.Thread(target=self._forward, args=(server, client, limit), daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket, limit) -> None:
        passed = 0
        try:
            while limit is None or passed < limit:
                data = source.recv(_PIECE if limit is None else min(_PIECE, limit - passed))
                if not data:
                    break
                target.sendall(data)
                passed += len(data)
        except OSError:
            pass
        if limit is not None:
            time.sleep(_READ_SECONDS)
        for end in (source, target):
            try:
                if limit is not None:  # a reset, not an orderly end
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                end.shutdown(socket.SHUT_RDWR)
                if limit is not None:
                    end.close()
            except OSError:
                pass
