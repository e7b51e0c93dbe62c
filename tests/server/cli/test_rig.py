"""`streamlod rig`: the file of a rig, and what its cameras see."""

from __future__ import annotations

import json
import re
import socket
import ssl
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
import pytest
from typer.testing import CliRunner
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from streamlod.core.errors import InputError
from streamlod.server.auth.gate import hash_token
from streamlod.server.cli import rig as rig_command
from streamlod.server.cli.check import check
from streamlod.server.cli.main import app
from streamlod.server.cli.rig import find, phones_socket, watch
from streamlod.server.ingest import recording
from streamlod.server.ingest.cameras.definition import read_definition, read_uncalibrated
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL
from streamlod.server.ingest.statistics import trouble_of
from streamlod.server.service.station import station
from streamlod.server.settings import Settings, load_settings
from tests.core.data.writers import write_video
from tests.server.cli.filming import FPS, film, found, write_still
from tests.server.ingest.rig import HEIGHT, WIDTH, burnt, number_of, write_definition
from tests.waiting import wait


@pytest.mark.parametrize(("phones", "quorum"), [(3, 3), (4, 3)])
def test_a_stream_of_four_cameras_goes_on_without_one(tmp_path: Path, phones: int, quorum: int) -> None:
    found(tmp_path, phones=phones)
    policy = json.loads((tmp_path / "rig.json").read_text()).get("policy", "require_all")
    assert read_definition(write_definition(tmp_path, ["push:"] * phones, policy)).quorum == quorum


def test_the_file_names_what_gives_pictures_with_its_size(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(8)])
    video = str(tmp_path / "a.mp4")
    said = found(tmp_path, f"door={video}", video, "rtsp://me:secret@127.0.0.1:1/main", phones=1)
    rig = json.loads((tmp_path / "rig.json").read_text())
    sized = {"width": WIDTH, "height": HEIGHT}
    assert rig == {
        "fps": FPS,
        "calibration": "walk",
        "cameras": [
            {"name": "door", "source": video, **sized},
            {"name": "cam2", "source": video, **sized},
            {"name": "phone1", "source": "push:", **sized},
        ],
    }
    assert any("cam3" in line and "left out" in line for line in said)
    assert "secret" not in "".join(said)
    sheet = cv2.imread(str(tmp_path / "rig.jpg"))
    assert sheet is not None
    assert sheet.shape == (2 * 388, 2 * 480, 3)
    settings = load_settings(tmp_path / "rig.toml")
    assert settings.state == tmp_path / "evenings"
    assert settings.retention.seconds > 24 * 3600, "an evening is kept for longer than an hour"
    assert settings.certificate is not None
    assert settings.certificate_key is not None
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(settings.certificate, settings.certificate_key)
    assert settings.certificate_key.stat().st_mode & 0o077 == 0
    assert settings.link_key is not None
    assert settings.link_key.stat().st_mode & 0o077 == 0


@pytest.mark.long
def test_a_rig_is_as_fast_as_its_slowest_camera(tmp_path: Path) -> None:
    """At twice its rate, pictures of two such cameras would fall on instants in turns, and none have both."""
    pictures = [burnt(number) for number in range(8)]
    for name, fps in (("a", 30), ("b", 15)):
        write_video(tmp_path / f"{name}.mp4", pictures, fps)
    said: list[str] = []
    sources = [str(tmp_path / "a.mp4"), str(tmp_path / "b.mp4")]
    find(sources, tmp_path / "rig.json", 0, None, None, said.append, overwrite=False)
    assert json.loads((tmp_path / "rig.json").read_text())["fps"] == 15
    assert "they film at 15 to 30 pictures a second: set them to one rate" in said
    find([], tmp_path / "phones.json", 2, None, None, said.append, overwrite=False)
    assert json.loads((tmp_path / "phones.json").read_text())["fps"] == 30


@pytest.mark.long
@pytest.mark.parametrize("sound", ["phone1", "alsa:///default", "music.wav"])
def test_the_file_names_whose_sound_is_heard(tmp_path: Path, sound: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "music.wav").touch()
    (tmp_path / "rigs").mkdir()
    found(tmp_path / "rigs", phones=1, sound=sound)
    heard = json.loads((tmp_path / "rigs" / "rig.json").read_text())["sound"]
    assert heard == (str(tmp_path / sound) if sound.endswith(".wav") else sound)


@pytest.mark.long
def test_sound_of_nobody_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sound of 'phone2', which is neither a camera \(phone1\) nor a file"):
        found(tmp_path, phones=1, sound="phone2")
    assert not (tmp_path / "rig.json").exists()


