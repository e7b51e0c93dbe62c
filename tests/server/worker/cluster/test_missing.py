"""A server whose streams are to be trained on a Ray cluster, where Ray is not installed or does not run."""

from __future__ import annotations

import subprocess
import sys

import pytest

from core.errors import InputError
from server.settings import RaySettings, Settings

WITHOUT_RAY = """
import sys
sys.modules["ray"] = None
from core.errors import BackendUnavailable
from server.service.app import create_app
from server.settings import Settings
create_app(Settings())
try:
    create_app(Settings(jobs="ray"))
except BackendUnavailable as error:
    print(error)
"""
WITH_RAY = """
import sys
from server.service.app import create_app
from server.settings import Settings
create_app(Settings(jobs="ray"))
print(*[name for name in sys.modules if name.split(".")[0] == "ray"])
"""


def output_of(code: str) -> str:
    """What Python prints, in a process of its own: packages of this one that were loaded keep their modules."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_it_says_what_to_install_and_without_the_setting_nothing_of_it_is_needed() -> None:
    assert "streamlod[ray]" in output_of(WITHOUT_RAY)


def test_a_server_loads_nothing_of_it_itself() -> None:
    pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")
    assert output_of(WITH_RAY).split() == []


def test_a_worker_takes_part_of_one_gpu_or_whole_ones() -> None:
    Settings(jobs="ray", ray=RaySettings(gpus=0.25)).check()
    Settings(jobs="ray", ray=RaySettings(gpus=2)).check()
    with pytest.raises(InputError, match="part of one GPU"):
        Settings(jobs="ray", ray=RaySettings(gpus=1.5)).check()
