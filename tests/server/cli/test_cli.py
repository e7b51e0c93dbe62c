"""The command line, as a user starts it."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.packet.packet import PacketKind
from streamlod.server.cli import main as cli
from tests.client.clips import states, write_clip
from tests.core.data.writers import llff_rows, rig, write_video_clip

COMMANDS = (
    "synth rig calibrate check train evaluate study tradeoff serve edge push view remote info export import demo bench"
    " doctor version warm"
)


Run = Callable[..., subprocess.CompletedProcess[str]]


def streamlod(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command to its end."""
    command = [sys.executable, "-m", "streamlod.server.cli", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=100, check=False, env={**os.environ, **environment}
    )


def assert_refused(done: subprocess.CompletedProcess[str], *parts: object) -> None:
    """One sentence that holds `parts`, exit code 2, no traceback."""
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    sentences = [line for line in done.stderr.splitlines() if line.startswith("streamlod: ")]
    assert len(sentences) == 1, done.stderr
    for part in parts:
        assert str(part) in sentences[0]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Runs the command in this process, which saves the imports."""
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(cli, "_configure_logging", lambda verbose: None)

    def call(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = ["streamlod", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", command)
        capsys.readouterr()
        with pytest.raises(SystemExit) as caught:
            cli.main()
        return subprocess.CompletedProcess(command, int(caught.value.code or 0), *capsys.readouterr())

    yield call
    signal.signal(signal.SIGTERM, before)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A data set in the N3DV layout."""
    (tmp_path / "clip").mkdir()
    write_video_clip(tmp_path / "clip", ["cam00", "cam01", "cam03"], 3)
    return tmp_path / "clip"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A recorded file."""
    write_clip(tmp_path / "a.slod", states(4))
    return tmp_path / "a.slod"


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    begin = time.perf_counter()
    done = streamlod("--help")
    with capsys.disabled():
        sys.stdout.write(f" [--help took {time.perf_counter() - begin:.2f} s] ")
    assert done.returncode == 0
    assert re.findall(r"^  ([a-z]+)  ", done.stdout, re.MULTILINE) == COMMANDS.split()


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("synth", "--cameras --frames --size --seed"),
        (
            "train",
            "--out --views --train --test --frames --downscale --preset --device --seed --json --trace",
        ),
        ("evaluate", "--test --json --save-images"),
        ("serve", "--data --play --host --port --device"),
        ("view", "--camera --orbit --pose --out --frames --fps"),
        ("export", "--frame --view --format --sequence"),
    ],
)
def test_the_contract_of_options(run: Run, command: str, options: str) -> None:
    shown = run(command, "--help").stdout
    for option in options.split():
        assert re.search(rf"^ +(-\w, )?{option}\b", shown, re.MULTILINE), option


@pytest.mark.parametrize(
    "arguments",
    [
        ("evaluate", "x", "y", "--test", "z", "--layout", "pile"),
        ("evaluate", "x", "y", "--downscale", "0"),
        ("train",),
        ("fly",),
        ("train", "x", "--out", "y", "--device", "tpu"),
        ("train", "x", "--out", "y", "--preset", "wild"),
        ("serve", "--synthetic", "cameras"),
        ("synth", "x", "--frames", "many"),
    ],
)
def test_wrong_usage_exits_with_2(run: Run, arguments: tuple[str, ...]) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert "Error" in done.stderr
    assert "Traceback" not in done.stderr


def test_missing_inputs_are_named(run: Run, tmp_path: Path, scene: Path) -> None:
    nowhere, empty = tmp_path / "nowhere", tmp_path / "empty"
    empty.mkdir()
    assert_refused(run("train", nowhere, "--out", tmp_path / "o.slod"), nowhere, "does not exist")
    assert_refused(run("train", empty, "--out", tmp_path / "o.slod"), empty, "empty")
    assert_refused(run("evaluate", scene, nowhere, "--test", "cam00"), nowhere)
    assert_refused(run("info", nowhere), nowhere)
    assert_refused(run("serve", "--play", nowhere), nowhere, "does not exist")
    assert_refused(run("serve", "--host", "0.0.0.0", "--port", 0), "insecure")
    assert_refused(run("export", scene, "--frame", 9), scene, "frames 0 to 3")
    assert_refused(run("synth", empty, "--size", "12"), "WIDTHxHEIGHT")
    assert not (tmp_path / "o.slod").exists()


def test_a_recording_of_which_nothing_can_be_streamed_is_named_before_a_server_starts(
    run: Run, tmp_path: Path, scene: Path
) -> None:
    headless, empty, settings = tmp_path / "headless.slod", tmp_path / "empty.slod", tmp_path / "settings.toml"
    with SlodReader(scene) as reader, SlodWriter(headless) as writer:
        for number, entry in enumerate(reader.entries):
            if entry.kind is not PacketKind.KEY:
                writer.append(reader.read(number))
    SlodWriter(empty).close()
    assert_refused(run("serve", "--play", headless, "--port", 0), headless, "no keyframe")
    assert_refused(run("serve", "--play", empty, "--port", 0), empty, "no packet")
    settings.write_text(f"[[streams]]\nid = 'main'\nplay = '{headless}'\n")
    assert_refused(run("serve", "--config", settings, "--port", 0), headless, "no keyframe")


def test_unusable_rigs_are_named_before_a_server_starts(run: Run, tmp_path: Path, clip: Path) -> None:
    rig = tmp_path / "rig.json"
    assert_refused(run("serve", "--live", rig), "rig.json", "does not exist")
    rig.write_text('{"fps": 0, "cameras": []}')
    assert_refused(run("serve", "--live", rig), "rig.json", "fps")
    cameras = [{"name": f"cam0{n}", "source": "push:"} for n in (0, 1, 3)]
    rig.write_text(json.dumps({"fps": 30, "calibration": str(clip), "cameras": cameras}))
    assert_refused(run("serve", "--live", rig, "--train", "cam09"), "cam09")
    assert_refused(run("serve", "--live", rig, "--views", 9), "9")
    assert_refused(run("serve", "--live", rig, "--play", clip), "name one source")
    assert_refused(run("push", "ws://127.0.0.1:1/v1/streams/main/ingest", "a=nothing.mp4"), "nothing.mp4")


def test_damaged_data_sets_are_named(run: Run, tmp_path: Path, clip: Path) -> None:
    out, poses = tmp_path / "o.slod", clip / "poses_bounds.npy"
    good = llff_rows(rig(["cam00", "cam01", "cam03"]))
    zero_focal, not_finite = good.copy(), good.copy()
    zero_focal[:, 14] = 0
    not_finite[1, 3] = np.nan
    for rows, fault in ((good[:2], "poses_bounds"), (good[:, :9], "poses_bounds"), (not_finite, ""), (zero_focal, "")):
        np.save(poses, rows)
        assert_refused(run("train", clip, "--out", out), fault)
    np.save(poses, good)
    video = clip / "cam01.mp4"
    video.write_bytes(video.read_bytes()[:200])
    assert_refused(run("train", clip, "--out", out), "cam01.mp4")
    video.unlink()
    assert_refused(run("train", clip, "--out", out))
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


def test_cameras_and_views_that_do_not_exist(run: Run, tmp_path: Path, clip: Path) -> None:
    out = tmp_path / "o.slod"
    assert_refused(run("train", clip, "--out", out, "--train", "cam01,cam09"), "cam09")
    assert_refused(run("train", clip, "--out", out, "--views", 9), "9")
    assert_refused(run("train", clip, "--out", tmp_path), tmp_path, "folder")
    assert not out.exists()


def test_a_cut_file_is_refused_by_every_command(run: Run, tmp_path: Path, scene: Path, clip: Path) -> None:
    cut, data = tmp_path / "cut.slod", scene.read_bytes()
    for size in (0, 5):
        cut.write_bytes(data[:size])
        assert_refused(run("info", cut), cut)
    cut.write_bytes(data[:-1])
    assert "cut short" in run("info", cut).stdout
    assert_refused(run("export", cut, "--out", tmp_path / "x.ply"), cut)
    assert_refused(run("evaluate", cut, clip, "--test", "cam00", "--json", tmp_path / "r.json"), cut)
    assert not (tmp_path / "x.ply").exists()
    assert not (tmp_path / "r.json").exists()


def test_debug_shows_the_traceback_wherever_it_stands(run: Run, tmp_path: Path) -> None:
    for call, arguments in (
        (run, ("--debug", "info", tmp_path / "x")),
        (streamlod, ("info", tmp_path / "x", "--debug")),
    ):
        done = call(*arguments)
        assert done.returncode == 2
        assert "Traceback" in done.stderr
        assert "InputError" in done.stderr


def test_info_and_export(run: Run, tmp_path: Path, scene: Path) -> None:
    assert "frames 0 to 3" in run("info", scene).stdout
    done = run("export", scene, "--frame", 2, "--view", "cam00", "--format", "spz", "--out", tmp_path / "s.spz")
    assert "as seen from cam00" in done.stdout
    assert (tmp_path / "s.spz").read_bytes()[:2] == b"\x1f\x8b"
    assert_refused(run("export", scene, "--out", tmp_path / "t.spz"), "is called like spz; add --format spz")
    for name, form, fault in (
        ("t.ply", "4dgs", "is called like ply; add --format ply"),
        ("t.mp4", "ply", "is called like mp4; add --format mp4"),
        ("t.obj", "usd", "must end in .usdc or .usda or .usd"),
    ):
        assert_refused(run("export", scene, "--format", form, "--out", tmp_path / name), fault)
    assert_refused(run("export", scene, "--format", "4dgs", "--sequence", "--out", tmp_path / "t"), "must end in .4dgs")
    assert_refused(run("export", scene, "--format", "mp4", "--view", "cam00"), "--view: mp4 carries colours for all")
    assert not any((tmp_path / name).exists() for name in ("t.ply", "t.mp4", "t.obj", "t"))


def test_an_import_does_not_replace_the_recording_that_its_file_came_of(run: Run, tmp_path: Path, scene: Path) -> None:
    before, snapshot = scene.read_bytes(), scene.with_suffix(".ply")
    assert_refused(run("import", snapshot), snapshot, "does not exist")
    assert run("export", scene, "--out", snapshot).returncode == 0
    assert_refused(run("import", snapshot), scene, "exists already; name it by --out")
    assert scene.read_bytes() == before
    assert "1 frame of" in run("import", snapshot, "--out", scene).stdout
    assert scene.read_bytes() != before


def test_places_that_cannot_be_written_are_refused_before_the_work(
    run: Run, tmp_path: Path, scene: Path, clip: Path
) -> None:
    assert_refused(run("train", clip, "--out", tmp_path / "film.mp4"), "film.mp4", "`streamlod export --format`")
    done = run("evaluate", scene, clip, "--json", tmp_path)
    assert_refused(done, tmp_path, "is a folder")
    assert "dB" not in done.stderr  # of the bar that shows what was measured
    assert not (tmp_path / "film.mp4").exists()


def test_a_port_in_use_is_one_sentence(run: Run, scene: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert_refused(run("serve", "--play", scene, "--port", port), f"port {port}")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Processes that the test starts take an interrupt, which those of a shell's background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_what_is_interrupted_says_so(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "streamlod.server.cli", "synth", str(tmp_path / "clip"), "--frames", "9999"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as synth:
        assert synth.stderr is not None
        try:
            while "%" not in synth.stderr.read(1):
                pass
            synth.send_signal(signal.SIGINT)
            assert synth.stderr.read().endswith("\ninterrupted\n")
            assert synth.wait(60) == 130
        finally:
            synth.kill()


@pytest.mark.long
def test_serve_and_view_until_interrupted(run: Run, tmp_path: Path, scene: Path) -> None:
    command = [sys.executable, "-m", "streamlod.server.cli", "serve", "--play", str(scene), "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        try:
            address = re.compile(r"listening at http://(127\.0\.0\.1:\d+)")
            place = next(found[1] for line in server.stderr if (found := address.search(line)))
            url = f"ws://{place}/v1/streams/main/live"
            poses = tmp_path / "pose.json"
            poses.write_text(json.dumps({"world_to_camera": np.eye(4).tolist(), "width": 64, "height": 36}))
            done = run("view", url, "--pose", poses, "--out", tmp_path / "views", "--frames", 3)
            assert done.returncode == 0, done.stderr
            assert len(list((tmp_path / "views").glob("*.png"))) == 3
            assert_refused(run("view", url, "--camera", "cam77", "--out", tmp_path / "v"), "cam77", "cam00")
            wrong = url.replace("main", "other")
            there = f"it has main: watch http://{place}/?stream=main"
            assert_refused(run("view", wrong, "--out", tmp_path / "v"), wrong, "4404", there)
            server.send_signal(signal.SIGINT)
            server.stderr.read()
            assert server.wait(60) == 0
        finally:
            server.kill()
    assert not (tmp_path / "v").exists()
