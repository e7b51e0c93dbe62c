"""Connections between an actor and its local process, and pictures that are passed on over them."""

from __future__ import annotations

import json
import os
import queue
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Client, Connection, Pipe
from pathlib import Path
from typing import cast

import pytest

from streamlod.core.errors import BackendUnavailable, InputError, SessionError
from streamlod.core.version import streamlod_version
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.message import Codec, PushMessage
from streamlod.server.ingest.push.relay import RelayedIntake, listening, pass_on, serving_socket
from streamlod.server.worker.cluster import link
from streamlod.server.worker.cluster.driver import _pass_all, passing_pictures
from streamlod.server.worker.cluster.link import MAX_UNPROVEN, LinkAddress, cut, dial, listening_at
from streamlod.server.worker.messages import Resume, send_resume
from tests.waiting import wait

HOST = "127.0.0.1"
STARTED = json.dumps({"version": streamlod_version(), "pictures": None}).encode()


@contextmanager
def linked() -> Iterator[tuple[Connection, Connection]]:
    """Both ends of a connection."""
    found: queue.SimpleQueue[Connection] = queue.SimpleQueue()
    with listening_at(HOST, found.put) as address, dial(address) as one, found.get(timeout=60) as other:
        yield one, other


def test_messages_go_both_ways_however_long_they_are() -> None:
    with linked() as (one, other):
        sending = threading.Thread(target=one.send_bytes, args=(bytes(3_000_000),))
        sending.start()
        assert other.recv_bytes() == bytes(3_000_000)
        sending.join(60)
        other.send_bytes(b"back")
        assert one.recv_bytes() == b"back"


