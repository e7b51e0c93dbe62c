"""A server whose streams are to be trained on a Ray cluster, where Ray does not run."""

from __future__ import annotations

import json
import multiprocessing
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import RaySettings, Settings
from streamlod.server.worker.cluster.driver import run_on_ray
from streamlod.server.worker.messages import Tag


def join_nothing(pipe: Connection) -> None:
    """The local process of a stream, where nothing listens at the cluster's address."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("streamlod.server.worker.cluster.driver._JOIN_SECONDS", 2.0)
        settings, spec = RaySettings(address="127.0.0.2:1"), StreamSpec(job=TrainJob(data=Path("data")))
        run_on_ray(settings, 1000, spec, pipe)


@pytest.mark.long
def test_a_cluster_that_does_not_answer_is_given_up() -> None:
    pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=join_nothing, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    with ours:
        assert ours.poll(60)
        message = ours.recv_bytes()
    process.join(60)
    assert (message[0], json.loads(message[1:])["fatal"]) == (Tag.FAILURE, False)
    assert json.loads(message[1:])["text"].startswith("the Ray cluster does not answer")
    assert "ray start --head" in json.loads(message[1:])["text"]
    assert process.exitcode == 1


def test_a_worker_takes_part_of_one_gpu_or_whole_ones() -> None:
    Settings(jobs="ray", ray=RaySettings(gpus=0.25)).check()
    Settings(jobs="ray", ray=RaySettings(gpus=2)).check()
    with pytest.raises(InputError, match="part of one GPU"):
        Settings(jobs="ray", ray=RaySettings(gpus=1.5)).check()
