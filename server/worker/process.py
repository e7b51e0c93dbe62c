"""The process that makes a stream's packets, by training or from a recorded file. It reports to its supervisor by pipe.

No other part of the server runs in this process, so a crash, a memory
leak or a kill costs viewers only a short pause.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

from streamlod.core.background_log import log_in_background
from streamlod.core.errors import BackendUnavailable, BitstreamError, InputError, StreamlodError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker.messages import Sender, Tag, receive_resume
from streamlod.server.worker.playing import play
from streamlod.server.worker.training import NICENESS, load, show_again, train

_LOG = logging.getLogger(__name__)
HEARTBEAT_SECONDS = 1.0
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def run_worker(
    spec: StreamSpec,
    pipe: Connection,
    push_socket: Path | None = None,
    spare: bool = False,
    camera_pictures: bool = False,
) -> None:
    """Entry of the process; returns when the source ends, and never raises.

    Args:
        pipe: to the supervisor, which first sends where to continue.
        push_socket: where to take pictures that capture nodes push to the serving process.
        spare: load everything before it is needed.
        camera_pictures: also send small pictures of what the cameras see.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the supervisor decides
    log_in_background()
    sender = Sender(pipe)
    try:
        loading = None
        if spare and spec.job is not None:
            loading = threading.Thread(target=load, args=(spec.job,), daemon=True, name="loading")
            loading.start()
        resume = receive_resume(pipe)
        threading.Thread(target=_beat, args=(sender,), daemon=True, name="heartbeat").start()
        if spec.job is None:
            play(spec, resume, sender)
        else:
            scene = show_again(resume, sender) if resume.packets else None
            os.nice(NICENESS)
            if loading is not None:
                loading.join()
            train(spec.job, scene, resume.frames, sender, push_socket, camera_pictures)
        sender.send(Tag.END)
    except StreamlodError as error:
        sender.send(Tag.FAILURE, {"text": str(error), "fatal": _is_fatal(error, spec)})
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the supervisor is gone
    except Exception as error:
        _LOG.exception("worker of stream %s", spec.id)
        sender.send(Tag.FAILURE, {"text": f"{type(error).__name__}: {error}", "fatal": False})


def _is_fatal(error: StreamlodError, spec: StreamSpec) -> bool:
    """Whether another try cannot help: unusable input stays as it is, and so does a file that is played."""
    return isinstance(error, InputError | BackendUnavailable) or (
        spec.play is not None and isinstance(error, BitstreamError)
    )


def resident_bytes(pid: int | None) -> int:
    """Resident memory of a process of this machine; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_BYTES
    except (OSError, IndexError, ValueError):
        return 0


def _beat(sender: Sender) -> None:
    try:
        while True:
            sender.send(Tag.HEARTBEAT, resident_bytes(os.getpid()).to_bytes(8))
            time.sleep(HEARTBEAT_SECONDS)
    except OSError:
        os._exit(1)  # the supervisor is gone; nobody needs this process