def test_who_does_not_know_the_secret_is_not_listened_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "_PROOF_SECONDS", 60.0)
    found: queue.SimpleQueue[Connection] = queue.SimpleQueue()
    with listening_at(HOST, found.put) as address, ExitStack() as stack:
        with dial(replace(address, secret=bytes(32))) as wrong, pytest.raises((EOFError, ConnectionResetError)):
            wrong.recv_bytes()
        for _ in range(MAX_UNPROVEN // 2):  # who say nothing at all hold nobody up
            stack.enter_context(socket.create_connection((address.host, address.port)))
        with dial(address), found.get(timeout=60):
            assert found.empty()


@contextmanager
def no_more_files() -> Iterator[Callable[[], None]]:
    """This process can open no further file, nor, once what is given was called, where one has been closed since."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(entry.name) for entry in Path("/proc/self/fd").iterdir())
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, hard))
    filling = []

    def fill() -> None:
        with suppress(OSError):
            while True:
                filling.append(os.dup(0))

    try:
        fill()
        yield fill
    finally:
        for each in filling:
            os.close(each)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_connections_are_taken_again_when_one_could_not_be(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    found: queue.SimpleQueue[Connection] = queue.SimpleQueue()
    pushed, connected = tmp_path / "pushed", 0
    with listening_at(HOST, found.put) as address, serving_socket(pushed, found.put), ExitStack() as stack:
        ours = [
            [stack.enter_context(socket.socket(kind)) for kind in (socket.AF_INET, socket.AF_UNIX)] for _ in "12345"
        ]
        with no_more_files() as fill:
            while len({record.name for record in caplog.records}) < 2:  # other threads may close files meanwhile
                fill()
                one, other = ours.pop()
                one.connect((address.host, address.port))
                one.sendall(address.secret)
                other.connect(str(pushed))
                connected += 2
                time.sleep(2)
        for _ in range(connected):
            found.get(timeout=60).close()


def test_so_many_may_be_silent_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "_PROOF_SECONDS", 60.0)
    with listening_at(HOST, lambda link: link.close()) as address, ExitStack() as stack:
        for _ in range(MAX_UNPROVEN):
            stack.enter_context(socket.create_connection((address.host, address.port)))
        with socket.create_connection((address.host, address.port), timeout=60) as further:
            assert further.recv(1) == b""


def test_a_sender_waits_for_who_reads() -> None:
    with linked() as (one, other):
        sent: list[int] = []

        def send() -> None:
            for number in range(64):
                one.send_bytes(bytes(1_000_000))
                sent.append(number)

        threading.Thread(target=send, daemon=True).start()
        time.sleep(0.5)
        assert len(sent) < 32  # the rest is not in memory
        for _ in range(64):
            other.recv_bytes()


def test_a_connection_is_cut_under_who_waits_on_it() -> None:
    with linked() as (one, _):
        threading.Timer(0.2, cut, (one,)).start()
        with pytest.raises((EOFError, OSError)):
            one.recv_bytes()


def test_a_connection_that_breaks_while_it_is_opened_is_closed() -> None:
    with socket.create_server((HOST, 0)) as listener, ThreadPoolExecutor(1) as taking:

        def take() -> None:
            listener.accept()[0].close()

        taken = taking.submit(take)
        address = LinkAddress(HOST, listener.getsockname()[1], bytes(1 << 26))  # more than what is on its way can hold
        with pytest.raises((BrokenPipeError, ConnectionResetError)):  # a socket left open would be a warning, so fail
            dial(address)
        taken.result(60)


def test_nobody_is_served_at_the_end(tmp_path: Path) -> None:
    served: list[Connection] = []
    for _ in range(20):
        with serving_socket(tmp_path / "pushed", served.append):
            pass
    assert not served


def actor_that_sends(*messages: bytes) -> Callable[[LinkAddress], Future[None]]:
    """Starts something that connects, says that much and is gone."""

    def start(back: LinkAddress) -> Future[None]:
        with dial(back) as link:
            for message in messages:
                link.send_bytes(message)
        return Future()

    return start


@pytest.mark.parametrize("told", [[], [STARTED]])
def test_an_actor_that_is_lost_before_it_has_begun_is_told_of(told: list[bytes]) -> None:
    ours, theirs = Pipe()
    send_resume(Resume(), ours)
    with ours, theirs:
        assert not _pass_all(actor_that_sends(*told), HOST, theirs, None, 1 << 20)


@pytest.mark.parametrize(
    ("told", "has"),
    [
        (b'{"pictures": null}', "it does not say which streamlod it has"),
        (b'{"version": [7], "pictures": null}', "it does not say which streamlod it has"),
        (b'{"version": "7.0", "pictures": null}', "it has streamlod 7.0"),
    ],
)
def test_a_node_with_another_version_is_refused_with_what_to_install(told: bytes, has: str) -> None:
    ours, theirs = Pipe()
    with ours, theirs, pytest.raises(BackendUnavailable, match=f"{has}; install {streamlod_version()}"):
        _pass_all(actor_that_sends(told), HOST, theirs, None, 1 << 20)


class Intakes:
    """Stands in for a rig's intakes: keeps what comes, refuses an empty camera name, and takes its time."""

    def __init__(self) -> None:
        self.got: list[int] = []
        self.may_go_on = threading.Event()
        self.closed = threading.Event()

    def accept(self, message: PushMessage) -> None:
        self.got.append(message.sequence)
        self.may_go_on.wait(5)
        if message.camera == "bad":
            raise InputError("camera bad", "is not one of the rig's")

    def close(self) -> None:
        self.closed.set()


def picture(sequence: int, camera: str = "left") -> PushMessage:
    return PushMessage(camera, sequence, 1, Codec.JPEG, bytes(100_000))


@pytest.fixture
def far(tmp_path: Path) -> Iterator[tuple[Path, Intakes]]:
    """The socket that capture nodes' pictures go to here, and where they arrive behind a connection between nodes."""
    here, there, intakes = tmp_path / "here", tmp_path / "there", Intakes()

    def to_worker(link: Connection) -> None:
        try:
            pass_on(link, Client(str(there), family="AF_UNIX"))
        except OSError:
            link.close()

    with (
        listening(there, lambda: cast(Intake, intakes)),
        listening_at(HOST, to_worker) as address,
        passing_pictures(here, (address.host, address.port, address.secret.hex())),
    ):
        yield here, intakes


def test_a_picture_waits_until_the_one_before_is_answered(far: tuple[Path, Intakes]) -> None:
    here, intakes = far
    intake = RelayedIntake(here)
    sending = threading.Thread(target=lambda: [intake.accept(picture(number)) for number in range(3)], daemon=True)
    sending.start()
    wait(lambda: intakes.got)
    time.sleep(0.3)
    assert intakes.got == [0]  # so the capture node drops and counts those that it may not send
    intakes.may_go_on.set()
    sending.join(60)
    assert intakes.got == [0, 1, 2]
    with pytest.raises(InputError, match="is not one of the rig's"):
        intake.accept(picture(3, "bad"))
    intake.close()
    assert intakes.closed.wait(5)


def test_pictures_have_nowhere_to_go_when_the_other_node_has_gone(tmp_path: Path) -> None:
    with passing_pictures(tmp_path / "here", (HOST, 1, "")):
        intake = RelayedIntake(tmp_path / "here")
        with pytest.raises(SessionError, match="try again later"):
            intake.accept(picture(0))
