"""The page's modules outside a browser: types, unit tests, conformance vectors, agreement with the Python decoder."""

from __future__ import annotations

import gzip
import itertools
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.gaps import MAX_GAP_SECONDS
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.residual import difference
from tests.client.web.miniserver import WEB, make_clip
from tests.client.web.scenes import make_scene
from tests.codec import scenes as codec_scenes

HERE = Path(__file__).parent
EYE = np.array([0.3, -0.2, -2.0])


@pytest.mark.parametrize("name", ["modules", "viewer", pytest.param("vectors", marks=pytest.mark.long)])
def test_node(node: str, name: str) -> None:
    """The tests written in JavaScript."""
    done = subprocess.run(
        [node, "--test", f"{name}.test.mjs"], cwd=HERE, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]


@pytest.mark.long
def test_types() -> None:
    """JSDoc types, strictly."""
    compiler = HERE / "node_modules" / ".bin" / "tsc"
    types = HERE / "node_modules" / "@types" / "webxr"
    if not (compiler.exists() and types.exists()) or shutil.which("node") is None:
        pytest.skip("the TypeScript compiler is not installed: npm install --prefix tests/client/web")
    done = subprocess.run(
        [str(compiler), "--project", "tsconfig.json"],
        cwd=HERE,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_modules_are_formatted() -> None:
    """As prettier writes them: `npx prettier --write client/web` of the packages in tests/client/web."""
    formatter = HERE / "node_modules" / ".bin" / "prettier"
    if not formatter.exists() or shutil.which("node") is None:
        pytest.skip("prettier is not installed: npm install --prefix tests/client/web")
    command = [str(formatter), "--check", "**/*.js"]
    done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr


def test_a_phones_page_is_small_and_nothing_comes_from_elsewhere(kernel: bytes) -> None:
    """What a viewer loads is weighed as it is served, in test_built.py."""
    files = {path.name: path.read_bytes() for path in WEB.rglob("*.*") if path.suffix not in (".wat", ".py", ".pyc")}
    phone = {"capture.html", "base.css", "capture.css", "favicon.svg"} | _reached("ui/capture.js")
    assert sum(len(gzip.compress((WEB / name).read_bytes())) for name in phone) < 20_000
    for name, content in files.items():
        if not name.endswith(".wasm"):
            text = content.decode().replace("http://www.w3.org/2000/svg", "")
            assert "http://" not in text, name
            assert "https://" not in text, name
            assert "node_modules" not in text, name


def _imports(name: str) -> list[str]:
    """Modules that a module imports at once, as paths inside the page's folder."""
    found = re.findall(r'^import .*?from "(.+?)"', (WEB / name).read_text(), re.MULTILINE | re.DOTALL)
    return [(WEB / name).parent.joinpath(path).resolve().relative_to(WEB).as_posix() for path in found]


def _reached(*names: str) -> set[str]:
    """These modules and all that they import at once, however indirectly."""
    found: set[str] = set()
    left = list(names)
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += _imports(name)
    return found


def test_modules_import_downwards() -> None:
    """decode knows no socket, stream no picture, lib no canvas, view no button; types in comments count too."""
    layers = ["decode", "stream", "lib", "view", "ui"]
    for path in WEB.glob("*/*.js"):
        mine = layers.index(path.parent.name)
        for other in re.findall(r'"\.\./([a-z]+)/[a-z]+\.js"', path.read_text()):
            assert layers.index(other) < mine, f"{path.name} imports from {other}"


@pytest.mark.parametrize(
    ("name", "main"),
    [("index.html", "ui/main.js"), ("capture.html", "ui/capture.js"), ("cameras.html", "ui/cameras.js")],
)
def test_page_preloads_what_its_main_module_does_not_import_itself(name: str, main: str) -> None:
    """No chain of round trips, and few requests at once.

    Where the server's certificate is of its own making, Chromium gives each new connection's fault to the most urgent
    file, the style sheet, which fails (ERR_TOO_MANY_RETRIES) after 32: beside 33 announced modules it did.
    """
    announced = re.findall(r'modulepreload" href="(.+?)"', (WEB / name).read_text())
    assert sorted(announced) == sorted(_reached(main) - {main} - set(_imports(main)))
    assert len(announced) < 16


def test_the_page_passes_over_gaps_as_python_does() -> None:
    """The page can be served by anything, so that it holds a copy of the figure."""
    (held,) = re.findall(r"MAX_GAP_MS = ([\d_]+)", (WEB / "stream" / "recording.js").read_text())
    assert int(held) == 1000 * MAX_GAP_SECONDS


def _walk(first: Scene, profile: int) -> tuple[list[Scene], list[bytes]]:
    states = make_clip(first, 4).states if len(first.levels[0].feature[0]) == 12 else [first]
    if len(states) == 1:
        for index in range(3):
            states.append((codec_scenes.grow if index == 1 else codec_scenes.move)(states[-1], index))
    packets = [encode_keyframe(first, time_ns=0, profile=profile)]
    for before, after in itertools.pairwise(states):
        change = difference(before, after)
        packets.append(encode_residual(before, change, time_ns=1, profile=profile))
    return states, packets


@pytest.mark.parametrize("profile", [0, 1])
@pytest.mark.parametrize("kind", ["grown", "view dependent", "plain"])
def test_same_state_and_splats_as_python(node: str, tmp_path: Path, kind: str, profile: int) -> None:
    """After every packet the digests are Python's; the splats are those of core.expand."""
    first = codec_scenes.make_scene() if kind == "grown" else make_scene(300, kind == "view dependent")
    states, packets = _walk(first, profile)
    file, out = tmp_path / "clip.slod", tmp_path / "out"
    with SlodWriter(file) as writer:
        for packet in packets:
            writer.append(packet)
    command = [node, str(HERE / "decode.mjs"), str(file), str(out), *map(str, EYE), "16"]
    subprocess.run(command, check=True, timeout=60)
    log = json.loads(out.with_suffix(".json").read_text())
    assert [entry["digests"] for entry in log] == [[level.digest() for level in state.levels] for state in states]
    assert_same_splats(np.fromfile(out.with_suffix(".bin"), np.float32).reshape(-1, 12), states[-1], EYE)


@pytest.mark.parametrize("bias", [-1.0, 0.0])
@pytest.mark.parametrize("step", [0.1, 1e9])
def test_the_same_gaussians_exist_as_in_python(node: str, tmp_path: Path, bias: float, step: float) -> None:
    """With quaternions that are 0, and features so large that quaternions say nothing, both draw the same, or none."""
    scene = codec_scenes.make_scene((5, 20), slots=2, features=3)
    matrix, output = scene.weights.output_weight.copy(), np.ones(22, np.float32)
    if bias:
        matrix[:, 14:18] = 0
    output[14:18] = (bias, 0, 0, 0)
    weights = replace(scene.weights, output_weight=matrix, output_bias=output)
    header = replace(scene.header, feature_steps=np.full(3, step, np.float32))
    scene = replace(scene, header=header, weights=weights)
    file, out = tmp_path / "scene.slod", tmp_path / "out"
    with SlodWriter(file) as writer:
        writer.append(encode_keyframe(scene, time_ns=0))
    subprocess.run([node, str(HERE / "decode.mjs"), str(file), str(out), *map(str, EYE), "16"], check=True, timeout=60)
    found = np.fromfile(out.with_suffix(".bin"), np.float32).reshape(-1, 12)
    shown = expand(scene, EYE)
    assert len(found) == (shown.opacities >= 1 / 255).sum()
    assert np.isfinite(found[:, :10]).all()
    assert (len(found) < 2 * scene.anchor_count) == (bias != 0 or step > 1)


def assert_same_splats(found: np.ndarray, scene: Scene, eye: np.ndarray) -> None:
    """Records of the page (mean, opacity, covariance, packed colour) against the reference expansion."""
    cloud = expand(scene, eye)
    shown = cloud.opacities >= 1 / 255
    assert len(found) == shown.sum()
    np.testing.assert_allclose(found[:, :3], cloud.means[shown], atol=1e-5)
    np.testing.assert_allclose(found[:, 3], cloud.opacities[shown], atol=1e-5)
    w, x, y, z = (cloud.quaternions[shown] / np.linalg.norm(cloud.quaternions[shown], axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    axes = np.stack([np.stack(row, axis=-1) for row in rows], axis=1) * cloud.scales[shown][:, None, :]
    covariance = axes @ axes.transpose(0, 2, 1)
    upper = covariance[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    size = np.trace(covariance, axis1=1, axis2=2)[:, None]
    np.testing.assert_allclose(found[:, 4:10] / size, upper / size, atol=1e-4)
    colour = np.ascontiguousarray(found[:, 10:]).view(np.uint16).reshape(-1, 4)[:, :3] / 65535
    np.testing.assert_allclose(colour, cloud.colours[shown], atol=1e-4)
