"""The page in a headset: an emulated one (iwer), which speaks the real WebXR interface in a real Chromium."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.core.camera import Camera, pinhole
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import WAIT, comes_to_show, eventually, picture, psnr, reference, shows

pytestmark = pytest.mark.browser

IWER = Path(__file__).parent / "node_modules" / "iwer" / "build" / "iwer.min.js"
PUT_ON = """
window.headset = new IWER.XRDevice(IWER.metaQuest3, { stereoEnabled: true, ipd: 0.064 });
headset.installRuntime({ forceInstall: true });
const { requestSession } = navigator.xr;
navigator.xr.requestSession = async function (...all) {
  const session = (window.session = await requestSession.apply(this, all));
  const { requestReferenceSpace, requestAnimationFrame } = session;
  session.requestReferenceSpace = async (kind) => (window.space = await requestReferenceSpace.call(session, kind));
  session.requestAnimationFrame = (callback) => requestAnimationFrame.call(session, (time, frame) => {
    callback(time, frame);
    window.ticks = (window.ticks ?? 0) + 1;
    if (!window.look) return;
    const gl = document.getElementById("canvas").getContext("webgl2"), { baseLayer } = session.renderState;
    const found = frame.getViewerPose(space).views.map((eye) => {
      const { x, y, width, height } = baseLayer.getViewport(eye);
      const pixels = new Uint8Array(4 * width * height);
      gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      const text = btoa(Array.from(pixels, (v) => String.fromCharCode(v)).join(""));
      return { width, height, projection: [...eye.projectionMatrix], matrix: [...eye.transform.matrix], pixels: text };
    });
    window.look(found);
    window.look = null;
  });
  return session;
};
"""
COUNT_FENCES = """
window.fences = 0;
const { fenceSync, deleteSync } = WebGL2RenderingContext.prototype;
WebGL2RenderingContext.prototype.fenceSync = function (...all) {
  fences++;
  return fenceSync.apply(this, all);
};
WebGL2RenderingContext.prototype.deleteSync = function (fence) {
  fences--;
  return deleteSync.call(this, fence);
};
"""
LOOK = "new Promise((resolve) => (window.look = resolve))"


def eye_camera(eye: dict[str, Any], stand: np.ndarray) -> Camera:
    """A view of WebXR as our camera. `stand` [4,4]: XR space to the scene, metres to world units included."""
    matrix = np.array(eye["matrix"]).reshape(4, 4).T
    projection = np.array(eye["projection"]).reshape(4, 4).T
    width, height = eye["width"], eye["height"]
    focal = (projection[0, 0] * width / 2, projection[1, 1] * height / 2)
    centre = ((1 - projection[0, 2]) * width / 2, (1 + projection[1, 2]) * height / 2)
    scale = np.cbrt(np.linalg.det(stand[:3, :3]))
    rotation = (stand[:3, :3] / scale) @ matrix[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # camera to world
    position = (stand @ matrix[:, 3])[:3]
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ position
    return pinhole("eye", focal, centre, (width, height), world_to_camera)


def pixels_of(eye: dict[str, Any]) -> np.ndarray:
    """[H,W,3] in [0, 1], upright."""
    rows = np.frombuffer(base64.b64decode(eye["pixels"]), np.uint8).reshape(eye["height"], eye["width"], 4)
    return rows[::-1, :, :3] / 255


def put_on(page: Any) -> None:
    """Give the page a headset when it loads."""
    if not IWER.exists():
        pytest.skip("iwer is not installed: npm install --prefix tests/client/web")
    page.add_init_script(path=IWER)
    page.add_init_script(PUT_ON)


def test_fences_of_a_headsets_pictures_do_not_pile_up(page: Any, clip: Clip) -> None:
    """Nobody asks how many of them are being drawn."""
    put_on(page)
    page.add_init_script(COUNT_FENCES)
    with serving(create_app(clip, Behaviour(newest=4))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 4")
        page.focus("#b-more")  # or it may hide
        page.click("#b-more")
        page.click("#b-vr")
        page.wait_for_function("window.ticks > 20", **WAIT)
        assert 0 < page.evaluate("fences") <= 3
        page.evaluate("session.end()")
        page.wait_for_function("document.getElementById('canvas').width === 320", **WAIT)


def test_both_eyes_see_the_scene(page: Any, clip: Clip) -> None:
    """Each eye's picture is that of the reference renderer; sticks walk and turn; leaving gives the page back."""
    put_on(page)
    page.set_viewport_size({"width": 480, "height": 240})
    with serving(create_app(clip, Behaviour(newest=4))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 4")
        page.evaluate("streamlod.setCamera(2)")
        pose = page.evaluate("import('/view/camera.js').then((m) => m.fromText(streamlod.state.camera))")
        page.focus("#b-more")  # or it may hide
        page.click("#b-more")  # the tools of a small page are a sheet
        page.click("#b-vr")
        page.wait_for_function("window.ticks > 3", **WAIT)
        scene = clip.states[4]
        # Upright where the page stood: the viewer's target is two metres away, up is the rig's.
        up = -np.sum([camera.world_to_camera[1, :3] for camera in scene.header.cameras], axis=0)
        up /= np.linalg.norm(up)
        ahead = np.array(pose["rotation"][6:9])
        ahead = ahead - up * (ahead @ up)
        ahead /= np.linalg.norm(ahead)
        stand = np.eye(4)
        stand[:3, :3] = np.stack([np.cross(-up, ahead), up, -ahead], axis=1) * pose["distance"] / 2
        stand[:3, 3] = pose["position"]
        eyes = page.evaluate(LOOK)
        assert len(eyes) == 2
        cameras = [eye_camera(eye, stand) for eye in eyes]
        gap = np.linalg.norm(cameras[0].centre - cameras[1].centre)
        assert gap == pytest.approx(0.064 * pose["distance"] / 2, rel=1e-3)
        wanted = [reference(scene, camera) for camera in cameras]

        def sees() -> np.ndarray:
            left, right = (pixels_of(eye) for eye in page.evaluate(LOOK))
            assert psnr(left, wanted[0]) >= 33  # splats are those of the middle of the head
            assert psnr(right, wanted[1]) >= 33
            return left

        before = eventually(sees)
        assert psnr(before, wanted[1]) < 30

        def sees_something_else() -> None:
            assert psnr(pixels_of(page.evaluate(LOOK)[0]), before) < 25

        page.evaluate("headset.controllers.left.updateAxes('thumbstick', 0, -1)")
        eventually(sees_something_else)
        page.evaluate("headset.controllers.left.updateAxes('thumbstick', 0, 0)")
        before = pixels_of(page.evaluate(LOOK)[0])
        page.evaluate("headset.controllers.right.updateAxes('thumbstick', 1, 0)")
        eventually(sees_something_else)
        page.evaluate("session.end()")
        page.keyboard.press(".")
        page.wait_for_function("!document.getElementById('b-vr').hidden", **WAIT)
        camera = page.evaluate("streamlod.state.camera")
        page.keyboard.press("+")
        page.wait_for_function("(before) => streamlod.state.camera !== before", arg=camera, **WAIT)


def test_the_room_shows_around_the_scene(page: Any, clip: Clip) -> None:
    """Pass-through: what no splat covers is left out (the emulated headset draws without alpha)."""
    put_on(page)
    page.set_viewport_size({"width": 900, "height": 450})
    with serving(create_app(clip, Behaviour(newest=4))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version === 4")
        page.click("#b-ar")
        page.wait_for_function("window.ticks > 3", **WAIT)
        assert page.evaluate("session.environmentBlendMode") == "alpha-blend"
        colours = pixels_of(page.evaluate(LOOK)[0])
        assert (colours.max(axis=2) == 0).mean() > 0.2, "the room: not the scene's background"
        assert (colours.max(axis=2) > 0.3).mean() > 0.01, "the scene in it"
        page.evaluate("session.end()")


def test_webgpu_gives_way_to_a_headset(page_webgpu: Any, clip: Clip) -> None:
    """Headsets take pictures of WebGL2, which draws the page from then on."""
    page = page_webgpu
    put_on(page)
    page.set_viewport_size({"width": 900, "height": 450})
    with serving(create_app(clip, Behaviour(newest=4))) as url:
        page.goto(f"{url}/?quality=high&webgpu=1")
        shows(page, "s.version === 4")
        page.locator(".surface").wait_for(**WAIT)
        before = picture(page)
        page.click("#b-ar")
        page.wait_for_function("window.ticks > 3", **WAIT)

        def sees() -> None:
            assert (pixels_of(page.evaluate(LOOK)[0]).max(axis=2) > 0.3).mean() > 0.01

        eventually(sees)
        assert page.locator(".surface").count() == 0
        page.evaluate("session.end()")
        comes_to_show(page, before)
