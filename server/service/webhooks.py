"""Webhooks: events as signed POST requests, tried again a few times, and never into networks that are not listed.

Signed as in Standard Webhooks (standardwebhooks.com): HMAC-SHA256 over id, time and body.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import socket
import time
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from streamlod.server.auth.secret_file import read_secret
from streamlod.server.http.networks import is_reachable
from streamlod.server.settings import Settings, Webhook
from streamlod.server.stream.feed import Feed, ServerEvent

if TYPE_CHECKING:
    import httpx

_LOG = logging.getLogger(__name__)
RETRY_SECONDS = (1.0, 5.0, 30.0, 120.0, 600.0)  # pauses after attempts that failed; then an event is given up
_ANSWER_SECONDS = 10.0
_MAX_WAITING = 1000  # events of one webhook; the oldest are given up first


@dataclass(frozen=True, slots=True, eq=False)
class _Hook:
    """One webhook, its secret, and the events that wait for it."""

    webhook: Webhook
    key: bytes
    waiting: asyncio.Queue[ServerEvent]

    def take(self, event: ServerEvent) -> None:
        """Let an event wait, if it is one that the webhook asks for."""
        if not fnmatchcase(event.stream, self.webhook.streams):
            return
        if any(fnmatchcase(event.type, pattern) for pattern in self.webhook.events):
            if self.waiting.full():
                self.waiting.get_nowait()
                _LOG.warning("webhook %s is too slow; an event is given up", self.webhook.url)
            self.waiting.put_nowait(event)


class Webhooks:
    """Delivers the feed's events to the webhooks of the settings, which may change while it runs.

    Args:
        feed: of the server.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._hooks: dict[_Hook, asyncio.Task[None]] = {}

    def use(self, settings: Settings) -> None:
        """Deliver to the webhooks of these settings from now on; one that stays keeps the events that wait for it.

        Raises:
            InputError: a secret cannot be used; nothing has changed.
        """
        wanted = [(each, read_secret(each.key)) for each in settings.webhooks]
        known = {(hook.webhook, hook.key): hook for hook in self._hooks}
        for identity in known.keys() - set(wanted):
            self._feed.listeners.discard(known[identity].take)
            self._hooks.pop(known[identity]).cancel()
        for webhook, key in dict.fromkeys(wanted):
            if (webhook, key) not in known:
                hook = _Hook(webhook, key, asyncio.Queue(_MAX_WAITING))
                self._feed.listeners.add(hook.take)
                self._hooks[hook] = asyncio.create_task(_deliver_all(hook, settings.networks))

    async def close(self) -> None:
        """Deliver no more."""
        tasks = list(self._hooks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def signature(key: bytes, identifier: str, seconds: int, body: bytes) -> str:
    """The header `webhook-signature`."""
    signed = hmac.new(key, f"{identifier}.{seconds}.".encode() + body, hashlib.sha256).digest()
    return f"v1,{base64.b64encode(signed).decode()}"


async def _deliver_all(hook: _Hook, networks: tuple[str, ...]) -> None:
    import httpx

    limits = httpx.Limits(max_connections=1)
    async with httpx.AsyncClient(timeout=_ANSWER_SECONDS, trust_env=False, limits=limits) as client:
        while True:
            event = await hook.waiting.get()
            for pause in (*RETRY_SECONDS, None):
                fault = await _deliver(client, hook, event, networks)
                if fault is None:
                    break
                then = "it is given up" if pause is None else f"it is sent again in {pause:g} s"
                _LOG.warning("webhook %s: %s is not delivered (%s); %s", hook.webhook.url, event.id, fault, then)
                if pause is not None:
                    await asyncio.sleep(pause)


async def _deliver(client: httpx.AsyncClient, hook: _Hook, event: ServerEvent, networks: tuple[str, ...]) -> str | None:
    """One attempt: what was wrong, or None."""
    import httpx

    parts = urlsplit(hook.webhook.url)
    host = parts.hostname or ""
    address = await _address(host, parts.port or (443 if parts.scheme == "https" else 80), networks)
    if address is None:
        return "it leads to no address, or to one that is not in the setting `networks`"
    body, seconds = json.dumps(event.to_json()).encode(), int(time.time())
    headers = {
        "Host": parts.netloc,
        "Content-Type": "application/json",
        "webhook-id": event.id,
        "webhook-timestamp": str(seconds),
        "webhook-signature": signature(hook.key, event.id, seconds, body),
    }
    try:
        # to the address that was checked, whatever the name leads to by then
        url = httpx.URL(hook.webhook.url).copy_with(host=address)
        request = client.build_request("POST", url, content=body, headers=headers, extensions={"sni_hostname": host})
        answer = await client.send(request, stream=True)  # redirections are not followed, bodies not read
        await answer.aclose()
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        return str(error) or type(error).__name__
    return None if answer.is_success else f"answered {answer.status_code}"


async def _address(host: str, port: int, networks: tuple[str, ...]) -> str | None:
    """The address that a name leads to, where all that it leads to may be reached."""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:
        return None
    addresses = [str(each[4][0]) for each in found]
    allowed = host in networks or all(is_reachable(address, networks) for address in addresses)
    return addresses[0] if addresses and allowed else None
