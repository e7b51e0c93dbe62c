"""Where a server says that it is found."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from contextlib import closing

import pytest

from streamlod.server.service.addresses import found_at, own_address
from streamlod.server.service.run import bind


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_server_at_one_address_is_found_there(host: str) -> None:
    with closing(bind(host, 0)) as listener:
        port = listener.getsockname()[1]
        assert found_at(listener, is_tls=False) == f"http://{f'[{host}]' if ':' in host else host}:{port}"


def test_a_server_at_all_addresses_is_found_at_the_one_that_others_reach() -> None:
    with closing(bind("0.0.0.0", 0)) as listener:
        assert found_at(listener, is_tls=True) == f"https://{own_address()}:{listener.getsockname()[1]}"


@pytest.mark.long
def test_the_log_names_an_address_that_can_be_opened() -> None:
    """0.0.0.0 is none on another machine, where friends type what the log says."""
    command = [sys.executable, "-m", "streamlod.server.cli", "serve", "--host", "0.0.0.0", "--insecure", "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        try:
            line = next(line for line in server.stderr if "listening at" in line)
            found = re.search(r"listening at http://([\d.]+):(\d+) and all other addresses of this machine", line)
            assert found is not None, line
            assert found[1] == own_address()
            socket.create_connection((found[1], int(found[2])), 5).close()
        finally:
            server.kill()
