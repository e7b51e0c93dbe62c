"""Live sound: to viewers that ask for it, kept with the recording, served by time, and refused where it is none."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from streamlod.codec.mp4.sound import is_piece, pack_piece, read_piece
from streamlod.codec.sound.beside import look_at_sound
from streamlod.core.errors import BitstreamError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Retention, Settings
from tests.clicks import heard_at
from tests.server.conftest import Clip, Running, make_clip, running, viewing
from tests.server.sounds import hear, pieces

PATH = "/v1/streams/main/sound"
SECOND_NS = 1_000_000_000


@pytest.fixture
def server(slow_clip: Clip) -> Iterator[Running]:
    with running(Settings(), StreamSpec(play=slow_clip.path)) as server:
        yield server


@pytest.mark.long
def test_who_asks_for_sound_gets_it_from_its_picture_on(server: Running) -> None:
    with viewing(server) as listener, viewing(server) as silent:
        assert listener.hello(sound=True).welcome["sound"] is None
        silent.hello()
        for viewer in (listener, silent):
            viewer.until("caught_up")
        hear(server, pieces(12.0))
        told = listener.until("sound")
        assert (
            told
            == {"type": "event", "event": "sound", "begin_ns": 0, "channels": 1, "live": True, "camera": None} | told
        )
        listener.until_heard(6 * SECOND_NS)
        assert server.stream()["sound"]["live"]
        assert listener.sound[0].begin_ns >= -7_000_000  # nothing before its first picture
        for before, after in zip(listener.sound, listener.sound[1:], strict=False):
            assert abs(after.begin_ns - before.end_ns) < 2
        silent.until_version(30)
        assert not silent.sound
        silent.send(type="set", sound=True)
        silent.until_heard(6 * SECOND_NS)
        assert silent.sound[0].end_ns > 2.9 * SECOND_NS  # from the picture on that it had
        silent.send(type="set", sound=False)
        hear(server, pieces(2.0, 13 * SECOND_NS))
        silent.until_version(silent.decoder.versions[0] + 20)
        assert silent.sound[-1].end_ns < 13 * SECOND_NS


@pytest.mark.long
def test_a_seek_brings_the_sound_of_where_it_leads(server: Running) -> None:
    with viewing(server) as viewer:
        viewer.hello(sound=True)
        viewer.until("caught_up")
        hear(server, pieces(12.0))
        viewer.until_version(40)
        viewer.sound.clear()
        viewer.send(type="seek", to={"epoch": 1, "version": 10})
        viewer.until("position")
        viewer.until_heard(4 * SECOND_NS)
        assert 0.7 * SECOND_NS < viewer.sound[0].begin_ns <= 1.1 * SECOND_NS
        assert viewer.sound[-1].end_ns < 8 * SECOND_NS, "some seconds ahead of the picture, and no more"


@pytest.mark.long
def test_sound_goes_on_between_pictures_that_are_far_apart(tmp_path: Path) -> None:
    """Who plays the past of a slow machine hears it without pauses, and not all of it at once."""
    sparse = make_clip(tmp_path / "sparse.slod", 3, frame_ns=6 * SECOND_NS)
    with running(Settings(), StreamSpec(play=sparse.path)) as server, viewing(server) as viewer:
        hear(server, pieces(20.0))
        viewer.hello(sound=True).until_version(1)
        viewer.sound.clear()
        viewer.send(type="seek", to={"epoch": 1, "version": 0})
        viewer.until("position")
        viewer.until_heard(3 * SECOND_NS)
        viewer.until("window")
        assert viewer.sound[-1].end_ns < 5 * SECOND_NS
        viewer.until_heard(int(5.9 * SECOND_NS))
        assert viewer.decoder.versions[0] == 0, "before the next picture"


def test_sound_is_served_by_time(server: Running, tmp_path: Path) -> None:
    with server.client() as client:
        assert client.get(PATH).status_code == 404
        hear(
            server, [*pieces(3.0, 5 * SECOND_NS, channels=2), *pieces(2.5, 9 * SECOND_NS + SECOND_NS // 2, channels=2)]
        )
        whole, part = client.get(PATH), client.get(f"{PATH}?from_ns=6500000000&to_ns=11500000000")
        assert client.get(f"{PATH}?from_ns=20000000000").status_code == 404
        assert client.get(f"{PATH}?from_ns=-1").status_code == 422
    for answer, heard in ((whole, [5, 6, 7, 10, 11]), (part, [7, 10, 11])):
        assert answer.headers["content-type"] == "audio/ogg"
        (tmp_path / "heard.opus").write_bytes(answer.content)
        assert heard_at(tmp_path / "heard.opus") == pytest.approx(heard, abs=0.002)


@pytest.mark.long
def test_sound_is_kept_beside_the_recording_and_goes_with_it(slow_clip: Clip, tmp_path: Path) -> None:
    settings = Settings(state=tmp_path / "state", retention=Retention(memory_bytes=1_000_000))
    with running(settings, StreamSpec(play=slow_clip.path, loop=False)) as server:
        hear(server, pieces(12.0), camera="cam01")
        server.wait(lambda stream: stream["state"] == "ended")
    folder = tmp_path / "state" / "streams" / "main"
    (first, second) = sorted(folder.glob("*.slod"))
    sounds = [path.with_name(f"{path.name}.opus") for path in (first, second)]
    assert [stat.stat().st_mode & 0o777 for stat in sounds] == [0o600, 0o600]
    assert heard_at(sounds[0]) == pytest.approx([0, 1, 2, 3, 4, 5], abs=0.01)
    assert heard_at(sounds[1]) == pytest.approx([6, 7, 8, 9], abs=0.01)
    assert look_at_sound(sounds[1]).begin_ns == pytest.approx(6 * SECOND_NS, abs=0.21 * SECOND_NS)
    assert [look_at_sound(each).camera for each in sounds] == ["cam01", "cam01"]
    # another run serves the past from there, and a group that is deleted takes its sound along
    with running(settings, StreamSpec(play=slow_clip.path, loop=False)) as server:
        assert server.stream()["sound"]["camera"] == "cam01"
        with server.client() as client:
            (tmp_path / "heard.opus").write_bytes(client.get(PATH).content)
            assert look_at_sound(tmp_path / "heard.opus").camera == "cam01"
            assert heard_at(tmp_path / "heard.opus") == pytest.approx(range(10), abs=0.01)
            assert client.delete("/v1/recordings/main?epoch=1").status_code == 204
        assert not any(path.exists() for path in (*sounds, first, second))


def test_an_edge_passes_sound_on(server: Running, tmp_path: Path) -> None:
    edge = EdgeSettings(origin=server.url, poll_seconds=0.1)
    with running(Settings(edge=edge)) as second:
        second.wait(lambda stream: stream.get("state") == "live")
        with viewing(second) as viewer:
            viewer.hello(sound=True)
            viewer.until("caught_up")
            hear(server, pieces(12.0), camera="cam01")
            viewer.until_heard(6 * SECOND_NS)
        second.wait(lambda stream: stream["sound"] is not None and stream["sound"]["live"])
        assert second.stream()["sound"]["camera"] == "cam01"
        with second.client() as client:
            (tmp_path / "heard.opus").write_bytes(client.get(f"{PATH}?from_ns=4500000000&to_ns=6500000000").content)
    assert heard_at(tmp_path / "heard.opus") == pytest.approx([5, 6], abs=0.01)


@pytest.mark.long
def test_what_is_no_piece_is_refused() -> None:
    (piece,) = pieces(0.2)
    data = pack_piece(piece)
    assert is_piece(data)
    assert read_piece(data) == piece
    damaged = [data[:-1], data + b"\0", b"", data[:100], bytes(500), data * 100]
    damaged += [data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :] for at in range(len(data)) for bit in (1, 128)]
    for each in damaged:
        try:
            found = read_piece(each)
        except BitstreamError:
            continue
        assert pack_piece(found) == each, "what is taken is canonical"
