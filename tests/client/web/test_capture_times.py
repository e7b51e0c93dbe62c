"""What a phone's page says where its times are wrong, beside two cameras whose times are right."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.server.ingest.push.message import Codec, PushMessage
from streamlod.server.settings import Settings
from tests.client.web.phones import opened, says
from tests.server.ingest.push.serving import relayed
from tests.server.ingest.push.stage import FPS, HEIGHT, WIDTH, rig, stage

pytestmark = pytest.mark.browser
AHEAD_NS = 3_000_000_000  # five would be passed over: its pictures would count as filmed when they come


def _with_a_wrong_clock(page: Any) -> None:
    """The page measures the server's clock as being ahead."""

    def listen(socket: Any) -> None:
        server = socket.connect_to_server()

        def tell(message: Any) -> None:
            told = json.loads(message) if isinstance(message, str) else {}
            if told.get("type") == "time":
                message = json.dumps(told | {"server_ns": told["server_ns"] + AHEAD_NS})
            socket.send(message)

        server.on_message(tell)

    page.route_web_socket("**/ingest*", listen)


def test_a_page_says_that_its_times_are_far_off(phone: Any) -> None:
    over, body = threading.Event(), bytes(cv2.imencode(".png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1])
    with stage(Settings(), rig((WIDTH, HEIGHT), 3)) as found, opened(phone, "about:blank") as page:
        socket = found.server.registry.streams["main"].push_socket
        assert socket is not None
        intake = relayed(socket)

        def film() -> None:
            number = 0
            while not over.wait(1 / FPS):
                for name in ("phone2", "phone3"):
                    intake.accept(PushMessage(name, number, time.time_ns(), Codec.PNG, body))
                number += 1
            intake.close()

        filming = threading.Thread(target=film, daemon=True)
        filming.start()
        _with_a_wrong_clock(page)
        page.goto(found.page("&camera=phone1"))
        says(page, "Ready to film")
        page.click("#film")
        says(page, "Filming as phone1, but its times are far from those of the other cameras: reload this page")
        over.set()
        filming.join(60)
        assert not filming.is_alive()
