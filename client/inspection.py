"""A readable report of what a recorded file holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from streamlod.codec.container.packet_file import PacketFile
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.opening import open_packets
from streamlod.codec.packet.bytes import parse
from streamlod.codec.packet.info import PacketInfo, describe
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.data.names import counted
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.metadata import Metadata

_MAX_NUMBERS = 10  # of damaged packets that are listed


def describe_file(path: Path) -> str:
    """A report of several lines; of a file that was cut, also what is lost and what can still be decoded.

    Raises:
        InputError: the file is none, or holds no whole keyframe; names it.
    """
    try:
        with open_packets(path) as reader:
            infos, damaged = _packets(reader)
            faults = _fault_lines(path, reader, damaged)
            scene = _first_scene(reader)
    except BitstreamError as error:
        raise InputError(path, f"is damaged: {error}") from error
    if scene is None:
        raise InputError(path, "holds no whole keyframe, so that nothing of it can be shown")
    size = path.stat().st_size
    facts = _fact_lines(scene.metadata, infos[0].time_ns)
    parts = [*_file_lines(path, size, infos), *faults, *facts, "", *_scene_lines(scene), "", *_size_lines(infos)]
    return "\n".join(parts)


def _packets(reader: PacketFile) -> tuple[list[PacketInfo], list[int]]:
    """Facts of the packets that are whole, and the numbers of the damaged ones."""
    infos: list[PacketInfo] = []
    damaged: list[int] = []
    for number in range(len(reader.entries)):
        try:
            infos.append(describe(parse(reader.read(number))))
        except BitstreamError:
            damaged.append(number)
    return infos, damaged


def _fault_lines(path: Path, reader: PacketFile, damaged: list[int]) -> list[str]:
    """Lines about what is missing from a file, if anything."""
    lines, size, count = [], path.stat().st_size, len(reader.entries)
    if damaged:
        numbers = ", ".join(map(str, damaged[:_MAX_NUMBERS])) + (" and others" if len(damaged) > _MAX_NUMBERS else "")
        cost = "each costs pictures up to the next keyframe"
        lines.append(f"damaged: {len(damaged)} of {count} packets ({numbers}); {cost}")
    if not reader.is_whole:
        lost = size - reader.records_end
        end = f"{lost} bytes of an incomplete packet or index are lost" if lost else "only the index is missing"
        there = f"{count} packets, to byte {reader.records_end}, are there"
        lines.append(f"cut short, or still being written: {there}; {end}")
    return lines


def _first_scene(reader: PacketFile) -> Scene | None:
    """The first keyframe's state, all its parts together."""
    decoder = SceneDecoder()
    for number, entry in enumerate(reader.entries):
        if entry.kind is not PacketKind.KEY or entry.keyframe != reader.entries[0].keyframe:
            break
        decoder.push(reader.read(number))
    return decoder.scene


def _file_lines(path: Path, size: int, infos: list[PacketInfo]) -> list[str]:
    seconds = (max(info.time_ns for info in infos) - min(info.time_ns for info in infos)) / 1e9
    first, last = min(info.to_version for info in infos), max(info.to_version for info in infos)
    profiles = ", ".join(str(profile) for profile in sorted({info.profile for info in infos}))
    return [
        f"{path}: {size / 1000:.1f} KB, {counted(len(infos), 'packet')}, profile {profiles}",
        f"frames {first} to {last}, {seconds:.2f} s from the first to the last",
    ]


def _fact_lines(facts: Metadata, first_ns: int) -> list[str]:
    """Lines that the file says about its scene; `first_ns` is the first presentation time."""
    lines = []
    if facts.title is not None:
        lines.append(f"title: {facts.title}")
    if facts.licence is not None:
        lines.append(f"licence: {facts.licence}")
    if facts.metres_per_unit is not None:
        lines.append(f"unit: {facts.metres_per_unit:.6g} m")
    if facts.up is not None:
        lines.append("up: " + " ".join(f"{x:.4g}" for x in facts.up))
    if facts.epoch_ns is not None:
        lines.append(f"begins: {_utc(facts.epoch_ns + first_ns)}")
    if facts.original is not None:
        moved = " ".join(f"{x:.6g}" for x in facts.original.translation)
        lines.append(
            f"calibration's coordinates: {facts.original.scale:.6g} times the scene's, turned, then moved by {moved}"
        )
    return lines


def _utc(nanoseconds: int) -> str:
    try:
        return datetime.fromtimestamp(nanoseconds // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):  # a year that the calendar does not have
        return f"{nanoseconds / 1e9:.0f} s after 1970"


def _scene_lines(scene: Scene) -> list[str]:
    header = scene.header
    view = "view-dependent" if header.view_dependent else "the same from all views"
    lines = [
        f"scene: {scene.anchor_count} anchors of {header.gaussians_per_anchor} Gaussians, {view}, {header.fps:g} fps",
        f"cameras: {', '.join(f'{c.name} {c.width}x{c.height}' for c in header.cameras) or 'none'}",
        "",
        "level  anchors  cumulative",
    ]
    cumulative, total = 0, max(scene.anchor_count, 1)
    for number, level in enumerate(scene.levels):
        anchors = int(level.alive.sum())
        cumulative += anchors
        lines.append(f"{number:5d}  {anchors:7d}  {cumulative / total:10.0%}")
    return lines


def _size_lines(infos: list[PacketInfo]) -> list[str]:
    lines = ["packets     count      KB   KB each  largest"]
    for kind in PacketKind:
        sizes = [info.size_bytes for info in infos if info.kind is kind]
        if sizes:
            total, mean, largest = sum(sizes) / 1000, sum(sizes) / len(sizes) / 1000, max(sizes) / 1000
            name = kind.name.lower().replace("_", "-")
            lines.append(f"{name:10s}  {len(sizes):5d}  {total:6.1f}  {mean:8.2f}  {largest:7.2f}")
    lines += ["", "bytes by level       key    others"]
    by_level: dict[bool, Counter[int]] = {True: Counter(), False: Counter()}
    by_chunk: dict[bool, Counter[str]] = {True: Counter(), False: Counter()}
    for info in infos:
        is_key = info.kind is PacketKind.KEY
        by_level[is_key].update(dict(enumerate(info.level_bytes)))
        by_chunk[is_key].update(info.chunk_bytes)
    lines += _table(sorted(by_level[True] | by_level[False]), by_level[True], by_level[False])
    lines += ["", "bytes by chunk       key    others"]
    return lines + _table(sorted(by_chunk[True] | by_chunk[False]), by_chunk[True], by_chunk[False])


def _table(names: Iterable[Any], key: Counter[Any], others: Counter[Any]) -> list[str]:
    return [f"{name!s:14s} {key[name]:9d} {others[name]:9d}" for name in names]
