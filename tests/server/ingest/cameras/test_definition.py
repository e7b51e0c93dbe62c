"""A rig's file: what is read, and what is refused, in one sentence each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.cameras.definition import read_definition
from streamlod.server.ingest.live import open_live
from tests.core.data.writers import picture, rig, write_transforms
from tests.server.ingest.rig import write_definition


def _changed(tmp_path: Path, change: dict[str, Any], camera: dict[str, Any]) -> Path:
    path = write_definition(tmp_path, ["rtsp://10.0.0.1/a", "push:"])
    file = json.loads(path.read_text()) | change
    if "cameras" not in change:
        file["cameras"][0] |= camera
        file["cameras"][0] = {name: value for name, value in file["cameras"][0].items() if value is not None}
    path.write_text(json.dumps(file))
    return path


def _scan(tmp_path: Path, names: list[str]) -> None:
    """A data set `scan` with a picture of each of these cameras."""
    cameras = rig(names)
    (tmp_path / "scan").mkdir()
    files = [f"{camera.name}.png" for camera in cameras]
    for row, file in enumerate(files):
        cv2.imwrite(str(tmp_path / "scan" / file), picture(row, 0))
    write_transforms(tmp_path / "scan", files, cameras)


def test_reads_cameras_sources_and_policy(tmp_path: Path) -> None:
    path = _changed(tmp_path, {"policy": {"quorum": 1}, "depth_bounds": [1, 9]}, {"distortion": [0.01, 0, 0, 0, 0]})
    definition = read_definition(path)
    assert [camera.name for camera in definition.cameras] == ["cam0", "cam1"]
    assert definition.quorum == 1
    assert [address.scheme for address in definition.addresses] == ["rtsp", "push"]
    assert definition.cameras[0].has_distortion
    dataset = open_live(path, downscale=2)
    assert not dataset.cameras[0].has_distortion
    assert (dataset.cameras[0].width, dataset.fps, dataset.depth_bounds) == (80, 30, (1, 9))


@pytest.mark.parametrize(
    ("change", "camera", "message"),
    [
        ({"fps": 0}, {}, "fps"),
        ({"fps": float("nan")}, {}, "fps"),
        ({"policy": "sometimes"}, {}, "policy"),
        ({"policy": {"quorum": 3}}, {}, "ask for fewer"),
        ({"colour": 1}, {}, "colour"),
        ({"cameras": []}, {}, "cameras"),
        ({"depth_bounds": [3, 1]}, {}, "nearer one first"),
        ({"realtime": False}, {}, "all sources are files"),
        ({"calibration": "nowhere"}, {}, "nowhere"),
        ({}, {"name": "cam1"}, "two cameras called cam1"),
        ({}, {"name": "../x"}, r"cameras\.0\.name: must be 1 to 64 letters, digits, .* not '\.\./x'"),
        ({"policy": "any"}, {}, r"policy: must be .require_all. or ..quorum.: N. with N of at least 1, not 'any'"),
        ({"policy": {"quorum": 0}}, {}, "policy: must be .* not {'quorum': 0}"),
        ({"realtime": "yes"}, {}, "realtime: must be true or false, not 'yes'"),
        ({}, {"width": None}, "needs width"),
        ({}, {"width": 10**9}, "width"),
        ({}, {"intrinsics": [[1, 0], [0, 1]]}, "intrinsics"),
        ({}, {"world_to_camera": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "rotation"),
        ({}, {"source": "gopher://x"}, "scheme"),
        ({}, {"source": "rtsp://"}, "no host"),
        ({}, {"source": "v4l2:///etc/passwd"}, "/dev/video0"),
        ({}, {"source": "udp+listen://a:1"}, "scheme"),
        ({}, {"source": "rtsp://a:99999/b"}, "URL"),
        ({}, {"source": ""}, "path"),
        ({}, {"source": "push:phone1"}, "says more than push:"),
        ({}, {"url": "rtsp://a/b"}, "url: is not known; leave it out"),
    ],
)
def test_refuses_in_one_sentence(tmp_path: Path, change: dict[str, Any], camera: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        read_definition(_changed(tmp_path, change, camera))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"fps": 30}', '"' + "x" * 2_000_000 + '"'])
def test_refuses_what_is_no_definition(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(text)
    with pytest.raises(InputError):
        read_definition(path)


def test_calibration_comes_from_a_data_set(tmp_path: Path) -> None:
    _scan(tmp_path, ["a", "b"])
    known = open_dataset(tmp_path / "scan").recording.cameras
    entries: list[dict[str, Any]] = [{"name": known[1].name, "source": "push:"}]
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"fps": 30, "calibration": "scan", "cameras": entries}))
    definition = read_definition(path)
    np.testing.assert_array_equal(definition.cameras[0].world_to_camera, known[1].world_to_camera)
    path.write_text(json.dumps({"fps": 30, "calibration": "scan", "cameras": [{"name": "zz", "source": "push:"}]}))
    with pytest.raises(InputError, match="not in the calibration"):
        read_definition(path)
    entries = [entries[0] | {"distortion": [0.1, 0, 0, 0, 0]}]
    path.write_text(json.dumps({"fps": 30, "calibration": "scan", "cameras": entries}))
    with pytest.raises(InputError, match="is described here and in the calibration; leave one out"):
        read_definition(path)


def test_a_rig_trains_in_the_space_of_its_calibration(tmp_path: Path) -> None:
    """As the data set itself does, whichever of its cameras are live; so `evaluate` finds the same places."""
    _scan(tmp_path, ["a", "b", "c"])
    path = tmp_path / "rig.json"
    entries = [{"name": name, "source": "push:"} for name in "ca"]
    path.write_text(json.dumps({"fps": 30, "calibration": "scan", "cameras": entries, "depth_bounds": [1, 9]}))
    dataset, live = open_dataset(tmp_path / "scan").normalised(), open_live(path).normalised()
    assert live.depth_bounds == dataset.space.depths((1, 9))
    assert live.depth_bounds == pytest.approx((dataset.space.scale, 9 * dataset.space.scale), abs=2**-20)
    for camera in live.select(["a"]).cameras:
        np.testing.assert_allclose(camera.world_to_camera, dataset.cameras[0].world_to_camera, atol=1e-12)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = write_definition(tmp_path, ["push:"])
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_definition(path).cameras) == 1


def test_addresses_let_no_playlist_reach_files() -> None:
    assert parse_address("http://a/b.m3u8").options["protocol_whitelist"] == "http,tcp"
    assert parse_address("/data/a.mp4").options["protocol_whitelist"] == "file"
    listening = parse_address("rtsp+listen://0.0.0.0:8554/cam0")
    assert (listening.url, listening.listens) == ("rtsp://0.0.0.0:8554/cam0", True)
