"""An independent judge of the picture: the same instant, exported and shown by Spark on three.js. `pytest -m slow`."""

from __future__ import annotations

import base64
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.staticfiles import StaticFiles
from PIL import Image
from starlette.routing import Mount

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.camera import Camera
from tests.client.web.miniserver import Behaviour, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import picture, psnr, shows

pytestmark = [pytest.mark.slow, pytest.mark.browser]

PACKAGES = Path(__file__).parent / "node_modules"
HOST = """<!doctype html><link rel=icon href=/favicon.svg><body style="margin:0"><script type=importmap>{"imports": {
"three": "/packages/three/build/three.module.js",
"three/addons/": "/packages/three/examples/jsm/",
"@sparkjsdev/spark": "/packages/@sparkjsdev/spark/dist/spark.module.min.js"
}}</script>"""
SHOW = """async ({ address, width, height, focal, principal, worldToCamera, background }) => {
  const THREE = await import("three"), { SparkRenderer, SplatMesh } = await import("@sparkjsdev/spark");
  const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
  renderer.setPixelRatio(1);
  renderer.setSize(width, height);
  document.body.append(renderer.domElement);
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera();
  scene.background = new THREE.Color().setRGB(...background, THREE.SRGBColorSpace);
  // The same pinhole for three.js: y up, z towards the viewer.
  const near = 0.05, far = 100, [fx, fy] = focal, [cx, cy] = principal;
  camera.projectionMatrix.set(
    2 * fx / width, 0, 1 - 2 * cx / width, 0,
    0, 2 * fy / height, 2 * cy / height - 1, 0,
    0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
    0, 0, -1, 0);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  const flip = new THREE.Matrix4().makeScale(1, -1, -1), view = new THREE.Matrix4().set(...worldToCamera);
  new THREE.Matrix4().multiplyMatrices(flip, view).invert().decompose(camera.position, camera.quaternion, camera.scale);
  const cuts = { maxStdDev: Math.sqrt(2 * Math.log(255)), minAlpha: 1 / 255 };
  const lowPass = { preBlurAmount: 0.1, blurAmount: 0 };
  const spark = new SparkRenderer({ renderer, sortRadial: false, ...cuts, ...lowPass });
  const mesh = new SplatMesh({ url: address });
  if (address.endsWith(".spz")) mesh.quaternion.set(1, 0, 0, 0); // its axes are right, up, back
  scene.add(spark, mesh);
  await mesh.initialized;
  for (let i = 0; i < 12; i++) { // it sorts in a worker, now and then
    renderer.render(scene, camera);
    await new Promise((resolve) => setTimeout(resolve, 150));
  }
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL();
}"""


def in_spark(page: Any, url: str, name: str, camera: Camera, background: np.ndarray) -> np.ndarray:
    """[H,W,3] in [0, 1]: the file `name` as Spark shows it to `camera`."""
    page.goto(f"{url}/files/host.html")
    k = camera.intrinsics
    facts = {
        "address": f"{url}/files/{name}",
        "width": camera.width,
        "height": camera.height,
        "focal": [k[0, 0], k[1, 1]],
        "principal": [k[0, 2], k[1, 2]],
        "worldToCamera": camera.world_to_camera.ravel().tolist(),
        "background": [float(x) for x in background],
    }
    shown = page.evaluate(SHOW, facts).partition(",")[2]
    image = Image.open(io.BytesIO(base64.b64decode(shown))).convert("RGB")
    return np.asarray(image, np.float64) / 255


@pytest.mark.parametrize("kind", ["ply", "spz"])
def test_spark_shows_the_same(page: Any, tmp_path: Path, kind: str) -> None:
    """The page's picture of a stream and Spark's of the exported snapshot agree."""
    if not (PACKAGES / "@sparkjsdev").exists():
        pytest.skip("Spark is not installed: npm install --prefix tests/client/web")
    scene = make_scene(1250, view_dependent=False)
    file = tmp_path / "scene.slod"
    with SlodWriter(file) as writer:
        writer.append(encode_keyframe(scene, time_ns=0))
    command = [sys.executable, "-m", "streamlod.server.cli", "export", str(file), "--format", kind]
    subprocess.run([*command, "--out", str(tmp_path / f"scene.{kind}")], check=True, timeout=60)
    (tmp_path / "host.html").write_text(HOST)
    app = create_app(make_clip(make_scene(10), 2), Behaviour(), tmp_path)
    app.router.routes.insert(0, Mount("/packages", StaticFiles(directory=PACKAGES)))
    with serving(app) as url:
        for number in (0, 2):
            camera = scene.header.cameras[number]
            page.goto(f"{url}/?ui=0&quality=high&src=files/scene.slod")
            shows(page, "s.version === 0")
            page.evaluate(f"streamlod.setCamera({number})")
            page.wait_for_timeout(400)
            ours = picture(page)
            theirs = in_spark(page, url, f"scene.{kind}", camera, scene.header.background)
            assert psnr(ours, theirs) >= 35, number
