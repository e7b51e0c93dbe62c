"""A file that is played for nobody costs nothing, and goes on when somebody comes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.codec.container import SlodReader
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from tests.server.conftest import Clip, running, viewing
from tests.waiting import wait


@pytest.mark.long
@pytest.mark.parametrize("kept", [False, True])
def test_nothing_is_made_while_nobody_watches(clip: Clip, tmp_path: Path, kept: bool) -> None:
    settings = Settings(on_demand_seconds=0, state=tmp_path if kept else None)
    with running(settings, StreamSpec(play=clip.path, recorded=False)) as server:
        stream = server.registry.streams["main"]
        assert isinstance(stream, WorkerStream)
        wait(lambda: stream.is_paused)
        assert server.stream()["state"] == "live"
        first = stream.counters.packets
        for _ in range(2):
            with viewing(server) as viewer:
                viewer.hello()
                viewer.until("caught_up")
                before = stream.counters.packets
                for _ in range(5):
                    viewer.next_packet()
                assert stream.counters.packets > before
            wait(lambda: stream.is_paused)
        assert stream.counters.packets > first
        with server.client() as client:  # stopping one that pauses takes no time, and it starts again
            assert client.post("/v1/streams/main/stop").status_code == 202
            server.wait(lambda found: found["state"] == "idle")
            assert not stream.is_paused
            assert client.post("/v1/streams/main/start").status_code == 202
            server.wait(lambda found: found["state"] == "live")
    assert not list(tmp_path.rglob("*.slod"))


def test_what_is_recorded_does_not_pause_and_is_recorded_once(clip: Clip, tmp_path: Path) -> None:
    """Once after each start, that is; its later rounds pause, as they are not recorded."""
    settings = Settings(on_demand_seconds=0, state=tmp_path)
    with running(settings, StreamSpec(play=clip.path)) as server, server.client() as client:
        stream = server.registry.streams["main"]
        wait(lambda: stream.is_paused)
        first = recorded(tmp_path)
        assert set(first) == {1}
        assert first[1] == clip.packets
        with viewing(server) as viewer:
            viewer.hello()
            viewer.until("epoch")
            assert recorded(tmp_path) == first
        assert client.post("/v1/streams/main/stop").json()["recording"] == "off"
        last = server.stream()["epoch"]
        server.wait(lambda found: found["state"] == "idle")
        assert not stream.is_paused
        assert client.post("/v1/streams/main/start").json()["recording"] == "on"
        wait(lambda: stream.is_paused)
        assert recorded(tmp_path) == first | {last + 1: clip.packets}


def recorded(folder: Path) -> dict[int, list[bytes]]:
    """Recorded packets by epoch."""
    found: dict[int, list[bytes]] = {}
    for path in sorted(folder.rglob("*.slod")):
        with SlodReader(path) as reader:
            found.setdefault(int(path.name.split("-")[0]), []).extend(reader.packets())
    return found


def test_a_played_file_of_the_command_line_is_not_recorded(clip: Clip) -> None:
    from streamlod.server.cli import commands, main

    seen: list[StreamSpec] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(commands, "serve", lambda settings, streams, again: seen.extend(streams))
        patch.setattr("sys.argv", ["streamlod", "serve", "--play", str(clip.path)])
        with pytest.raises(SystemExit):
            main.main()
    assert seen == [replace(StreamSpec(play=clip.path), recorded=False)]
