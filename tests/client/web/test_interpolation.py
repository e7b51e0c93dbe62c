"""Pictures between the states of a stream that is played: drawn while it plays, never while it stands or is live."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.render import cpu
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.interpolate import interpolate
from streamlod.core.scene.residual import difference
from tests.client.web.miniserver import Behaviour, Clip, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import WAIT, comes_to_show, picture, psnr, reference, shows

pytestmark = pytest.mark.browser

STATES = 8
STATE_NS = 600_000_000
COUNT_PICTURES = """
window.drawn = new Set();
const draw = WebGL2RenderingContext.prototype.drawElements;
WebGL2RenderingContext.prototype.drawElements = function (...all) {
  draw.apply(this, all);
  if (!drawn) return;
  const { width, height } = this.canvas, pixels = new Uint32Array(width * height);
  this.readPixels(0, 0, width, height, this.RGBA, this.UNSIGNED_BYTE, new Uint8Array(pixels.buffer));
  drawn.add(pixels.reduce((hash, pixel) => Math.imul(hash, 31) + pixel | 0, 0));
};
"""


def slow_recording(folder: Path, states: list[Scene]) -> Path:
    """The states as `slow.slod`, 0.6 s apart; a keyframe where one begins."""
    with SlodWriter(folder / "slow.slod") as writer:
        for number, state in enumerate(states):
            if state.version == state.keyframe:
                writer.append(encode_keyframe(state, time_ns=number * STATE_NS))
            else:
                before = states[number - 1]
                writer.append(encode_residual(before, difference(before, state), time_ns=number * STATE_NS))
    return folder / "slow.slod"


@pytest.fixture(scope="module")
def states() -> list[Scene]:
    """States of a scene in which one knot turns."""
    return make_clip(make_scene(400, view_dependent=False), STATES).states


def picture_between(states: list[Scene], version: int, share: float) -> np.ndarray:
    """What Python draws that much of the way to a version, as the third camera of the rig sees it."""
    before, after = states[version - 1], states[version]
    camera = after.header.cameras[2]
    cloud = interpolate(before, after, share, camera.centre)
    return np.asarray(cpu.render(cloud, camera, after.header.background).image, np.float64)


@pytest.mark.timeout(300)  # a slow machine draws few pictures
def test_a_recording_moves_smoothly_and_stands_at_true_states(
    page: Any, clip: Clip, states: list[Scene], tmp_path: Path
) -> None:
    """More pictures are drawn than there are states, as Python interpolates them; paused, it is a state to the bit."""
    slow_recording(tmp_path, states)
    page.add_init_script(COUNT_PICTURES)
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?src=files/slow.slod&ui=0&quality=high&t=0")
        shows(page, "s.version === 0 && s.phase === 'paused'")
        page.evaluate("streamlod.loop(true); streamlod.play()")  # until enough was drawn, however long that takes
        page.wait_for_function(f"drawn.size > {2 * STATES}", **WAIT)
        page.evaluate("streamlod.loop(false)")
        shows(page, f"s.version === {STATES - 1} && s.phase === 'ended'")
        comes_to_show(page, reference(states[-1], states[-1].header.cameras[2]))

        moments = list(product(range(1, STATES), np.linspace(0, 1, 11)))
        drawn = {moment: picture_between(states, *moment) for moment in moments}
        page.evaluate("drawn = null; streamlod.loop(true); streamlod.play()")  # counting makes pictures slow
        shows(page, "s.version === 1")
        limit, nearest, state = time.monotonic() + 120, 0.0, 0.0
        while nearest < max(35, state + 3):
            assert time.monotonic() < limit, f"{nearest} dB from a moment between states and {state} dB from a state"
            seen = picture(page)
            found = {moment: psnr(drawn[moment], seen) for moment in moments}
            nearest = max(found.values())
            state = max(found[version, share] for version, share in moments if share in (0, 1))

        phase = "ended"
        while phase != "paused":  # the last state, which it ends at, may come before it is told to pause
            page.evaluate("streamlod.play(); streamlod.seek(1)")
            shows(page, "s.version > 1 && s.phase === 'replay'")
            page.evaluate("streamlod.pause()")
            shows(page, "s.phase === 'paused' || s.phase === 'ended'")
            phase = page.evaluate("streamlod.state.phase")
        version = None
        while (now := page.evaluate("streamlod.state.version")) != version:  # what it had decoded may come after that
            version, paused = now, picture(page)
        page.evaluate(f"streamlod.seek({(version + 3) % STATES})")
        shows(page, f"s.version === {(version + 3) % STATES}")
        page.evaluate(f"streamlod.seek({version})")
        shows(page, f"s.version === {version}")
        np.testing.assert_array_equal(picture(page), paused)


def test_a_keyframe_is_switched_to(page: Any, clip: Clip, states: list[Scene], tmp_path: Path) -> None:
    """Rows of another keyframe are other anchors, as many as they may be: there is nothing between them."""
    levels = tuple(replace(level, latent=np.zeros_like(level.latent)) for level in states[-1].levels)
    other = replace(states[-1], levels=levels, keyframe=1, version=1, identifier=1)
    slow_recording(tmp_path, [states[0], other])
    page.add_init_script(COUNT_PICTURES)
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?src=files/slow.slod&ui=0&quality=high&t=0")
        shows(page, "s.version === 0 && s.phase === 'paused'")
        page.evaluate("drawn.clear(); streamlod.play()")  # of what may have come level by level
        shows(page, "s.version === 1 && s.phase === 'ended'")
        assert page.evaluate("drawn.size") <= 2


def test_what_is_live_is_shown_at_once(page: Any, clip: Clip) -> None:
    """No picture waits for the next state: a live stream shows its states and no others."""
    page.add_init_script(COUNT_PICTURES)
    with serving(create_app(clip, Behaviour(fps=3, newest=6))) as url:
        page.goto(f"{url}/?ui=0&quality=high")
        shows(page, "s.version === 6")
        page.wait_for_timeout(500)
        assert page.evaluate("drawn.size") <= 7
