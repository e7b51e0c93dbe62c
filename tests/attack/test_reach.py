"""What somebody with the right to control streams may reach: not the machine's files, and not its network."""

from __future__ import annotations

import ipaddress
import shutil
from pathlib import Path
from typing import Any

import pytest

from streamlod.core.errors import InputError
from streamlod.server.api.reach import check_reach
from streamlod.server.auth.gate import EVERYTHING, Grant, Right
from streamlod.server.http.networks import is_reachable
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings
from tests.server.conftest import Clip, running

_MATRIX = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]


def rig(source: str, **fields: Any) -> dict[str, Any]:
    camera = {
        "name": "cam0", "source": source, "width": 64, "height": 48, "world_to_camera": _MATRIX,
        "intrinsics": [[60, 0, 32], [0, 60, 24], [0, 0, 1]],
    }  # fmt: skip
    return {"fps": 10, "cameras": [camera], **fields}


def test_files_outside_the_roots_are_refused_alike_whether_they_exist(tmp_path: Path, clip: Clip) -> None:
    root = tmp_path / "root"
    root.mkdir()
    shutil.copy(clip.path, root / "inside.slod")
    (root / "way-out").symlink_to(clip.path.parent)
    settings = Settings(roots=(root,), state=tmp_path / "state")
    with running(settings, confined=True) as server, server.client() as client:

        def refusal(**fields: Any) -> str:
            answer = client.post("/v1/streams", json={"id": "x", **fields})
            assert answer.status_code == 422, answer.text
            detail: str = answer.json()["detail"]
            return detail

        for name in ("play", "data", "live"):
            texts = {
                refusal(**{name: path})
                for path in ("/etc/passwd", "/etc/none", str(clip.path), f"{root}/../x", f"{root}/way-out/scene.slod")
            }
            assert len(texts) == 1, texts
            assert "`roots`" in texts.pop()
        assert "`roots`" in refusal(live=rig("push:", calibration="/etc"))
        assert "`roots`" in refusal(synthetic={"cameras": 3}, points="/etc/passwd")
        assert "`roots`" in refusal(play=str(tmp_path / "state" / "secret.key"))
        for source in ("/etc/passwd", "file:///etc/passwd", "v4l2:///dev/video0"):
            assert "`roots`" in refusal(live=rig(source))
        made = client.post("/v1/streams", json={"id": "inside", "play": str(root / "inside.slod")})
        assert made.status_code == 201


@pytest.mark.parametrize(
    "source",
    [
        "rtsp://127.0.0.1/x", "rtsp://10.1.2.3/x", "http://169.254.169.254/latest", "rtsp://[::1]/x", "tcp://0.0.0.0:80",
        "rtsp://[::ffff:10.0.0.1]/x", "rtsp://localhost/x", "rtsp://camera.example/x", "rtsp://2130706433/x",
        "srt://192.168.0.1:9000", "rtmp://[fe80::1]/x", "http://224.0.0.1/x", "rtsp://user@127.0.0.1/x",
        "http://[2002:7f00:1::]/x", "http://[64:ff9b::a00:1]/x", "http://[::7f00:1]/x",
        "rtsp://8.8.8.8/x", "rtsps://8.8.8.8/x",  # which may send FFmpeg to any other address
    ],
)  # fmt: skip
def test_private_addresses_are_refused(source: str) -> None:
    with running(Settings(), confined=True) as server, server.client() as client:
        answer = client.post("/v1/streams", json={"id": "x", "live": rig(source)})
        assert (answer.status_code, "`networks`" in answer.json()["detail"]) == (422, True), answer.text


_NEVER_PUBLIC = [
    "0.0.0.0", "0.1.2.3", "100.64.0.1", "100.100.100.200", "127.0.0.1", "169.254.169.254", "169.254.170.2",
    "192.0.0.1", "192.0.0.192", "192.88.99.1", "198.18.0.1", "198.19.255.255", "224.0.0.1", "239.255.255.250",
    "240.0.0.1", "255.255.255.255", "168.63.129.16",
]  # fmt: skip


@pytest.mark.parametrize("address", _NEVER_PUBLIC)
def test_reserved_and_metadata_addresses_are_no_public_ones_however_they_are_written(address: str) -> None:
    number = int(ipaddress.ip_address(address))
    in_ipv6 = [
        f"::ffff:{address}", f"::ffff:0:{address}", f"64:ff9b::{address}", f"64:ff9b:1::{address}", f"::{address}",
        f"2002:{number >> 16:x}:{number & 0xFFFF:x}::1",
    ]  # fmt: skip
    for spelled in (address, *in_ipv6):
        assert not is_reachable(spelled, ()), spelled


