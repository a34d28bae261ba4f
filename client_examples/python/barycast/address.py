"""What the address of a server looks like."""

from __future__ import annotations

import re

from .errors import InputError

_HOST_PORT = re.compile(r"(?:[^/\s:]+|\[[^/\s]*\]|%5B[^/\s]*%5D):([0-9]{1,5})")
_PORT_MAX = 65535


def check_address(address: str) -> str:
    """The address, if a server can have it: "host:port" or "[::1]:port" with a port from 1 to 65535, "unix:/path", or
    the gRPC schemes dns, ipv4 and ipv6 with ports, unix-abstract, vsock and xds. gRPC itself would take a missing port
    for 443 and retry what it cannot read. Throws InputError."""
    if isinstance(address, str) and _is_address(address):
        return address
    raise InputError(f'"{address}" is no address; give HOST:PORT or [::1]:PORT with a port from 1 to 65535, unix:PATH, '
                     "or dns:///HOST:PORT", field="server")


def _is_address(address: str) -> bool:
    scheme, colon, rest = address.partition(":")
    if scheme in ("unix", "unix-abstract", "vsock", "xds") and colon:
        return bool(rest)
    if scheme in ("dns", "ipv4", "ipv6"):
        if rest.startswith("//"):  # an authority
            rest = rest[2:].partition("/")[2]
        return all(map(_is_host_port, [rest] if scheme == "dns" else rest.split(",")))
    return _is_host_port(address)


def _is_host_port(text: str) -> bool:
    found = _HOST_PORT.fullmatch(text)
    return found is not None and 1 <= int(found.group(1)) <= _PORT_MAX
