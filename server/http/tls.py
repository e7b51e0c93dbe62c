"""TLS in front of uvicorn's protocols: certificates that are renewed whole, and handshakes with a deadline and a limit.

The event loop's own TLS server would keep a connection whose handshake never ends for a minute, without counting it.
Here connections are accepted one by one, so that they are counted by their address before the handshake.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from weakref import WeakKeyDictionary

from streamlod.core.errors import InputError
from streamlod.server.settings import Limits

_LOG = logging.getLogger(__name__)
_PAUSE_SECONDS = 0.1  # after a connection that could not be accepted


class Certificates:
    """The server's certificate chain and key.

    Args:
        chain, key: PEM files.

    Attributes:
        context: for the next connection; those that are open keep theirs.

    Raises:
        InputError: the files cannot be used.
    """

    def __init__(self, chain: Path, key: Path) -> None:
        self._chain, self._key = chain, key
        self.reload()

    def reload(self) -> None:
        """Read the files again.

        Raises:
            InputError: they cannot be used, or do not belong together; the earlier ones stay.
        """
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(self._chain, self._key, password=_no_password)
        except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
            fault = f"cannot be used with {self._key} ({error}); both must be there and belong together"
            raise InputError(self._chain, fault) from error
        self.context = context


class Handshakes:
    """How many TLS handshakes are under way, by address.

    Args:
        limits: of the server.
        turned_away: counts handshakes that were too many or too slow, as `handshakes`.
    """

    def __init__(self, limits: Limits, turned_away: Counter[str]) -> None:
        self.limits, self._turned_away = limits, turned_away
        self._of_address: Counter[str] = Counter()

    def begin(self, address: str) -> bool:
        """Count one; returns whether there is room for it."""
        if self._of_address[address] >= self.limits.handshakes_per_address or self.total >= self.limits.connections:
            self.refuse()
            return False
        self._of_address[address] += 1
        return True

    def end(self, address: str) -> None:
        """Note that a handshake of `begin` is over."""
        self._of_address[address] -= 1
        if not self._of_address[address]:
            del self._of_address[address]

    def refuse(self) -> None:
        """Count a handshake that did not end well."""
        self._turned_away["handshakes"] += 1

    @property
    def total(self) -> int:
        """Number of handshakes of all addresses."""
        return self._of_address.total()


class TlsListener:
    """Accepts connections and hands them on once their handshake is over.

    Args:
        certificates: of the server.
        handshakes: counts them.
        make: makes the protocol that takes a connection.
    """

    def __init__(
        self, certificates: Certificates, handshakes: Handshakes, make: Callable[[], asyncio.Protocol]
    ) -> None:
        self._certificates, self._handshakes, self._make = certificates, handshakes, make
        self._shaking: set[asyncio.Task[None]] = set()
        self._open = WeakKeyDictionary[asyncio.Transport, socket.socket]()

    async def accept(self, listener: socket.socket) -> None:
        """Take connections from `listener` until cancelled."""
        loop = asyncio.get_running_loop()
        listener.setblocking(False)
        try:
            while True:
                try:
                    peer, place = await loop.sock_accept(listener)
                except OSError as error:  # no descriptor is left, or the peer has gone already
                    _LOG.warning("a connection cannot be accepted: %s", error)
                    await asyncio.sleep(_PAUSE_SECONDS)
                    continue
                address = str(place[0])
                if self._handshakes.begin(address):
                    task = loop.create_task(self._shake(peer, address))
                    self._shaking.add(task)
                    task.add_done_callback(self._shaking.discard)
                else:
                    peer.close()
        finally:
            for task in self._shaking:
                task.cancel()

    def cut_closed(self) -> None:
        """Cut connections that are closed, but whose peer has not said goodbye.

        `abort` of a transport does that too, but nothing once it was closed twice.
        """
        for transport, peer in self._open.items():
            if transport.is_closing():
                with suppress(OSError):  # it has ended meanwhile
                    peer.shutdown(socket.SHUT_RDWR)

    async def _shake(self, peer: socket.socket, address: str) -> None:
        context, seconds = self._certificates.context, self._handshakes.limits.request_seconds
        try:
            loop = asyncio.get_running_loop()
            made = await loop.connect_accepted_socket(self._make, peer, ssl=context, ssl_handshake_timeout=seconds)
            self._open[made[0]] = peer
        except (OSError, ValueError):  # also of TLS, and for lack of time
            self._handshakes.refuse()
        finally:
            self._handshakes.end(address)


def _no_password() -> str:
    """Refuse an encrypted key: OpenSSL would ask for its password at the terminal and wait."""
    raise ValueError("the key is encrypted")
