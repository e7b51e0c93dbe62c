"""Streams as HLS: what a playlist names is what was streamed, and who may fetch it."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from streamlod.client.connection.hls import hls_packets, save_hls
from streamlod.codec.container import SlodReader
from streamlod.codec.mp4 import Mp4Reader
from streamlod.codec.mp4.playlist import Playlist, PlaylistPart, playlist_text, read_playlist
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import write_sound
from streamlod.codec.sound.packets import read_packets
from streamlod.core.errors import InputError
from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.clicks import clicks
from tests.server.conftest import Clip, Running, make_clip, running, viewing

INDEX = "/v1/streams/main/hls/index.m3u8"


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Forty frames in four groups of pictures, with sound."""
    clip = make_clip(tmp_path_factory.mktemp("hls") / "clip.slod", 40, (4, 8), 10)
    write_sound(sound_beside(clip.path), [clicks(1.0)], 1, 0)
    return clip


@pytest.fixture(scope="module")
def server(clip: Clip) -> Iterator[Running]:
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        yield server


def packets_of(path: Path) -> list[bytes]:
    with SlodReader(path) as reader:
        return list(reader.packets())


def test_a_played_recording_is_a_whole_playlist_with_sound(server: Running, clip: Clip, tmp_path: Path) -> None:
    address = server.url + INDEX
    assert save_hls(address, tmp_path / "a.slod").endswith("40 packets of 4 segments, with sound")
    assert (tmp_path / "a.slod").read_bytes() == clip.path.read_bytes()
    assert read_packets(sound_beside(tmp_path / "a.slod")) == read_packets(sound_beside(clip.path))
    with server.client() as client:
        answer = client.get(INDEX)
        assert answer.headers["content-type"].startswith("application/vnd.apple.mpegurl")
        playlist = read_playlist(answer.text, "it")
        assert playlist.is_complete
        assert sum(segment.seconds for segment in playlist.segments) == pytest.approx(0.8, abs=1e-3)
        segment = client.get(f"/v1/streams/main/hls/{playlist.segments[1].address}", headers={"Range": "bytes=4-7"})
        assert (segment.status_code, segment.content) == (206, b"moof")
        assert client.get("/v1/streams/main/hls/recording/4.m4s").status_code == 404


def test_ffprobe_reads_the_playlist_over_http(server: Running) -> None:
    shown = ["-show_entries", "stream=codec_tag_string,nb_read_packets", "-count_packets", "-of", "json"]
    command = ["ffprobe", "-v", "error", *shown, server.url + INDEX]
    told = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    assert {each["codec_tag_string"]: int(each["nb_read_packets"]) for each in told["streams"]} == {
        "slp1": 40,
        "Opus": 51,
    }


@pytest.fixture(scope="module")
def growing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Running, Clip]]:
    """A recorded server whose stream is offered as it comes: 6 s at 5 frames a second, a keyframe every 2 s."""
    folder = tmp_path_factory.mktemp("growing")
    clip = make_clip(folder / "slow.slod", 30, (4, 8), 10, 200_000_000)
    with running(Settings(state=folder / "state"), StreamSpec(play=clip.path, loop=False)) as server:
        server.registry.streams["main"].played_file = None  # so that it is like one that is made here
        yield server, clip


@pytest.mark.long
def test_a_live_stream_is_followed_from_the_newest_keyframe_to_its_end(growing: tuple[Running, Clip]) -> None:
    server, clip = growing
    playlists: list[Playlist] = []
    with server.client() as client, viewing(server) as viewer:
        viewer.hello()
        viewer.until_version(16)
        found: list[bytes] = []
        following = threading.Thread(target=lambda: found.extend(hls_packets(server.url + INDEX)))
        following.start()
        while not playlists or not playlists[-1].is_complete:
            answer = client.get(INDEX)
            assert answer.headers["cache-control"] == "public, max-age=1"
            playlists.append(read_playlist(answer.text, "it"))
            viewer.until("window")
            if viewer.named("state") and viewer.named("state")[-1]["state"] == "ended":
                playlists.append(read_playlist(client.get(INDEX).text, "it"))
        following.join(30)
    assert not following.is_alive()
    begin = clip.packets.index(found[0])
    assert begin in (10, 20)  # a keyframe, the newest when it came
    assert found == clip.packets[begin:]
    assert any(playlist.parts for playlist in playlists)
    for playlist in playlists:
        assert [part.begins_anew for part in playlist.parts] == [True, False, False, False][: len(playlist.parts)]
    last = playlists[-1]
    assert [segment.seconds for segment in last.segments] == pytest.approx([2.0] * 3)
    assert last.first == playlists[0].first > 10**12


