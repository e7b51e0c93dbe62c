"""Cameras and phones that film for `streamlod rig`."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from streamlod.server.cli.rig import find
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, Codec, PushMessage, pack_push
from tests.core.data.writers import write_video
from tests.server.ingest.rig import HEIGHT, WIDTH, burnt

FPS = 20
SKEW_NS = 7_000_000  # by which the second phone films later


def found(folder: Path, *sources: str, phones: int = 0, sound: str | None = None, overwrite: bool = False) -> list[str]:
    """What `find` says."""
    said: list[str] = []
    find(sources, folder / "rig.json", phones, (160, 128), FPS, said.append, sound=sound, overwrite=overwrite)
    return said


def film(
    page: str,
    camera: str,
    begin_ns: int,
    over: threading.Event,
    answers: list[dict[str, Any]] | None = None,
    fps: int = FPS,
) -> None:
    """Push numbered pictures as a phone with that page does, until it is over; `answers` gets what it is told."""
    parts = urlsplit(page)
    address = f"ws://{parts.netloc}/v1/streams/main/ingest?{parts.query}"
    skew = SKEW_NS if camera == "phone2" else 0
    number = 0
    while not over.is_set():
        try:
            with connect(address, subprotocols=[Subprotocol(PUSH_SUBPROTOCOL)], compression=None) as node:
                while not over.is_set():
                    taken = begin_ns + round(number * 1e9 / fps) + skew
                    time.sleep(max(0.0, (taken - time.time_ns()) / 1e9))
                    body = cv2.imencode(".png", burnt(number))[1].tobytes()
                    node.send(pack_push(PushMessage(camera, number, taken, Codec.PNG, body)))
                    assert json.loads(node.recv(60))["type"] == "ack"
                    number += 1
                    if answers is not None:
                        node.send(json.dumps({"type": "cameras"}))
                        answers += json.loads(node.recv(60))["cameras"]
        except (WebSocketException, OSError, EOFError):
            over.wait(0.1)  # the rig does not take pictures yet, or the server has ended


def write_still(file: Path) -> Path:
    """A camera that is no phone: a file of a minute."""
    write_video(file, [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * (60 * FPS), fps=FPS)
    return file
