"""Recordings written in each layout, for tests. The formulas here are the layouts' own, not the readers' inverses."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType

import av
import cv2
import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.camera import Camera, look_at, pinhole

COLMAP_MODELS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "FULL_OPENCV": 6}


def rig(names: Sequence[str], size: tuple[int, int] = (96, 64)) -> tuple[Camera, ...]:
    """Cameras on an arc round the origin, each with a focal length of its own."""
    cameras = []
    for index, name in enumerate(names):
        angle = 0.4 * (index - (len(names) - 1) / 2)
        eye = np.array([4 * np.sin(angle), 0.3 * index, -4 * np.cos(angle)])
        pose = look_at(eye, np.zeros(3), np.array([0.0, 1, 0]))
        focal = 80.0 + index
        cameras.append(pinhole(name, (focal, focal), (size[0] / 2, size[1] / 2), size, pose))
    return tuple(cameras)


def picture(camera: int, frame: int, size: tuple[int, int] = (96, 64)) -> UInt8:
    """[H,W,3]: red tells the camera (12 grey levels each), green the frame (4 each), blue rises to the right."""
    width, height = size
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0], image[..., 1] = 20 + 12 * camera, 20 + 4 * frame
    image[..., 2] = np.linspace(30, 220, width).astype(np.uint8)
    return image


def read_back(image: UInt8) -> tuple[int, int]:
    """The camera and frame that `picture` wrote."""
    red, green = image[..., 0].mean(), image[..., 1].mean()
    return round((red - 20) / 12), round((green - 20) / 4)


def write_video(
    path: Path,
    pictures: Sequence[UInt8],
    fps: int = 30,
    codec: str = "libx264",
    *,
    times: Sequence[int] | None = None,
    time_base: Fraction | None = None,
    options: Mapping[str, str] = MappingProxyType({}),
    muxing: Mapping[str, str] = MappingProxyType({}),
    comment: str = "",
) -> None:
    """A video of [H,W,3] RGB pictures, nearly lossless, in 4:4:4.

    Args:
        times: of the pictures in units of `time_base`; one picture after the other by default.
        options, muxing: for FFmpeg's encoder and muxer.
    """
    base = Fraction(1, fps) if time_base is None else time_base
    with av.open(str(path), "w", options=dict(muxing)) as container:
        container.metadata["comment"] = comment
        stream = container.add_stream(codec, rate=Fraction(fps))
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p" if codec == "mpeg4" else "yuv444p"
        stream.options = {"crf": "4", "preset": "ultrafast", **options} if codec != "mpeg4" else {"q": "2", **options}
        stream.time_base = stream.codec_context.time_base = base
        for number, image in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = number if times is None else times[number], base
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)


def copy_video(source: Path, path: Path, *, skip: int = 0, earlier: int = 0, damaged: int = -1) -> None:
    """Copy a video without decoding it.

    Args:
        skip: samples left out at the beginning.
        earlier: frames by which all is moved to before the file's beginning, where an edit list hides it.
        damaged: number of a sample that holds nothing useful.
    """
    with av.open(str(source)) as before, av.open(str(path), "w") as after:
        stream = before.streams.video[0]
        copied = after.add_stream_from_template(stream)
        assert stream.average_rate is not None
        assert stream.time_base is not None
        shift = round(earlier / (stream.average_rate * stream.time_base))
        for number, packet in enumerate(before.demux(stream)):
            if packet.size > 0 and number >= skip:
                assert packet.pts is not None
                packet.pts -= shift
                packet.dts = None if packet.dts is None else packet.dts - shift
                written = av.Packet(bytes(100)) if number == damaged else packet
                written.pts, written.dts, written.time_base = packet.pts, packet.dts, packet.time_base
                written.stream = copied
                after.mux(written)


def put_display_matrix(path: Path, a: float, b: float, c: float, d: float) -> None:
    """Write a display matrix into the track header of an MP4 of one track, as phones do (ISO/IEC 14496-12, 8.3.2)."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4
    matrix = at + (52 if data[at] == 1 else 40)
    values = [round(value * (1 << 16)) for value in (a, b, 0, c, d, 0, 0, 0)]
    struct.pack_into(">9i", data, matrix, *values, 1 << 30)
    path.write_bytes(data)


def write_picture(path: Path, image: UInt8) -> None:
    """A PNG or JPEG by the path's suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])


def llff_rows(cameras: Sequence[Camera], near: float = 1.0, far: float = 9.0) -> Float64:
    """[N,17] rows of poses_bounds.npy: axes down, right, backwards; centre; height, width, focal; depth bounds."""
    rows = []
    for camera in cameras:
        right, down, forward = camera.world_to_camera[:3, :3]
        hwf = [camera.height, camera.width, camera.intrinsics[0, 0]]
        matrix = np.stack([down, right, -forward, camera.centre, hwf], axis=1)
        rows.append([*matrix.reshape(-1), near, far])
    return np.array(rows, np.float64)


def write_video_clip(folder: Path, names: Sequence[str], frames: int, size: tuple[int, int] = (96, 64)) -> None:
    """Videos called `names` and poses_bounds.npy; row i belongs to the i-th name."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "poses_bounds.npy", llff_rows(rig(names, size)))
    for index, name in enumerate(names):
        write_video(folder / f"{name}.mp4", [picture(index, frame, size) for frame in range(frames)])


