"""What tokens with keys that nobody knows cost: our cache of a key set (`server.auth.keys`) against PyJWT's client.

    python -m tests.bench.key_set_bench [--tokens 20]

Prints how often a key server on loopback is asked, and how many bytes it sends, while so many tokens name keys that are
not in the set; and how long a token with a known key waits meanwhile. The key server is in order, or answers 503 after
half a second, or puts 32 MiB of blanks before the set.
"""

from __future__ import annotations

import argparse
import asyncio
import http.server
import json
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import jwt
from cryptography.hazmat.primitives.asymmetric import ed25519

from streamlod.server.auth.keys import TokenKeys
from streamlod.server.settings import Settings

_DELAY_SECONDS = 0.5
_BLANKS = 32 << 20


@dataclass
class KeyServer:
    """What the server does from now on, and what it was asked."""

    keys: bytes
    fault: str = ""
    requests: int = 0
    sent_bytes: int = 0


@contextmanager
def key_server(state: KeyServer) -> Iterator[str]:
    """Serve `state` on loopback; gives the address."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            state.requests += 1
            if state.fault:
                time.sleep(_DELAY_SECONDS)
            self.send_response(503 if state.fault == "503" else 200)
            self.end_headers()
            pieces = [b" " * (1 << 16)] * (_BLANKS >> 16) if state.fault == "blanks" else []
            with suppress(OSError):  # hung up on
                for piece in [*pieces, state.keys]:
                    self.wfile.write(piece)
                    state.sent_bytes += len(piece)

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/keys"
    server.shutdown()
    server.server_close()


def ours(address: str) -> Callable[[str], Any]:
    """Finds out whether a token is valid by `TokenKeys`."""
    keys = TokenKeys(Settings(jwks=address))
    keys.reload()
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, daemon=True).start()

    async def check(token: str) -> Any:
        await keys.refresh(token)
        return keys.claims(token)

    return lambda token: asyncio.run_coroutine_threadsafe(check(token), loop).result()


def theirs(address: str) -> Callable[[str], Any]:
    """The same by PyJWT's client, with the same times."""
    client = jwt.PyJWKClient(address, lifespan=600, timeout=5, cooldown_duration=30)

    def check(token: str) -> Any:
        with suppress(jwt.PyJWTError):
            key = client.get_signing_key_from_jwt(token)
            return jwt.decode(token, key.key, algorithms=["EdDSA"], audience="streamlod")
        return None

    return check


def measure(name: str, make: Callable[[str], Callable[[str], Any]], fault: str, tokens: int) -> None:
    private = ed25519.Ed25519PrivateKey.generate()
    public = json.loads(jwt.algorithms.OKPAlgorithm.to_jwk(private.public_key()))
    state = KeyServer(json.dumps({"keys": [{**public, "kid": "known"}]}).encode())
    claims = {"aud": "streamlod", "exp": int(time.time()) + 600}

    def token(key: str) -> str:
        return jwt.encode(claims, private, "EdDSA", headers={"kid": key})

    with key_server(state) as address, ThreadPoolExecutor(4) as pool:
        check, state.fault = make(address), fault
        unknown = [pool.submit(check, token(f"unknown {number}")) for number in range(tokens)]
        longest, failed = 0.0, 0
        while not all(each.done() for each in unknown):
            begin = time.monotonic()
            failed += check(token("known")) is None
            longest = max(longest, time.monotonic() - begin)
            time.sleep(0.01)
    told = f"{state.requests} requests, {state.sent_bytes / 2**20:.1f} MiB sent"
    print(f"{name}, key server {fault or 'in order'}: {told}; a known key waits up to {longest:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tokens", type=int, default=20)
    tokens = parser.parse_args().tokens
    for fault in ("", "503", "blanks"):
        for name, make in (("ours", ours), ("PyJWKClient", theirs)):
            measure(name, make, fault, tokens)


if __name__ == "__main__":
    main()
