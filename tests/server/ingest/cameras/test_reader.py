"""What a reader tells about a camera before its first picture."""

from __future__ import annotations

import socket
import time

from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.cameras.reader import Reader
from streamlod.server.ingest.sync.timeline import Timeline
from tests.attack.test_http_cameras import Faults
from tests.server.ports import free_ports


def test_a_reader_that_listens_says_so_as_soon_as_cameras_may_connect() -> None:
    (port,) = free_ports(1)
    sink = Faults()
    address = parse_address(f"tcp+listen://127.0.0.1:{port}")
    reader = Reader("cam0", address, (64, 48), 10.0, sink, Timeline(), anchor_ns=0)
    reader.start()
    limit = time.monotonic() + 60
    while not sink.reasons:
        assert time.monotonic() < limit
        time.sleep(0.005)
    assert sink.reasons[0].startswith("listening")
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            break
        except ConnectionRefusedError:
            assert time.monotonic() < limit
            time.sleep(0.02)
    reader.stop()
    reader.join(60)