@pytest.mark.parametrize(
    "address",
    ["::", "::1", "fe80::1", "fec0::1", "fc00::1", "fd00:ec2::254", "fd20:ce::254", "ff02::1", "ff0e::1", "100::1",
     "2001::1", "2001:db8::1", "3fff::1", "5f00::1", "4000::1"],
)  # fmt: skip
def test_only_what_was_given_out_of_ipv6_is_public(address: str) -> None:
    assert not is_reachable(address, ())
    assert is_reachable("2606:4700:4700::1111", ())
    assert is_reachable("::ffff:8.8.8.8", ())


def test_a_network_that_is_listed_as_a_whole_does_not_mean_the_metadata_service_in_it() -> None:
    everything = ("0.0.0.0/0", "::/0")
    for address in ("169.254.169.254", "100.100.100.200", "fd00:ec2::254", "::ffff:169.254.169.254", "168.63.129.16"):
        assert not is_reachable(address, everything)
    assert is_reachable("169.254.1.1", everything)
    assert is_reachable("169.254.169.254", ("169.254.169.254/32",))
    assert not is_reachable("metadata.google.internal", everything)
    assert is_reachable("metadata.google.internal", ("metadata.google.internal",))


@pytest.mark.parametrize(
    "fields",
    [
        {"jwks": "http://169.254.169.254/keys"},
        {"trace_endpoint": "http://[fd00:ec2::254]:4318"},
        {"edge": {"origin": "http://metadata.google.internal"}},
        {"webhooks": [{"url": "http://Metadata.Google.Internal./x", "key": "key"}]},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_settings_do_not_send_the_server_to_a_metadata_service(fields: dict[str, Any]) -> None:
    settings = Settings.model_validate(fields)
    with pytest.raises(InputError, match="metadata service"):
        create_app(settings)


def test_listed_networks_names_and_listening_addresses_are_taken() -> None:
    settings = Settings(networks=("10.0.0.0/8", "camera.example"), listen=("127.0.0.1:8554",))
    with running(settings, confined=True) as server, server.client() as client:
        sources = ("rtsp://10.1.2.3/x", "rtsp://camera.example/x", "rtsp+listen://127.0.0.1:8554/x", "push:")
        for number, source in enumerate(sources):
            made = client.post("/v1/streams", json={"id": f"s{number}", "live": rig(source)})
            assert made.status_code == 201, made.text
        for source in (
            "rtsp+listen://0.0.0.0:8554/x", "tcp+listen://127.0.0.1:8555", "udp://127.0.0.1:5000",
            "srt://8.8.8.8:9000?mode=listener", "srt://8.8.8.8:9000#?MODE=Listener", "srt://8.8.8.8:9?mode=rendezvous",
        ):  # fmt: skip
            answer = client.post("/v1/streams", json={"id": "x", "live": rig(source)})
            assert "`listen`" in answer.json()["detail"]
    assert is_reachable("8.8.8.8", ())
    assert not is_reachable("192.168.1.1", ("10.0.0.0/8",))


def test_passwords_are_neither_stored_readable_nor_shown(tmp_path: Path) -> None:
    source = "rtsp://admin:hunter2@10.1.2.3/x"
    settings = Settings(state=tmp_path, networks=("10.0.0.0/8",))
    with running(settings, confined=True) as server, server.client() as client:
        made = client.post("/v1/streams", json={"id": "cams", "live": rig(source)})
        assert made.status_code == 201, made.text
        shown = client.get("/v1/streams/cams/definition")
        assert shown.json()["live"]["cameras"][0]["source"] == "rtsp://admin:***@10.1.2.3/x"
        wrong = client.post("/v1/streams", json={"id": "x", "live": rig(source.replace("rtsp:", "gopher:"))})
        for text in (made.text, shown.text, wrong.text, client.get("/v1/streams").text):
            assert "hunter2" not in text
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or b"hunter2" not in path.read_bytes(), path
    with running(settings, confined=True) as server:
        spec: StreamSpec = server.worker_stream("cams").spec
        assert spec.job is not None
        assert isinstance(spec.job.live, dict)
        assert spec.job.live["cameras"][0]["source"] == source


def test_a_definition_that_cannot_be_used_is_refused_when_it_is_created(tmp_path: Path) -> None:
    (tmp_path / "bad.slod").write_bytes(b"no bitstream")
    with running(Settings(roots=(tmp_path,)), confined=True) as server, server.client() as client:
        for fields in (
            {"live": {}},
            {"live": rig("x://y")},
            {"live": {"fps": 0}},
            {"play": str(tmp_path / "bad.slod")},
        ):
            answer = client.post("/v1/streams", json={"id": "x", **fields})
            assert answer.status_code == 422, fields


def test_a_file_that_cannot_be_played_fails_at_once(tmp_path: Path) -> None:
    (tmp_path / "bad.slod").write_bytes(b"no bitstream")
    with running(Settings(), StreamSpec(play=tmp_path / "bad.slod")) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
        assert found["restarts"] == 0


@pytest.mark.parametrize("query", ["?listen", "?listen=1", "#?listen", "?timeout=1&local_port=8554", "?LISTEN=1"])
def test_an_address_does_not_make_ffmpeg_listen_elsewhere(query: str) -> None:
    settings = Settings(networks=("127.0.0.0/8",), listen=("127.0.0.1:5000",))
    for source in (f"tcp://127.0.0.1:5000{query}", f"udp://127.0.0.1:5000{query}", f"srt://127.0.0.1:5000{query}"):
        with pytest.raises(InputError, match="has the option"):
            check_reach(StreamSpec(job=TrainJob(live=rig(source))), settings, EVERYTHING)


def test_public_addresses_and_harmless_options_are_taken() -> None:
    settings = Settings(networks=("8.8.8.8/32",))
    for source in (
        "rtsp://8.8.8.8/x?resolution=640x480",
        "srt://9.9.9.9:9000?mode=caller&latency=200000",
        "tcp://9.9.9.9:80",
    ):
        check_reach(StreamSpec(job=TrainJob(live=rig(source))), settings, EVERYTHING)


@pytest.mark.parametrize("field", ["play", "data", "live", "points", "calibration", "source"])
def test_of_the_state_folder_only_recordings_that_the_token_may_watch_are_read(tmp_path: Path, field: str) -> None:
    """Also where a root holds the state folder, and whether or not a file is there."""
    grant = Grant(frozenset({Right.CONTROL, Right.READ}), "stage-*")
    state = tmp_path / "state"
    for name in ("main", "stage-1"):
        (state / "streams" / name).mkdir(parents=True)
        (state / "streams" / name / "000001-0000000000.slod").write_bytes(b"")
    (tmp_path / "link").symlink_to(state / "streams" / "main")

    def spec(path: object) -> StreamSpec:
        match field:
            case "play":
                return StreamSpec(id="stage-x", play=Path(str(path)))
            case "calibration":
                return StreamSpec(job=TrainJob(live=rig("push:", calibration=str(path))))
            case "source":
                return StreamSpec(job=TrainJob(live=rig(f"file://{path}")))
            case "points":
                return StreamSpec(job=TrainJob(live=rig("push:"), points=str(path)))
        return StreamSpec(job=TrainJob(**{field: Path(str(path))}))

    for roots in ((), (tmp_path,)):
        settings = Settings(roots=roots, state=state)
        check_reach(spec(state / "streams" / "stage-1" / "000001-0000000000.slod"), settings, grant)
        refusals = set()
        for path in (
            state / "streams" / "main" / "000001-0000000000.slod",
            state / "streams" / "main" / "none.slod",
            state / "streams" / "stage-1" / ".." / "main" / "000001-0000000000.slod",
            state / "streams" / "other" / "none.slod",
            state / "streams" / "stage-1",
            state / "streams",
            state / "secret.key",
            state,
            tmp_path / "link" / "000001-0000000000.slod",
        ):
            with pytest.raises(InputError) as refused:
                check_reach(spec(path), settings, grant)
            refusals.add(str(refused.value))
        assert len(refusals) == 1
        with pytest.raises(InputError):
            check_reach(spec(state / "streams" / "main" / "x"), settings, Grant(frozenset({Right.CONTROL})))
        check_reach(spec(state / "streams" / "main" / "x"), settings, EVERYTHING)


def test_settings_that_were_tightened_hold_for_streams_that_are_remembered(tmp_path: Path, clip: Clip) -> None:
    state = tmp_path / "state"
    before = Settings(roots=(clip.path.parent,), state=state)
    with running(before, confined=True) as server, server.client() as client:
        made = client.post("/v1/streams", json={"id": "x", "play": str(clip.path), "start": True})
        assert made.status_code == 201
    with running(Settings(state=state), confined=True) as server, server.client() as client:
        found = client.get("/v1/streams/x").json()
        assert (found["state"], "`roots`" in found["detail"]) == ("failed", True)
        refused = client.post("/v1/streams/x/start")
        assert (refused.status_code, "`roots`" in refused.json()["detail"]) == (409, True)
        assert server.stream("x")["state"] == "failed"
    with running(before, confined=True) as server:  # it is as it was
        server.wait(lambda stream: stream["state"] == "live", "x")