def test_what_cannot_be_a_rig_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text("{}")
    with pytest.raises(InputError, match="exists"):
        found(tmp_path, "a.mp4")
    for sources, fault in (
        (["a=x.mp4", "a=y.mp4"], "named twice"),
        (["push:"], "--phones"),
        (["gopher://x"], "unknown scheme"),
        ([str(tmp_path / "missing.mp4")], "none of its cameras"),
    ):
        with pytest.raises(InputError, match=fault):
            found(tmp_path, *sources, overwrite=True)
    assert (tmp_path / "rig.json").read_text() == "{}"


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["--login", "film"], "write USER:PASSWORD"),
        (["--login", "film:x", "a.mp4"], "write rtsp://USER:PASSWORD@"),
        (["earlier.json", "--phones", "2"], "--phones: is for a new rig; change earlier.json"),
        (["earlier.json", "--size", "640x480"], "--size: is for a new rig"),
        (["earlier.json", "--fps", "15"], "--fps: is for a new rig"),
        (["a.mp4", "--seconds", "5"], "--seconds: is for a rig.json that is shown or recorded"),
    ],
)
def test_options_that_would_do_nothing_are_refused(tmp_path: Path, arguments: list[str], fault: str) -> None:
    refused = CliRunner().invoke(app, ["rig", "--out", str(tmp_path / "rig.json"), *arguments])
    assert isinstance(refused.exception, InputError)
    assert fault in str(refused.exception)


@pytest.mark.long
def test_nobody_else_may_read_the_file_as_sources_hold_passwords(tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text("{}")
    (tmp_path / "rig.json").chmod(0o644)
    found(tmp_path, phones=1, overwrite=True)
    assert (tmp_path / "rig.json").stat().st_mode & 0o777 == 0o600


def test_no_password_of_a_source_is_shown(tmp_path: Path) -> None:
    """Neither one before the place nor one in its options, whatever the camera calls it."""
    said, source = list[str](), "http://me:secret@127.0.0.1:9/main?loginpas=hidden&channel=2"
    with pytest.raises(InputError, match="none of its cameras"):
        find([source], tmp_path / "rig.json", 0, None, FPS, said.append, overwrite=False)
    assert any("http://me:***@127.0.0.1:9/main?loginpas=***&channel=2" in line for line in said)
    assert not any("secret" in line or "hidden" in line for line in said)


def test_a_calibration_of_another_size_is_refused(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [burnt(0)])
    frame = {"file_path": "a.mp4", "w": WIDTH, "h": HEIGHT, "fl_x": 150, "fl_y": 150, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    frame["transform_matrix"] = np.eye(4).tolist()
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    camera = {"name": "a", "source": "push:", "width": HEIGHT, "height": WIDTH}
    rig = tmp_path / "rig.json"
    rig.write_text(json.dumps({"fps": FPS, "calibration": ".", "cameras": [camera]}))
    with pytest.raises(InputError, match=f"gives {HEIGHT}x{WIDTH}, but is calibrated for {WIDTH}x{HEIGHT}"):
        read_definition(rig)
    rig.write_text(
        json.dumps({"fps": FPS, "calibration": ".", "cameras": [camera | {"width": WIDTH, "height": HEIGHT}]})
    )
    assert read_definition(rig).cameras[0].width == WIDTH


def test_a_phones_link_is_good_for_the_servers_that_follow(tmp_path: Path) -> None:
    """`rig --record`, `check` and `serve` come one after the other, while the phones' pages wait."""
    found(tmp_path, phones=1)
    tokens = tmp_path / "tokens.json"
    tokens.write_text(json.dumps([{"name": "a", "sha256": hash_token("a"), "rights": ["read"], "streams": "*"}]))
    here = {"host": "127.0.0.1", "port": 0, "tokens": tokens, "certificate": None, "certificate_key": None}
    settings = load_settings(tmp_path / "rig.toml").model_copy(update=here)
    with station(settings, tmp_path / "rig.json") as first:
        query = urlsplit(first.pages(["phone1"])["phone1"]).query
    with station(settings, tmp_path / "rig.json") as second:
        place = f"ws://{urlsplit(second.address).netloc}/v1/streams/main/ingest"
        codes = []
        for allowed in (query, query.replace("phone1", "phone2")):
            with connect(f"{place}?{allowed}", subprotocols=[Subprotocol(PUSH_SUBPROTOCOL)]) as node:
                with pytest.raises(ConnectionClosed) as caught:
                    node.recv(60)
                codes.append(caught.value.rcvd and caught.value.rcvd.code)
        assert codes == [1013, 4401], "let in, but no rig takes pictures; not let in"


def test_a_phones_page_is_drawn_as_a_code_that_a_camera_reads(tmp_path: Path) -> None:
    found(tmp_path, phones=2)
    here = {"host": "127.0.0.1", "port": 0, "certificate": None, "certificate_key": None}
    settings = load_settings(tmp_path / "rig.toml").model_copy(update=here)
    said: list[str] = []
    with ExitStack() as stack:
        phones_socket(tmp_path / "rig.json", read_uncalibrated(tmp_path / "rig.json"), settings, stack, said.append)
    *code, named = said[0].splitlines()
    light = {"█": (255, 255), "▀": (255, 0), "▄": (0, 255), " ": (0, 0)}  # of a letter's upper and lower half
    rows = [[light[letter] for letter in re.sub(r"\x1b\[[0-9;]*m", "", line)] for line in code if line]
    picture = np.array(rows, np.uint8).transpose(0, 2, 1).reshape(2 * len(rows), -1)
    read, *_ = cv2.QRCodeDetector().detectAndDecode(cv2.resize(picture, None, fx=8, fy=8, interpolation=0))
    assert read
    assert named.endswith(f": {read}")
    assert read.endswith("/capture")


def test_what_is_waited_for_is_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it would push the QR code out of the terminal before somebody has put up four phones."""
    monkeypatch.setattr(recording, "_TELL_SECONDS", 0.1)
    monkeypatch.setattr(rig_command, "_WAIT_SECONDS", 2.0)
    rig, said = write_definition(tmp_path, ["push:"] * 2), list[str]()
    with pytest.raises(InputError, match=r"waited 2 s for cam0 and cam1 \(no pictures come\); have all"):
        watch(rig, None, 3.0, Settings(port=0), said.append, overwrite=False)
    assert [line for line in said if line.startswith("waiting")] == ["waiting for cam0 and cam1 (no pictures come)"]


def test_cameras_of_one_fault_are_named_together() -> None:
    slow = "5 a second, but the rig wants 8 pictures"
    found = trouble_of({"phone1": slow, "phone2": "", "phone3": slow})
    assert found == f"phone1 and phone3 ({slow}), phone2 (no pictures come)"


def test_all_cameras_are_shown_while_a_rig_is_watched(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(30 * FPS)], fps=FPS)
    write_video(tmp_path / "b.mp4", [burnt(number) for number in range(FPS)], fps=FPS)
    rig, said = write_definition(tmp_path, ["a.mp4", "b.mp4"], fps=FPS), list[str]()
    work = threading.Thread(
        target=lambda: watch(rig, None, 12.0, Settings(port=0), said.append, overwrite=False), daemon=True
    )
    work.start()
    shown = "what all cameras see: "
    (place,) = wait(lambda: [line.removeprefix(shown) for line in said if line.startswith(shown)], 60)
    with httpx.Client(base_url=place.removesuffix("/cameras"), trust_env=False, timeout=60) as client:
        assert "<title>streamlod: cameras</title>" in client.get("/cameras").text

        def stream() -> dict[str, Any]:
            return client.get("/v1/streams/main").json()

        wait(lambda: stream()["camera_pictures"] == ["cam0", "cam1"] and stream()["ingest"]["cameras"]["cam1"]["fault"])
        cameras = stream()["ingest"]["cameras"]
        assert cameras["cam0"]["size"] == [WIDTH, HEIGHT]
        assert cameras["cam0"]["counts"]["received"] > 0
        assert cameras["cam1"]["fault"] == "it ended"
        numbers = set()

        def moves() -> bool:
            jpeg = client.get("/v1/streams/main/cameras/cam0.jpg").content
            picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
            numbers.add(number_of(picture))
            return len(numbers) > 2

        wait(moves, 60)
    work.join(60)
    assert not work.is_alive()
    assert "showing them for 12 s; Ctrl-C ends it" in said


def test_a_rig_is_shown_for_longer_than_a_walk_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To aim four phones in peace takes more than a minute: here, until the file ends."""
    monkeypatch.setattr(rig_command, "_RECORD_SECONDS", 0.1)
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(3 * FPS)], fps=FPS)
    said, begin = list[str](), time.monotonic()
    watch(write_definition(tmp_path, ["a.mp4"], fps=FPS), None, None, Settings(port=0), said.append, overwrite=False)
    assert said[-1] == "showing them; Ctrl-C ends it"
    assert time.monotonic() - begin > 2


