"""The JavaScript package for other programs: under node and in Chromium, the Gaussians that Python has."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.core.scene.expand import expand
from tests.client.web.miniserver import WEB, Behaviour, Clip, create_app, serving
from tests.client.web.test_modules import assert_same_splats

HERE = Path(__file__).parent
FRAME = 0.033333333  # seconds


def _records(told: dict[str, Any]) -> np.ndarray:
    """[N,12] as the page packs them."""
    colours = np.zeros((len(told["colors"]), 4), np.uint16)
    colours[:, :3] = np.round(np.array(told["colors"]) * 65535)
    parts = [np.array(told["positions"]), np.array(told["opacities"])[:, None], np.array(told["covariances"])]
    return np.hstack([np.hstack(parts).astype(np.float32), colours.view(np.float32)])


def test_node_reads_what_python_reads(node: str, clip: Clip, recording: Path) -> None:
    """Forward, back, beyond the end, over HTTP: versions, Gaussians, what changed; scales and rotations are right."""
    with serving(create_app(clip, Behaviour(), recording.parent)) as url:
        times = [0, FRAME * 3.5, FRAME * 4, FRAME, 99]
        done = subprocess.run(
            [node, "library.mjs", f"{url}/files/clip.slod", *map(str, times)],
            cwd=HERE, capture_output=True, text=True, timeout=100, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    *frames, facts = map(json.loads, done.stdout.splitlines())
    assert [frame["version"] for frame in frames] == [0, 3, 4, 1, len(clip.states) - 1]
    eye = np.mean([camera.centre for camera in clip.states[0].header.cameras], axis=0)
    for frame in frames:
        assert_same_splats(_records(frame), clip.states[frame["version"]], eye)
        assert frame["worst"] < 1e-4
    assert [frame["isNew"] for frame in frames] == [False, False, False, True, False], "back is from the keyframe on"
    assert frames[0]["changed"] == 0, "open has shown the first frame already"
    assert facts["frames"] == len(clip.states)
    assert facts["duration"] == pytest.approx((len(clip.states) - 1) * FRAME, abs=1e-3)
    assert facts["cameras"] == len(clip.states[0].header.cameras)


IN_PAGE = """async () => {
  const { open } = await import("/lib/streamlod.js");
  const clip = await open("/files/clip.slod"), late = await clip.frame(0.2), early = await clip.frame(0);
  const live = await open("/v1/streams/main/live"), first = (await live.frame()).version;
  const versions = [];
  const until = (look) => new Promise((resolve) =>
    live.addEventListener("frame", ({ detail }) => look(detail) && resolve(detail)));
  live.seek({ epoch: 1, version: 2 });
  const sought = await until(({ version }) => version === 2);
  const positions = Array.from(sought.positions.subarray(0, 3)), cameras = live.scene.cameras.length;
  await until(({ version }) => versions.push(version) > 5);
  live.close();
  const fault = await open("/files/none.slod").then(() => "", (error) => error.message);
  return { late: late.version, early: early.version, first, versions, positions, cameras, fault };
}"""


@pytest.mark.browser
def test_chromium_reads_files_and_live_streams(page: Any, clip: Clip, recording: Path) -> None:
    """Without the page around it: frames of a file, then those of a stream as they come, and a place in its past."""
    (recording.parent / "blank.html").write_text("<!doctype html><link rel=icon href=/favicon.svg>")
    with serving(create_app(clip, Behaviour(fps=10), recording.parent)) as url:
        page.goto(f"{url}/files/blank.html")
        found = page.evaluate(IN_PAGE)
    assert (found["late"], found["early"]) == (6, 0)
    assert found["versions"] == sorted(found["versions"])
    assert found["versions"][0] > 2
    assert found["first"] >= 0
    eye = np.mean([camera.centre for camera in clip.states[0].header.cameras], axis=0)
    cloud = expand(clip.states[2], eye)
    if cloud.opacities[0] >= 1 / 255:
        np.testing.assert_allclose(found["positions"], cloud.means[0], atol=1e-5)
    assert "404" in found["fault"]
    page.complaints.forgive("404")


@pytest.mark.long
@pytest.mark.timeout(600)  # two runs of the compiler, over the types of three engines
def test_the_package_brings_types(tmp_path: Path) -> None:
    """Made by its own command, in a folder as npm makes one: programs in TypeScript compile against them, also those
    that hand frames to the adapters; each fault is found."""
    packages = HERE / "node_modules"
    if not all((packages / name).exists() for name in (".bin/tsc", "playcanvas", "three")) or not shutil.which("node"):
        pytest.skip("the TypeScript compiler is not installed: npm install --prefix tests/client/web")

    def compile_with(*options: str) -> subprocess.CompletedProcess[str]:
        command = [str(packages / ".bin" / "tsc"), *options]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    package = tmp_path / "node_modules" / "streamlod"
    (package / "lib").mkdir(parents=True)
    for name in ("@sparkjsdev", "@types", "playcanvas", "three"):
        (tmp_path / "node_modules" / name).symlink_to(packages / name)
    for file in (WEB / "package.json", *(WEB / "lib").glob("*.d.ts")):
        shutil.copy(file, package / file.relative_to(WEB))
    made = compile_with("--project", str(WEB), "--outDir", str(package / "types"))
    assert made.returncode == 0, made.stdout
    use = 'import { follow, open, type Frame } from "streamlod";\nconst clip = await open("a.slod");\n'
    use += 'if ("times" in clip) { const f: Frame = await clip.frame(1); f.count; }\n'
    for name, new in (("spark", "()"), ("three", "()"), ("playcanvas", "(null!, null!)")):
        use += f'import {{ StreamlodSplats as {name} }} from "streamlod/{name}";\n'
        use += f"{{ const splats = new {name}{new}; follow(clip, (frame) => splats.take(frame)); }}\n"
    options = ["--noEmit", "--strict", "--skipLibCheck", "--target", "ES2022", "--module", "ES2022"]
    faults = "if ('times' in clip) clip.frame('soon');\nnew three().take(1);\n"
    (tmp_path / "right.ts").write_text(use)
    (tmp_path / "wrong.ts").write_text(use + faults)
    done = compile_with(*options, "--moduleResolution", "bundler", "right.ts", "wrong.ts")
    errors = [line for line in done.stdout.splitlines() if "error TS" in line]
    assert len(errors) == 2, done.stdout
    assert all(line.startswith("wrong.ts") for line in errors)
