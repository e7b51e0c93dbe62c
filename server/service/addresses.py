"""The address at which a listening server is found: the one that its log, its QR codes and its certificate name."""

from __future__ import annotations

import socket

_ELSEWHERE = ("192.0.2.1", 9)  # an address of no machine (RFC 5737); nothing is sent to it


def found_at(listener: socket.socket, *, is_tls: bool) -> str:
    """The address of a server at a listening socket; where it listens at every address, that of `own_address`."""
    host, port = listener.getsockname()[:2]
    if is_everywhere(listener):
        host = own_address()
    return f"{'https' if is_tls else 'http'}://{f'[{host}]' if ':' in host else host}:{port}"


def is_everywhere(listener: socket.socket) -> bool:
    """Whether a socket listens at all addresses of this machine."""
    return listener.getsockname()[0] in ("0.0.0.0", "::")


def own_address() -> str:
    """The address of this machine in the network that leads elsewhere; that of loopback without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        try:
            place.connect(_ELSEWHERE)
        except OSError:
            return "127.0.0.1"
        found: str = place.getsockname()[0]
        return found
