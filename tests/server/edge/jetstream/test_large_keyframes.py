"""Refresh keyframes of 300 KB and more by way of NATS, to a viewer that decodes and a thin one."""

from __future__ import annotations

from pathlib import Path

from streamlod.server.pipeline.spec import StreamSpec
from tests.server.conftest import running
from tests.server.edge.jetstream.nats_servers import nats, needs_nats
from tests.server.edge.test_large_keyframes import watch_large
from tests.server.large_clip import make_large_clip

pytestmark = needs_nats


def test_a_node_passes_them_on(tmp_path: Path) -> None:
    clip = make_large_clip(tmp_path)
    with (
        nats(tmp_path / "nats") as shared,
        running(shared.settings(), StreamSpec(play=clip.path)) as origin,
        running(shared.settings()) as other,
    ):
        origin.wait(lambda stream: stream["state"] == "live")
        watch_large(other, clip)
