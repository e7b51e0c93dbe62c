"""Camera paths: the same ways as the page's, and files that are none are refused."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from streamlod.client.viewpoints import along, read_path
from streamlod.core.errors import InputError
from tests.client.web.miniserver import WEB

FRONT = "0,0,-3,0,0,1,0,1,0,3,1.2,0,0,1"
SIDE = "3,-0.5,0,-1,0.1,0,0,1,0.1,3,1.4,0.01,-0.02,1"
BACK = "0.4,0,3,0.1,0,-1,0,1,0,3.5,1.2,0,0,1.1"
NODE = """
import { readFileSync } from "node:fs";
import { poseAt, checked, fromLink, toLink } from "PATH_JS";
const path = checked(JSON.parse(readFileSync(process.argv[1], "utf8")));
if (JSON.stringify(fromLink(toLink(path))) !== JSON.stringify(path)) throw new Error("a link changes it");
console.log(JSON.stringify([0, 0.7, 1.9, 2, 3.1, 4.9, 5, 7.3].map((t) => poseAt(path, t))));
"""


def _file(folder: Path, keys: object, **more: object) -> Path:
    file = folder / "path.json"
    file.write_text(json.dumps({"version": 1, "name": "a~b_c", "loops": False, "keys": keys, **more}))
    return file


def _keys(*cameras: str) -> list[dict[str, object]]:
    return [
        {"seconds": seconds, "camera": camera, "name": f"view_{seconds}~é"}
        for seconds, camera in zip((0, 2, 5), cameras, strict=False)
    ]


@pytest.mark.parametrize("loops", [False, True])
def test_the_way_is_that_of_the_page(tmp_path: Path, loops: bool) -> None:
    """Between, at, before and after viewpoints: rotation and position of page and Python agree; at each it is there."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    file = _file(tmp_path, _keys(FRONT, SIDE, BACK), loops=loops)
    script = NODE.replace("PATH_JS", (WEB / "view" / "path.js").as_uri())
    done = subprocess.run(
        [node, "--input-type=module", "-e", script, str(file)], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    path = read_path(file)
    for seconds, pose in zip((0, 0.7, 1.9, 2, 3.1, 4.9, 5, 7.3), json.loads(done.stdout), strict=True):
        camera = path.at(seconds, (320, 200))
        np.testing.assert_allclose(camera.world_to_camera[:3, :3].ravel(), pose["rotation"], atol=1e-9)
        np.testing.assert_allclose(camera.centre, pose["position"], atol=1e-9)
        assert camera.intrinsics[1, 1] == pytest.approx(pose["focal"] * 200)
    np.testing.assert_allclose(path.at(2, (320, 200)).centre, [3, -0.5, 0], atol=1e-12)
    assert along(path, (320, 200), 10)(20).centre[0] == pytest.approx(3)


@pytest.mark.parametrize(
    ("keys", "fault"),
    [
        ([], "no camera path"), ("x", "no camera path"), ([1], "viewpoint 1 has no camera"),
        ([{"seconds": 0, "camera": "1,2"}], "viewpoint 1 has no camera"),
        ([{"seconds": 0, "camera": FRONT.replace("3", "nan", 1)}], "viewpoint 1 has no camera"),
        (_keys(FRONT, ",".join(["0"] * 14)), "viewpoint 2 has no camera"),
        ([*_keys(FRONT), *_keys(SIDE)], "viewpoint 2: its time"), ([{"seconds": True, "camera": FRONT}], "its time"),
        ([{"seconds": 1e9, "camera": FRONT}], "its time"), (_keys(FRONT) * 65, "no camera path"),
    ],
)  # fmt: skip
def test_what_is_no_path_is_refused(tmp_path: Path, keys: object, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        read_path(_file(tmp_path, keys))


def test_a_path_of_another_version_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no camera path"):
        read_path(_file(tmp_path, _keys(FRONT), version=2))
