"""The local process of a stream whose worker is a Ray actor: places the actor and passes its messages on.

It stands where the worker's own process stands otherwise, with the same messages on the same pipe, so that the
supervisor watches, kills and restarts it in the same way. Ray is loaded in this process alone: whatever becomes of the
cluster, the server goes on. When this process ends, Ray ends the actor and frees its room.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager
from dataclasses import asdict
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from streamlod.core.background_log import log_in_background
from streamlod.core.errors import BackendUnavailable, StreamlodError
from streamlod.core.version import streamlod_version
from streamlod.server.ingest.push.relay import pass_on, serving_socket
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import RaySettings
from streamlod.server.worker.cluster.link import LinkAddress, cut, dial, listening_at
from streamlod.server.worker.cluster.room import NoRoom
from streamlod.server.worker.messages import Sender, Tag, receive_resume, send_resume

_LOG = logging.getLogger(__name__)
_JOIN_SECONDS = 30.0  # after which a cluster that does not answer is given up; Ray itself waits for minutes


def run_on_ray(
    settings: RaySettings,
    limit: int,
    spec: StreamSpec,
    pipe: Connection,
    push_socket: Path | None = None,
    spare: bool = False,
    camera_pictures: bool = False,
) -> None:
    """Entry of the process, in place of `run_worker`; returns when the actor has ended, and never raises.

    Args:
        settings: of the cluster.
        limit: bytes of the longest message.
        spec, pipe, push_socket, camera_pictures: as of `run_worker`.
        spare: have the actor load everything before it is needed, if there is room for it by then.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the supervisor decides
    log_in_background()
    from streamlod.server.worker.cluster.placing import joined, reserve

    sender = Sender(pipe)
    waiting = threading.Timer(_JOIN_SECONDS, _give_up, (settings, sender))
    waiting.daemon = True
    waiting.start()
    try:
        with joined(settings) as host:
            waiting.cancel()
            try:
                place = reserve(spec.id, settings)
            except NoRoom:
                if not spare:
                    raise
                pipe.poll(None)  # until it is needed
                place = reserve(spec.id, settings)
            sender.send(Tag.PLACED, {"node": place.host})

            def start(back: LinkAddress) -> Future[Any]:
                ended = place.start(spec, back, spare, camera_pictures)
                ended.add_done_callback(lambda _: _log_fault(spec.id, ended))
                return ended

            if not _pass_all(start, host, pipe, push_socket, limit):
                _LOG.warning("stream %s: its process on node %s was lost, or that node", spec.id, place.host)
                text = "its process on the cluster was lost, or the node that it ran on"
                sender.send(Tag.FAILURE, {"text": text, "fatal": False})
    except NoRoom as error:
        started = receive_resume(pipe).frames > 0
        sender.send(Tag.FAILURE, {"text": error.fault, "fatal": not started, "refused": asdict(error.shortage)})
    except StreamlodError as error:
        sender.send(Tag.FAILURE, {"text": str(error), "fatal": False})
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the supervisor is gone
    except Exception as error:
        _LOG.exception("stream %s: its actor", spec.id)
        sender.send(Tag.FAILURE, {"text": f"{type(error).__name__}: {error}", "fatal": False})


def _give_up(settings: RaySettings, sender: Sender) -> None:
    """Say that the cluster does not answer, and end the process, which cannot be stopped otherwise."""
    _LOG.warning("the Ray cluster %r does not answer", settings.address)
    text = "the Ray cluster does not answer; start it: ray start --head"
    try:
        sender.send(Tag.FAILURE, {"text": text, "fatal": False})
    finally:
        os._exit(1)


def _pass_all(
    start: Callable[[LinkAddress], Future[Any]], host: str, pipe: Connection, push_socket: Path | None, limit: int
) -> bool:
    """Pass on what the supervisor tells the actor, then all that this sends; whether it has said how it ended.

    Raises:
        BackendUnavailable: its node has another version of streamlod.
    """
    with _linked(start, host) as link:
        if link is None:
            return False
        tag = None
        try:
            told = json.loads(link.recv_bytes(limit))
            _check_version(told.get("version"))
            with passing_pictures(push_socket, told["pictures"]):
                if pipe not in wait([pipe, link]):
                    return False
                send_resume(receive_resume(pipe), link)
                while True:
                    message = link.recv_bytes(limit)
                    tag = message[0]
                    pipe.send_bytes(message)
        except (EOFError, OSError):  # the actor has gone; if it is the supervisor, nobody hears the answer
            return tag in {Tag.END, Tag.FAILURE}


def _check_version(found: object) -> None:
    """Require one version at both ends, as messages of workers differ between versions."""
    if found != (own := streamlod_version()):
        has = f"has streamlod {found:.40}" if isinstance(found, str) else "does not say which streamlod it has"
        raise BackendUnavailable("a node of the cluster", f"it {has}; install {own}, as the server has")


def _log_fault(stream: str, ended: Future[Any]) -> None:
    """The reason that Ray gives for the end of an actor, if that was not as it should be."""
    if (error := ended.exception()) is not None:
        _LOG.warning("stream %s: its actor: %s", stream, error)


@contextmanager
def _linked(start: Callable[[LinkAddress], Future[Any]], host: str) -> Iterator[Connection | None]:
    """Start the actor and give the connection to it; None where it ended before it had one."""
    found: queue.SimpleQueue[Connection | None] = queue.SimpleQueue()
    with listening_at(host, found.put) as back:
        ended = start(back)
        ended.add_done_callback(lambda _: found.put(None))
        link = found.get()
    if link is None:
        yield None
        return
    with closing(link):
        ended.add_done_callback(lambda _: cut(link))  # Ray may know first
        yield link


@contextmanager
def passing_pictures(push_socket: Path | None, told: tuple[str, int, str] | None) -> Iterator[None]:
    """Pass pictures that come at `push_socket` on to the actor, each when the one before is answered."""
    if push_socket is None or told is None:
        yield
        return
    host, port, secret = told
    address = LinkAddress(host, port, bytes.fromhex(secret))

    def serve(pipe: Connection) -> None:
        try:
            link = dial(address)
        except OSError:
            pipe.close()
            return
        pass_on(pipe, link)

    with serving_socket(push_socket, serve):
        yield