def test_a_rig_without_phones_needs_no_server(tmp_path: Path) -> None:
    """Another one may have the port."""
    write_video(tmp_path / "a.mp4", [burnt(0)] * FPS, fps=FPS)
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as other:
        settings = Settings(port=other.getsockname()[1])
        watch(write_definition(tmp_path, ["a.mp4"]), None, 60.0, settings, said.append, overwrite=False)
        with pytest.raises(InputError, match="in use"):
            watch(write_definition(tmp_path, ["push:"]), None, 60.0, settings, said.append, overwrite=False)
    assert said[0].startswith("no page shows the cameras (")
    assert said[-1].endswith("all 1 cameras at one instant")


@pytest.mark.long
def test_phones_are_checked_while_they_film(tmp_path: Path) -> None:
    """A phone beside a file: it is shown its page, and both are in the table."""
    rig = write_definition(tmp_path, ["push:", "still.mp4"], sound="cam0")
    write_still(tmp_path / "still.mp4")
    over, phones = threading.Event(), list[threading.Thread]()

    def say(line: str) -> None:
        if match := re.search(r"(http\S+)$", line):
            phones.append(threading.Thread(target=film, args=(match[1], "cam0", time.time_ns(), over), daemon=True))
            phones[-1].start()

    text, _ = check(rig, None, Settings(port=0), say)
    over.set()
    for phone in phones:
        phone.join(60)
    assert len(phones) == 1
    assert re.search(r"^cam0 ", text, re.MULTILINE)
    assert re.search(r"^cam1 ", text, re.MULTILINE)
    assert "gave no picture" not in text
    assert "no sound of cam0: it sends none" in text
