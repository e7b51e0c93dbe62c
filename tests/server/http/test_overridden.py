"""What `server.http` and `server.service.run` override or read inside uvicorn and websockets is still there.

`pyproject.toml` holds both libraries below the next minor or major version. Whoever raises a bound and sees one of
these tests fail has to read the new base class, mend the override that is named, and only then the table here.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import uvicorn
from packaging.requirements import Requirement
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import Protocol
from websockets.server import ServerProtocol

from streamlod.server.http.limits import LimitedProtocol
from streamlod.server.http.websocket import ViewerProtocol
from streamlod.server.service.run import Server

WEBSOCKET = """connection_made(transport) data_received(data) handle_text(event) handle_cont(event) handle_ping()
    pause_writing() resume_writing() connection_lost(exc) handle_close(event) shutdown() handle_parser_exception()
    run_asgi() send(message)"""
HTTP = """connection_made(transport) data_received(data) on_message_begin() on_headers_complete() on_body(body)
    on_message_complete() resume_writing() handle_websocket_upgrade() connection_lost(exc) on_header(name,value)
    on_url(url) send_400_response(msg)"""
SERVER = "__init__(config) startup(sockets) shutdown(sockets) handle_exit(sig,frame)"
OVERRIDDEN = [
    (ViewerProtocol, WebSocketsSansIOProtocol, WEBSOCKET),
    (LimitedProtocol, HttpToolsProtocol, HTTP),
    (Server, uvicorn.Server, SERVER),
]
ATTRIBUTES = [
    (WebSocketsSansIOProtocol, "close_sent close_timeout conn disconnected frames handshake_complete loop scope"),
    (WebSocketsSansIOProtocol, "handshake_initiated transport writable"),
    (HttpToolsProtocol, "connections loop pipeline transport"),
    (Protocol, "close_sent max_message_size"),
]


def written(cls: type, name: str) -> str:
    """A method with its parameters, as in the tables above."""
    parameters = list(inspect.signature(getattr(cls, name)).parameters)[1:]
    return f"{name}({','.join(parameters)})"


@pytest.mark.parametrize(("ours", "base", "table"), OVERRIDDEN, ids=lambda value: getattr(value, "__name__", ""))
def test_overridden_methods_have_their_names_and_parameters(ours: type, base: type, table: str) -> None:
    for method in table.split():
        name = method.partition("(")[0]
        assert name in vars(base), f"{base.__name__} has no {name} any more, which {ours.__name__} overrides"
        assert written(base, name) == method, f"{ours.__name__}.{name} overrides another signature"
    overriding = {name for name, value in vars(ours).items() if callable(value) and hasattr(base, name)}
    assert overriding == {method.partition("(")[0] for method in table.split()}, "the table lacks an override"


@pytest.mark.parametrize(("base", "names"), ATTRIBUTES, ids=lambda value: getattr(value, "__name__", ""))
def test_attributes_that_are_read_exist(base: type, names: str) -> None:
    source = inspect.getsource(base)
    for name in names.split():
        assigned = re.search(rf"^ +(self\.\w+, )*self\.{name}\b[^=\n]*=", source, re.MULTILINE)
        assert assigned or hasattr(base, name), f"{base.__name__}.{name} is gone"


def test_calls_into_websockets_exist() -> None:
    assert written(ServerProtocol, "send_close") == "send_close(code,reason)"
    assert written(ServerProtocol, "data_to_send") == "data_to_send()"


@pytest.mark.parametrize("library", ["uvicorn", "websockets"])
def test_the_libraries_have_an_upper_bound_that_holds_the_installed_one(library: str) -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    lines = project["dependencies"] + project["optional-dependencies"]["serve"]
    (wanted,) = [found for line in lines if (found := Requirement(line)).name == library]
    assert "<" in {part.operator for part in wanted.specifier}, f"{library} needs an upper bound"
    assert wanted.specifier.contains(version(library)), f"{library} {version(library)} is not what was checked"
