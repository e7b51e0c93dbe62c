"""What tests of the page ask of it: to show, to say, to look like a reference. And what they put into it."""

from __future__ import annotations

import base64
import contextlib
import io
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from PIL import Image

from streamlod.core.camera import Camera, pinhole
from streamlod.core.render import cpu
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand

Found = TypeVar("Found")

WAIT = {"timeout": 90_000}  # milliseconds: for a machine that is busy with other tests as well
CAPTURE = """async () => {
  const bytes = new Uint8Array(await (await streamlod.captureFrame()).arrayBuffer());
  return btoa(Array.from(bytes, (x) => String.fromCharCode(x)).join(""));
}"""
INSPECT = """async () => {
  const state = await streamlod.inspect();
  return state && { ...state, splats: Array.from(new Uint32Array(state.splats.buffer)) };
}"""
KEEP_TOASTS = """
window.toasts = [];
document.addEventListener("DOMContentLoaded", () => {
  const toast = document.getElementById("toast"), note = () => toast.hidden || toasts.push(toast.textContent);
  if (toast) new MutationObserver(note).observe(toast, { attributes: true, childList: true, subtree: true });
});
"""
COUNT_OBJECTS = """
window.objects = {};
for (const name of ["Texture", "Buffer", "Program", "VertexArray", "Shader"]) {
  for (const [verb, step] of [["create", 1], ["delete", -1]]) {
    const old = WebGL2RenderingContext.prototype[verb + name];
    WebGL2RenderingContext.prototype[verb + name] = function (...all) {
      objects[name] = (objects[name] ?? 0) + step;
      return old.apply(this, all);
    };
  }
}
"""


def shows(page: Any, condition: str) -> None:
    """Wait until `condition` over the state `s` holds."""
    try:
        page.wait_for_function(f"() => {{ const s = window.streamlod?.state; return s && ({condition}); }}", **WAIT)
    except Exception as error:
        raise AssertionError(f"never {condition}: {page.evaluate('window.streamlod?.state')}") from error


@contextlib.contextmanager
def meets(page: Any, condition: str) -> Iterator[None]:
    """What is done in the context leads to `condition` over the state `s`, which need not hold for long."""
    page.evaluate(f"""() => {{
      window.met = false;
      const look = () => {{
        const s = streamlod.state;
        if ({condition}) met = true;
        if (met) stops.forEach((stop) => stop());
      }};
      const stops = ["status", "picture"].map((name) => streamlod.on(name, look));
    }}""")
    yield
    try:
        page.wait_for_function("met", **WAIT)
    except Exception as error:
        raise AssertionError(f"never {condition}: {page.evaluate('streamlod.state')}") from error


def said(page: Any, text: str) -> None:
    """Wait until the page has said `text`, in a line that goes away by itself. The page needs KEEP_TOASTS."""
    page.wait_for_function("(text) => toasts.some((toast) => toast.includes(text))", arg=text, **WAIT)


def eventually(look: Callable[[], Found]) -> Found:
    """What `look` returns once its assertions hold, for which it is called again and again for a minute."""
    limit = time.monotonic() + 60
    while True:
        try:
            return look()
        except AssertionError:
            if time.monotonic() > limit:
                raise
        time.sleep(0.1)


def picture(page: Any) -> np.ndarray:
    """[H,W,3] float64 in [0, 1]: what is on the canvas."""
    image = Image.open(io.BytesIO(base64.b64decode(page.evaluate(CAPTURE)))).convert("RGB")
    return np.asarray(image, np.float64) / 255


def reference(scene: Scene, camera: Camera) -> np.ndarray:
    """The CPU rasteriser's picture of the same instant and view, by the rules of all viewers."""
    rendered = cpu.render(expand(scene, camera.centre), camera, scene.header.background)
    return np.asarray(rendered.image, np.float64)


def amid_the_scene(page: Any) -> Camera:
    """A view that no camera of the rig comes near, as large as the page's canvas."""
    height, width, _ = picture(page).shape
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, 0.3, 0.4)
    return pinhole("amid", (1.25 * height, 1.25 * height), (width / 2, height / 2), (width, height), pose)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """In decibels; infinitely many between equal pictures."""
    with np.errstate(divide="ignore"):
        return float(-10 * np.log10(np.mean((a - np.clip(b, 0, 1)) ** 2)))


def comes_to_show(page: Any, expected: np.ndarray) -> None:
    """The page shows that picture, if not at once: its order and colours may still be those of the place before."""

    def look() -> None:
        assert psnr(picture(page), expected) >= 35

    eventually(look)
