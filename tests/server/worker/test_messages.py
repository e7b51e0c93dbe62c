"""Messages between worker and supervisor."""

from __future__ import annotations

import json
import math
import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from streamlod.server.worker.messages import Resume, Sender, Tag, receive_resume, send_resume


def test_where_to_go_on_is_told_by_pipe_however_long_it_is() -> None:
    resume = Resume((bytes(3_000_000), b"residual"), 7)
    ours, theirs = multiprocessing.Pipe()
    with ours, theirs, ThreadPoolExecutor(1) as pool:
        sent = pool.submit(send_resume, resume, ours)
        assert receive_resume(theirs) == resume
        sent.result(60)


def test_figures_become_plain_json() -> None:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    with ours, theirs:
        figures = {"loss": math.nan, "seconds": {"train": np.float32(0.5)}, "frames": np.int64(3), "text": "x"}
        Sender(theirs).send(Tag.REPORT, figures)
        data = ours.recv_bytes()
    assert data[0] == Tag.REPORT
    assert json.loads(data[1:]) == {"loss": None, "seconds": {"train": 0.5}, "frames": 3.0, "text": "x"}