def quaternion(rotation: Float64) -> Float64:
    """[4] w x y z of a rotation matrix, through its axis and angle."""
    vector = cv2.Rodrigues(rotation)[0].reshape(3)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def colmap_parameters(camera: Camera, model: str) -> list[float]:
    """The parameters of `camera` in one of COLMAP's models."""
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics
    k1, k2, p1, p2, k3 = camera.distortion
    return {
        "SIMPLE_PINHOLE": [fx, cx, cy],
        "PINHOLE": [fx, fy, cx, cy],
        "SIMPLE_RADIAL": [fx, cx, cy, k1],
        "RADIAL": [fx, cx, cy, k1, k2],
        "OPENCV": [fx, fy, cx, cy, k1, k2, p1, p2],
        "FULL_OPENCV": [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0, 0, 0],
    }[model]


def write_colmap_binary(folder: Path, images: Sequence[tuple[str, Camera, str]], points: Float64) -> None:
    """cameras.bin, images.bin and points3D.bin; `images` are (file name, camera, model), `points` [N,6] xyz rgb."""
    folder.mkdir(parents=True, exist_ok=True)
    lenses, records = struct.pack("<Q", len(images)), struct.pack("<Q", len(images))
    for number, (name, camera, model) in enumerate(images, 1):
        parameters = colmap_parameters(camera, model)
        lenses += struct.pack("<iiQQ", number, COLMAP_MODELS[model], camera.width, camera.height)
        lenses += struct.pack(f"<{len(parameters)}d", *parameters)
        pose = [*quaternion(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
        records += struct.pack("<i7di", number, *pose, number) + name.encode() + b"\0"
        records += struct.pack("<Q", 2) + struct.pack("<ddq", 1.5, 2.5, 1) * 2
    cloud = struct.pack("<Q", len(points))
    for number, (x, y, z, *rgb) in enumerate(points, 1):
        cloud += struct.pack("<Q3d3Bd", number, x, y, z, *(int(c) for c in rgb), 0.5)
        cloud += struct.pack("<Q", 1) + struct.pack("<ii", 1, 0)
    for stem, data in (("cameras", lenses), ("images", records), ("points3D", cloud)):
        (folder / f"{stem}.bin").write_bytes(data)


def write_colmap_text(folder: Path, images: Sequence[tuple[str, Camera, str]], points: Float64) -> None:
    """As `write_colmap_binary`, in text; the first image has an empty line of observations."""
    folder.mkdir(parents=True, exist_ok=True)
    lenses, records = ["# cameras"], ["# images"]
    for number, (name, camera, model) in enumerate(images, 1):
        numbers = " ".join(repr(float(value)) for value in colmap_parameters(camera, model))
        lenses.append(f"{number} {model} {camera.width} {camera.height} {numbers}")
        pose = [*quaternion(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
        records.append(f"{number} {' '.join(repr(float(value)) for value in pose)} {number} {name}")
        records.append("" if number == 1 else "1.5 2.5 1")
    cloud = ["# points"]
    for number, (x, y, z, *rgb) in enumerate(points, 1):
        cloud.append(f"{number} {x} {y} {z} {' '.join(str(int(c)) for c in rgb)} 0.5 1 0")
    for stem, lines in (("cameras", lenses), ("images", records), ("points3D", cloud)):
        (folder / f"{stem}.txt").write_text("\n".join(lines) + "\n")


def write_transforms(folder: Path, files: Sequence[str], cameras: Sequence[Camera], **extra: object) -> None:
    """transforms.json with intrinsics in each frame; `extra` goes to the top."""
    frames = []
    for file, camera in zip(files, cameras, strict=True):
        right, down, forward = camera.world_to_camera[:3, :3]
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, -down, -forward, camera.centre], axis=1)
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
        lens = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
        distortion = dict(zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion.tolist(), strict=True))
        frames.append({"file_path": file, "transform_matrix": matrix.tolist(), **lens, **distortion})
    (folder / "transforms.json").write_text(json.dumps({**extra, "frames": frames}))


def write_caliscope(folder: Path, cameras: Sequence[Camera], present: Sequence[Sequence[bool]], fps: int = 10) -> None:
    """camera_array.toml, cam_N.mp4 and timestamps.csv; `present` [T][C] says which camera saw which instant.

    A camera's video holds `picture(camera, instant)` for the instants that it saw; its clock is 1 ms late a camera.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines, times = [], ["sync_index,cam_id,frame_time"]
    for index, camera in enumerate(cameras):
        matrix = camera.intrinsics.copy()
        matrix[:2, 2] -= 0.5  # OpenCV puts the first pixel's centre at 0
        rotation = camera.world_to_camera[:3, :3]
        lines += [
            f"[cameras.{index}]",
            f"cam_id = {index}",
            "ignore = false",
            f"size = [{camera.width}, {camera.height}]",
            f"matrix = {matrix.tolist()}",
            f"distortions = {camera.distortion.tolist()}",
            f"rotation = {(rotation if index % 2 else cv2.Rodrigues(rotation)[0].reshape(3)).tolist()}",
            f"translation = {camera.world_to_camera[:3, 3].tolist()}",
        ]
        seen = [t for t, row in enumerate(present) if row[index]]
        size = (camera.width, camera.height)
        write_video(folder / f"cam_{index}.mp4", [picture(index, t, size) for t in seen], fps)
    for t, row in enumerate(present):
        times += [f"{7 + t},{i},{25 + t / fps + 0.001 * i}" for i in reversed(range(len(cameras))) if row[i]]
    (folder / "camera_array.toml").write_text("\n".join(lines) + "\n")
    (folder / "timestamps.csv").write_text("\n".join(times) + "\n")
