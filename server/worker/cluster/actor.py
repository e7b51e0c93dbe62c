"""The program that runs on the cluster: the same worker as in a local process, connected by TCP."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing.connection import Client, Connection
from pathlib import Path

import ray

from streamlod.core.background_log import log_in_background
from streamlod.core.version import streamlod_version
from streamlod.server.ingest.push.relay import pass_on
from streamlod.server.ingest.push.socket_folder import SocketFolder
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker.cluster.link import LinkAddress, dial, listening_at
from streamlod.server.worker.process import run_worker


class WorkerActor:
    """One worker; Ray ends it with the local process that has placed it."""

    def run(self, spec: StreamSpec, back: LinkAddress, cpus: float, spare: bool, camera_pictures: bool) -> None:
        """Work until the source ends.

        Args:
            spec: what to work on.
            back: where the local process waits for a connection.
            cpus: so many threads are used.
            spare, camera_pictures: as of `run_worker`.
        """
        threads = str(max(1, math.ceil(cpus)))
        os.environ |= {"OMP_NUM_THREADS": threads, "NUMBA_NUM_THREADS": threads}  # read when training is loaded
        log_in_background()
        with _taking_pictures(spec) as (socket, address), closing(dial(back)) as link:
            told = None if address is None else [address.host, address.port, address.secret.hex()]
            link.send_bytes(json.dumps({"version": streamlod_version(), "pictures": told}).encode())
            run_worker(spec, link, socket, spare, camera_pictures)


@contextmanager
def _taking_pictures(spec: StreamSpec) -> Iterator[tuple[Path | None, LinkAddress | None]]:
    """Where the worker listens for pushed pictures, and where the local process can pass these on to it, if any."""
    if not spec.is_live:
        yield None, None
        return
    folder = SocketFolder()
    path = folder.new_socket()

    def serve(link: Connection) -> None:
        try:
            pipe = Client(str(path), family="AF_UNIX")
        except OSError:  # it takes none now
            link.close()
            return
        pass_on(link, pipe)

    try:
        host = ray.util.get_node_ip_address()  # type: ignore[no-untyped-call]
        with listening_at(host, serve) as address:
            yield path, address
    finally:
        folder.close()
