"""The threads that read the cameras of a rig, and the sound that does not come with their pictures."""

from __future__ import annotations

from collections.abc import Collection

from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.cameras.reader import Reader, Sink
from streamlod.server.ingest.cameras.rig_sound import RigSound
from streamlod.server.ingest.cameras.sound_reader import SoundReader
from streamlod.server.ingest.cameras.source_thread import SourceThread
from streamlod.server.ingest.sync.timeline import Timeline

_FILE_DELAY_NS = 300_000_000  # time to open files on all threads


def readers(
    definition: RigDefinition, names: Collection[str], sink: Sink, timeline: Timeline, sound: RigSound
) -> list[SourceThread]:
    """The threads, not yet begun, that read the cameras `names`, except those that capture nodes push.

    Args:
        sink: takes the pictures.
        sound: takes the sound.
    """
    fps, paced = definition.fps, definition.realtime
    anchor_ns = timeline.now_ns() + _FILE_DELAY_NS
    wanted = [
        (camera, address)
        for camera, address in zip(definition.cameras, definition.addresses, strict=True)
        if camera.name in names
    ]
    pictures = [
        Reader(
            camera.name,
            address,
            (camera.width, camera.height),
            fps,
            sink,
            timeline,
            anchor_ns=anchor_ns,
            paced=paced,
            hearing=sound.ears.get(camera.name),
        )
        for camera, address in wanted
        if address.scheme != "push"
    ]
    apart = [
        (address, sound.ears[camera.name])
        for camera, address in wanted
        if camera.name in sound.ears and address.scheme == "file"
    ]
    if sound.hearing is not None and definition.sound is not None and definition.sound.address is not None:
        apart.append((definition.sound.address, sound.hearing))
    sounds = [SoundReader(address, fps, ear, timeline, anchor_ns=anchor_ns, paced=paced) for address, ear in apart]
    return [*pictures, *sounds]
