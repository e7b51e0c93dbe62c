"""What an address stands for: files by path and by URL, and the folders to which streams made by REST are held."""

from __future__ import annotations

from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.server.api.reach import check_reach
from streamlod.server.auth.gate import EVERYTHING
from streamlod.server.ingest.cameras.address import local_file, parse_address
from streamlod.server.ingest.cameras.definition import read_definition
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.server.ingest.rig import write_definition


@pytest.mark.parametrize(
    ("source", "path"),
    [
        ("/data/cam.mp4", "/data/cam.mp4"),
        ("/data/take 12:30.mp4", "/data/take 12:30.mp4"),
        ("/data/50%20.mp4", "/data/50%20.mp4"),  # a path is no URL: nothing in it is escaped
        ("file:///data/cam.mp4", "/data/cam.mp4"),
        ("file:///data/a%20b/cam%2002.mp4", "/data/a b/cam 02.mp4"),
        ("file:///data/k%C3%BCche%23%3f.mp4", "/data/küche#?.mp4"),
        ("file:/data/cam.mp4", "/data/cam.mp4"),
        ("FILE://localhost/data/cam.mp4", "/data/cam.mp4"),
    ],
)
def test_files_by_path_and_by_url(source: str, path: str) -> None:
    assert local_file(source) == Path(path)
    assert (parse_address(source).url, parse_address(source).scheme) == (path, "file")


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("file:///data/cam#2.mp4", "has a [?] or # in its path"),
        ("file:///data/cam.mp4?x=1", "has a [?] or # in its path"),
        ("file://elsewhere/cam.mp4", "is no file of this machine"),
        ("file://cam 02.mp4", "is no file of this machine"),
        ("file:///data/%00", "is no file of this machine"),
        ("file:///data/%ff.mp4", "is not a URL"),
        ("push:phone1", "says more than push:; leave that out"),
        ("push://10.0.0.7/phone1", "says more than push:; leave that out"),
        ("v4l2:///dev/video0?fps=10", "names no camera; write v4l2:///dev/video0"),
        ("v4l2://door/dev/video0", "names no camera; write v4l2:///dev/video0"),
        ("alsa:///default#2", "names no microphone; write alsa:///default"),
    ],
)
def test_what_is_no_address_or_says_what_nothing_heeds(source: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        parse_address(source)


@pytest.mark.parametrize("name", ["take 12:30.mp4", "a:b/cam.mp4", "12:30"])
def test_a_relative_name_with_a_colon_lies_beside_the_rigs_file(tmp_path: Path, name: str) -> None:
    (address,) = read_definition(write_definition(tmp_path, [name])).addresses
    assert address.url == str(tmp_path / name)


@pytest.mark.parametrize(
    "source", ["file://{}/%2e%2e/secret.mp4", "file:{}/..%2fsecret.mp4", "{}/../secret.mp4", "FILE://{}/../secret.mp4"]
)
def test_an_escaped_path_does_not_lead_out_of_the_folders_that_streams_may_read(tmp_path: Path, source: str) -> None:
    """The address that is opened is the one that is checked."""
    roots = tmp_path / "roots"
    roots.mkdir()
    (tmp_path / "secret.mp4").write_bytes(b"")
    settings = Settings(roots=(roots,))
    for place, allowed in ((source.format(roots), False), (f"file://{roots}/a%20b.mp4", True)):
        rig = {"fps": 30, "cameras": [{"name": "cam0", "source": place}]}
        spec = StreamSpec("clip", job=TrainJob(live=rig))
        if allowed:
            check_reach(spec, settings, EVERYTHING)
        else:
            with pytest.raises(InputError, match=r"live\.cameras\.0\.source"):
                check_reach(spec, settings, EVERYTHING)
