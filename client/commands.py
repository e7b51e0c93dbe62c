"""The commands `streamlod view`, `evaluate`, `info` and `export`; each returns the text to print."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlsplit

import numpy as np

from streamlod.client.connection.address import live_address
from streamlod.client.connection.link import WatchOptions
from streamlod.client.recording import decode_frames, decode_version, versions
from streamlod.client.viewing.record import record_stream
from streamlod.client.viewpoints import CameraPath, along, camera_named, orbit, read_path, read_poses
from streamlod.codec.export import bake, write_snapshot
from streamlod.codec.snapshots import CLIP_SUFFIXES, FORMATS, PACKET_SUFFIXES, formats_called
from streamlod.core.arrays import Float64
from streamlod.core.data.names import counted, spoken
from streamlod.core.errors import BitstreamError, InputError, RequestRefused, SessionError
from streamlod.core.files import check_output, write_text
from streamlod.core.options import TOKEN_VARIABLE
from streamlod.core.progress_bar import progress_bar
from streamlod.core.scene.anchors import Scene, SceneHeader

if TYPE_CHECKING:
    from streamlod.client.evaluation.file_scores import DecodedScore

_PATH_SIZE = 1280, 720  # pixels, where the scene has no camera
_OLDEST = 1, 0  # the position before all others: the server begins with the oldest that it has
_BAR_DELAY_SECONDS = 0.5  # that a bar waits: what is refused at once is told without
_NO_STREAM = 4404  # close code of docs/protocol.md
AVERAGE = "average"


def view(
    url: str,
    out: Path,
    camera: str | None = None,
    orbiting: bool = False,
    pose: Path | None = None,
    frames: int | None = None,
    levels: int | None = None,
    fps: float | None = None,
    path: Path | None = None,
    from_start: bool = False,
) -> str:
    """Record a live stream from a camera of the rig (the first by default), on an orbit, from poses of a file, or along
    a camera path of the page, once unless `frames` says otherwise.

    A token is taken from the environment variable STREAMLOD_TOKEN. At another rate than the stream's (`fps`), pictures
    between its frames are interpolated. What the server has kept is shown first where it begins `from_start`. Ctrl-C
    ends it.
    """
    if sum((camera is not None, orbiting, pose is not None, path is not None)) > 1:
        raise InputError("view", "--camera, --orbit, --pose and --path exclude each other")
    route = None if path is None else read_path(path)
    if frames is not None and frames < 1:
        raise InputError("--frames", f"must be at least 1, not {frames}")

    def viewpoint(header: SceneHeader) -> CameraPath:
        if orbiting:
            return orbit(header, frames)
        if pose is not None:
            return read_poses(pose, header)
        if route is not None:
            first = header.cameras[0] if header.cameras else None
            return along(route, (first.width, first.height) if first else _PATH_SIZE, fps or header.fps)
        if camera is None and not header.cameras:
            raise InputError("view", "the scene has no cameras; give --pose")
        chosen = camera_named(header, camera or header.cameras[0].name)
        return lambda number: chosen

    if pose is not None and not pose.is_file():
        raise InputError(pose, "does not exist")
    start = _OLDEST if from_start else None
    options = WatchOptions(token=os.environ.get(TOKEN_VARIABLE), start=start, levels=levels, nearest=True)
    count = 0
    with progress_bar(total=frames, unit="picture", desc="view", delay=_BAR_DELAY_SECONDS) as bar:

        def tell(text: str) -> None:
            nonlocal count
            is_picture = text.startswith("picture")
            # the bar itself is drawn again only as it grows, and not at all before a refusal that comes at once
            bar.set_postfix_str(text, refresh=not is_picture and bar.format_dict["elapsed"] > _BAR_DELAY_SECONDS)
            bar.update(1 if is_picture else 0)
            count += is_picture

        try:
            asyncio.run(record_stream(url, out, viewpoint, frames, options, tell, fps))
        except KeyboardInterrupt:
            if count == 0:
                raise
        except SessionError as error:
            if error.close_code != _NO_STREAM:
                raise
            raise SessionError(_NO_STREAM, f"{error.detail}{_streams_there(url, options.token)}") from error
    return f"{counted(count, 'picture')} in {out}"


def _streams_there(url: str, token: str | None) -> str:
    """The streams that a server has instead of that of `url`, to end a sentence; empty where it does not tell."""
    page = live_address(url).replace("ws", "http", 1).partition("/v1/streams/")[0]
    try:
        from streamlod.client.rest import ServerClient  # which is not in an image that only watches

        with ServerClient(page, token) as server:
            names = [stream.id for stream in server.streams()]
    except (ImportError, InputError, RequestRefused):
        return ""
    if not names:
        return "; it has no stream yet"
    return f"; it has {spoken(names, 5)}: watch {page}/?stream={quote(names[0], safe='')}"


def evaluate(
    scene: Path,
    data: Path,
    test: tuple[str, ...],
    report: Path | None = None,
    images: Path | None = None,
    layout: str | None = None,
    downscale: float | None = None,
) -> str:
    """Measure a file against held-out cameras, and at those that trained; without held-out ones, at these alone.

    The report goes to `report` as JSON, beside it a plot over frames.
    """
    from streamlod.client.evaluation.file_scores import evaluate_file  # these need libraries of training
    from streamlod.client.evaluation.measure.places import places_table
    from streamlod.client.evaluation.report.plots import frames_plot

    if report is not None:
        check_output(report)
    with progress_bar(unit="frame", desc="evaluate", delay=_BAR_DELAY_SECONDS) as bar:

        def tell(score: DecodedScore) -> None:
            bar.set_postfix_str(f"{score.picture.psnr:.2f} dB", refresh=False)
            bar.update()

        figures = evaluate_file(scene, data, test, images, layout, downscale, tell)
    if report is not None:
        write_text(report, json.dumps(figures, indent=1) + "\n")
        write_text(report.with_suffix(".svg"), frames_plot(scene.stem, figures["per_frame"]) + "\n")
    where = "held-out cameras" if test else "cameras that trained, as --test names no other"
    frames, there = figures["frames"], figures["file_frames"]
    if frames < there:
        where += f"; of the others {data} has no picture from each camera that is measured"
    count = counted(frames, "frame") if frames == there else f"{frames} of {there} frames"
    return f"{_summary(figures['mean'], count, where)}\n{places_table(figures['places'])}".rstrip()


def export(
    scene: Path, frame: int, viewpoint: str, file_format: str, out: Path | None = None, sequence: bool = False
) -> str:
    """Write frame `frame` (or, as a sequence, it and all later ones) as plain Gaussians.

    Args:
        viewpoint: a camera's name, at which view-dependent colour is frozen, or "average" over the rig.
        out: the file, or the folder of a sequence; beside the scene by default.
    """
    if out is not None and not (sequence and file_format in FORMATS):
        _check_suffix(out, file_format)
    if file_format in PACKET_SUFFIXES:
        if frame:
            raise InputError("--frame", f"{file_format} carries the whole recording")
        if viewpoint != AVERAGE:
            raise InputError("--view", f"{file_format} carries colours for all views; leave it away")
        return _export_packets(scene, file_format, out)
    if file_format in CLIP_SUFFIXES:
        return _export_clip(
            scene, frame, viewpoint, out or scene.with_name(f"{scene.stem}{CLIP_SUFFIXES[file_format][0]}")
        )
    if file_format not in FORMATS:
        raise InputError(
            "--format", f"{file_format} is not one of {', '.join((*FORMATS, *CLIP_SUFFIXES, *PACKET_SUFFIXES))}"
        )
    suffix = FORMATS[file_format].suffix
    if not sequence:
        path = out or scene.with_name(f"{scene.stem}-{frame:05d}{suffix}")
        state = decode_version(scene, _existing(scene, frame))
        path.parent.mkdir(parents=True, exist_ok=True)
        return _snapshot(path, state, viewpoint, file_format)
    folder = out or scene.with_name(f"{scene.stem}-{file_format}")
    _existing(scene, frame)
    folder.mkdir(parents=True, exist_ok=True)
    count = 0
    for decoded in progress_bar(decode_frames(scene), unit="frame", desc="export"):
        version = decoded.scene.version
        if version >= frame:
            _snapshot(folder / f"frame_{version:05d}{suffix}", decoded.scene, viewpoint, file_format)
            count += 1
    return f"{counted(count, 'snapshot')} in {folder}, colours {_origin(viewpoint)}"


def _export_clip(scene: Path, frame: int, viewpoint: str, out: Path) -> str:
    """Write the frames from `frame` on as one file, of the format that the suffix of `out` names."""
    from streamlod.codec.export.fourdgs_file import write_clip
    from streamlod.codec.export.usd_cameras import add_usd_cameras

    first = decode_version(scene, _existing(scene, frame))
    places = _viewpoints(first, viewpoint)
    begin: int | None = None

    def states() -> Iterator[tuple[float, Scene]]:
        nonlocal begin
        for decoded in progress_bar(decode_frames(scene), unit="frame", desc="export"):
            if decoded.scene.version >= frame:
                begin = decoded.time_ns if begin is None else begin
                yield (decoded.time_ns - begin) / 1e9, decoded.scene

    out.parent.mkdir(parents=True, exist_ok=True)
    count = write_clip(out, states(), places, first.metadata, first.header.fps)
    if out.suffix != ".4dgs":
        add_usd_cameras(out, first.header.cameras)
    return f"{out}: {count} Gaussians over time, {out.stat().st_size / 1000:.1f} KB, colours {_origin(viewpoint)}"


def _export_packets(scene: Path, file_format: str, out: Path | None) -> str:
    """Write the packets themselves, with the sound, as an MP4 file or a folder of HLS."""
    from streamlod.codec.mp4 import write_hls, write_mp4

    write, suffix = (write_mp4, ".mp4") if file_format == "mp4" else (write_hls, "-hls")
    out = out or scene.with_name(f"{scene.stem}{suffix}")
    try:
        count, has_sound = write(scene, out)
    except BitstreamError as error:
        raise InputError(scene, f"is damaged: {error}") from error
    return f"{out}: {counted(count, 'group')} of pictures{', with sound' if has_sound else ''}"


def import_scene(source: str, out: Path | None, fps: float, gaussians: int, up: str | None) -> str:
    """Write plain Gaussians, a file or a folder with one for each frame, or the packets of an MP4 file or a HLS
    playlist as a `.slod` file; says what was kept."""
    from streamlod.client.connection.hls import is_playlist, save_hls
    from streamlod.codec.imported import import_files

    if is_playlist(source):
        if up is not None:
            raise InputError(source, "is a playlist of packets, which are taken as they are; --up is for Gaussians")
        place = urlsplit(source)
        name = Path(f"{Path(place.path).stem}.slod")
        out = out or (name if place.scheme in ("http", "https") else Path(source).with_name(name.name))
        return save_hls(source, out, os.environ.get(TOKEN_VARIABLE))
    path = Path(source)
    if not path.exists():
        raise InputError(path, "does not exist")
    beside = path.with_name(f"{path.stem}.slod")
    if out is None and beside.exists():
        raise InputError(beside, "exists already; name it by --out to replace it, or another file")
    with progress_bar(unit="file", desc="import", delay=_BAR_DELAY_SECONDS) as bar:
        return import_files(path, out or beside, fps, gaussians, up, lambda _: bar.update())


def _existing(scene: Path, frame: int) -> int:
    held = versions(scene)
    if frame not in held:
        found = f"frames {held[0]} to {held[-1]}" if held else "no frame"
        raise InputError(scene, f"has no frame {frame}; it holds {found}")
    return frame


def _check_suffix(out: Path, file_format: str) -> None:
    """Refuse a file that is called like one of another format, or a clip that is not called like one of its own."""
    called = formats_called(out)
    if called and file_format not in called:
        raise InputError("--out", f"{out} is called like {called[0]}; add --format {called[0]}")
    if not called and file_format in CLIP_SUFFIXES:
        raise InputError("--out", f"{out} must end in {' or '.join(CLIP_SUFFIXES[file_format])}")


def _snapshot(path: Path, scene: Scene, viewpoint: str, file_format: str) -> str:
    cloud = bake(scene, _viewpoints(scene, viewpoint))
    comment = f"streamlod frame {scene.version}, colours {_origin(viewpoint)}".encode("ascii", "replace").decode()
    size = write_snapshot(path, cloud, file_format, comment)
    return f"{path}: {len(cloud)} Gaussians, {size / 1000:.1f} KB, colours {_origin(viewpoint)}"


def _viewpoints(scene: Scene, viewpoint: str) -> Float64:
    if viewpoint != AVERAGE:
        return camera_named(scene.header, viewpoint).centre[None]
    if not scene.header.cameras:
        raise InputError("--view", "the scene has no cameras to average over")
    return np.stack([camera.centre for camera in scene.header.cameras])


def _origin(viewpoint: str) -> str:
    return "averaged over the rig's cameras" if viewpoint == AVERAGE else f"as seen from {viewpoint}"


def _summary(mean: dict[str, Any], frames: str, where: str) -> str:
    rows: tuple[tuple[str, str, Callable[[float], str]], ...] = (
        ("PSNR", "psnr", lambda x: f"{x:.2f} dB"),
        ("PSNR, exposure fitted", "psnr_fitted", lambda x: f"{x:.2f} dB"),
        ("SSIM", "ssim", lambda x: f"{x:.4f}"),
        ("LPIPS", "lpips", lambda x: f"{x:.4f}"),
        ("PSNR, moving pixels", "moving_psnr", lambda x: f"{x:.2f} dB"),
        ("SSIM, moving pixels", "moving_ssim", lambda x: f"{x:.4f}"),
        ("keyframe", "keyframe_kilobytes", lambda x: f"{x:.1f} KB"),
        ("predicted packet", "predicted_kilobytes", lambda x: f"{x:.2f} KB"),
        ("largest predicted packet", "largest_predicted_kilobytes", lambda x: f"{x:.2f} KB"),
        ("first frame", "first_frame_seconds", lambda x: f"{x:.1f} s"),
        ("later frames", "train_seconds", lambda x: f"{x:.2f} s"),
        ("rendering", "render_fps", lambda x: f"{x:.1f} fps"),
    )
    lines = [f"{frames}, means over the {where}:"]
    lines += [f"  {label:26s}{form(mean[key]) if mean[key] is not None else 'unknown'}" for label, key, form in rows]
    return "\n".join(lines)