@pytest.mark.long
def test_parts_of_a_group_hold_what_its_segment_holds(growing: tuple[Running, Clip], tmp_path: Path) -> None:
    server, clip = growing
    server.wait(lambda stream: stream["state"] == "ended")
    incarnation = server.stream()["incarnation"]
    folder = f"/v1/streams/main/hls/{incarnation}/1"
    with server.client() as client:
        beginning = client.get("/v1/streams/main/hls/init.mp4").content
        whole = client.get(f"{folder}/10.m4s")
        assert whole.headers["cache-control"] == "public, max-age=31536000, immutable"
        parts = [client.get(f"{folder}/parts/{first}-{first + 4}.m4s").content for first in (10, 15)]
        for name, data in (("whole", whole.content), ("parts", b"".join(parts))):
            path = tmp_path / f"{name}.mp4"
            path.write_bytes(beginning + data)
            with Mp4Reader(path) as reader:
                assert list(reader.packets()) == clip.packets[10:20]
        etag = whole.headers["etag"]
        assert client.get(f"{folder}/10.m4s", headers={"If-None-Match": etag}).status_code == 304
        assert client.get(f"{folder}/11.m4s").status_code in (404, 410)
        assert client.get(f"{folder}/parts/25-29.m4s").status_code == 404  # nothing follows that would end it
        assert client.get(f"{folder}/parts/0-4294967295.m4s").status_code in (404, 422)
        assert client.get(f"/v1/streams/main/hls/{'0' * 16}/1/10.m4s").status_code == 410
        assert client.get("/v1/streams/main/hls/recording/0.m4s").status_code == 404


