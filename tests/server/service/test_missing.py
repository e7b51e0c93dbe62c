"""A server whose optional packages are not installed: needed by the setting that asks for them, and by nothing else."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import pytest

CODE = """
import sys
hidden = ("nats", "ray", "opentelemetry.sdk", "opentelemetry.exporter")  # FastAPI may need the rest of the last
sys.modules.update(dict.fromkeys(hidden))
from streamlod.core.errors import BackendUnavailable
from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings
create_app(Settings())
for asking in ({"bus": "jetstream"}, {"jobs": "ray"}, {"trace_endpoint": "http://127.0.0.1:4318"}):
    try:
        create_app(Settings(**asking))
    except BackendUnavailable as error:
        print(error)
del sys.modules["ray"]
if len(sys.argv) > 1:
    create_app(Settings(jobs="ray"))
    print(*[name for name in sys.modules if name.split(".")[0] == "ray"])
"""


@pytest.mark.long
def test_a_server_says_what_to_install_and_loads_nothing_of_ray_itself() -> None:
    """In a process of its own: packages of this one that were loaded keep their modules."""
    command = [sys.executable, "-c", CODE, *(["with ray"] if find_spec("ray") else [])]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    for line, extra in zip(told[:3], ("jetstream", "ray", "trace"), strict=True):
        assert f"streamlod[{extra}]" in line
    assert told[3:] == ([""] if find_spec("ray") else [])