def test_a_signed_playlist_opens_all_that_it_names_and_nothing_else(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.api.access._REFUSAL_SECONDS", 0.0)
    rights = {"viewer": ["read"], "operator": ["control"]}
    entries = [
        {"name": name, "sha256": hash_token(name), "rights": given, "streams": "main"} for name, given in rights.items()
    ]
    (tmp_path / "tokens.json").write_text(json.dumps(entries))
    with running(Settings(tokens=tmp_path / "tokens.json"), StreamSpec(play=clip.path)) as origin:
        with origin.client() as client:
            for place in (INDEX, "/v1/streams/main/hls/init.mp4", "/v1/streams/main/hls/recording/0.m4s"):
                got = {name: client.get(place, headers={"Authorization": f"Bearer {name}"}) for name in rights}
                assert {name: answer.status_code for name, answer in got.items()} == {"viewer": 200, "operator": 403}
                assert client.get(place).status_code == 401
                assert "private" in got["viewer"].headers["cache-control"]
            asked = {"path": "hls/index.m3u8", "seconds": 60}
            made = client.post("/v1/streams/main/links", json=asked, headers={"Authorization": "Bearer viewer"}).json()
            query = made["url"].partition("?")[2]
            for other in ("bitstream", "sound", "packets/1/0"):
                assert client.get(f"/v1/streams/main/{other}?{query}").status_code == 401
        assert "40 packets" in save_hls(origin.url + made["url"], tmp_path / "signed.slod")
        assert "40 packets" in save_hls(origin.url + INDEX, tmp_path / "token.slod", "viewer")
        with pytest.raises(InputError, match="401"):
            save_hls(origin.url + INDEX, tmp_path / "none.slod")
    assert packets_of(tmp_path / "signed.slod") == clip.packets
    assert not (tmp_path / "none.slod").exists()


def test_an_edge_passes_playlists_and_segments_on(server: Running, clip: Clip, tmp_path: Path) -> None:
    with running(Settings(edge=EdgeSettings(origin=server.url))) as edge:
        edge.wait(lambda stream: stream.get("id") == "main")
        save_hls(edge.url + INDEX, tmp_path / "edge.slod")
        with edge.client() as client:
            link = client.post("/v1/streams/main/links", json={"path": "hls/index.m3u8"}).json()["url"]
            assert "signature" in read_playlist(client.get(link).text, "it").beginning
            for name in ("..%2f..%2f..%2fserver", "recording%2f..%2f..%2fsound", "%2e%2e/sound"):
                assert client.get(f"/v1/streams/main/hls/{name}").status_code in (404, 422)
        assert "40 packets" in save_hls(edge.url + link, tmp_path / "signed.slod")
    assert packets_of(tmp_path / "edge.slod") == packets_of(tmp_path / "signed.slod") == clip.packets


def test_a_stream_without_packets_has_no_playlist_yet(server: Running) -> None:
    with server.client() as client:
        assert client.get("/v1/streams/nobody/hls/index.m3u8").status_code == 404


def test_playlists_come_back_as_they_were_written() -> None:
    segments = (PlaylistPart("a/1.m4s", 2.5), PlaylistPart("a/2.m4s", 1.25, is_run_start=True))
    parts = (PlaylistPart("a/parts/3-4.m4s", 1.0), PlaylistPart("a/parts/5-6.m4s", 1.5, begins_anew=False))
    written = Playlist("init.mp4", segments, parts, first=7, longest=3.0)
    assert read_playlist(playlist_text(written), "it") == written


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "no HLS playlist"),
        ("#EXTM3U\n" * 200_001, "no HLS playlist"),
        ("#EXTM3U\n#EXTINF:1,\na.m4s\n", "names no initialisation segment"),
        ('#EXTM3U\n#EXT-X-MAP:URI="i.mp4"\n#EXTINF:one,\na.m4s', "in place of a number"),
        ('#EXTM3U\n#EXT-X-MAP:URI="i.mp4"\n#EXTINF:nan,\na.m4s', "out of range"),
        ('#EXTM3U\n#EXT-X-MAP:URI="i.mp4"\n#EXT-X-MEDIA-SEQUENCE:1e300\n', "out of range"),
        ('#EXTM3U\n#EXT-X-MAP:URI="i.mp4"\n#EXT-X-MAP:URI="j.mp4"\n', "changes its initialisation"),
        ("#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1\nv.m3u8", "name a plain media playlist"),
        ('#EXTM3U\n#EXT-X-MAP:URI="i.mp4"\n#EXTINF:1,\n' + "a" * 5000, "an address of 5000"),
        ("#EXTM3U\n#EXT-X-MAP:URI=\n", "an address of 0"),
    ],
)
def test_playlists_that_cannot_be_used_are_refused_in_a_sentence(text: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        read_playlist(text, "it")


def test_a_folder_names_nothing_outside_and_lying_segments_are_refused(tmp_path: Path) -> None:
    index, out = tmp_path / "in" / "index.m3u8", tmp_path / "out.slod"
    index.parent.mkdir()
    (tmp_path / "secret").write_bytes(b"secret")
    (index.parent / "init.mp4").write_bytes(b"\0" * 100)
    for beginning, segment, fault in (
        ("../secret", "a.m4s", "outside its folder"),
        ("init.mp4", "/etc/hostname", "outside its folder"),
        ("init.mp4", "none.m4s", "cannot be fetched"),
        ("init.mp4", "init.mp4", "no MP4 file"),
    ):
        index.write_text(f'#EXTM3U\n#EXT-X-MAP:URI="{beginning}"\n#EXTINF:1,\n{segment}\n')
        with pytest.raises(InputError, match=fault):
            save_hls(str(index), out)
        assert not out.exists()
