"""Servers that share streams over NATS JetStream: what the hop costs, and how long pictures stay away after a kill.

    streamlod bench jetstream [--seconds 10 --repeats 10 --servers 3 --short]

Starts NATS servers, a node that plays a synthetic recording and publishes it, and a node that serves it, each a process
on this machine. The delay is between a packet's arrival at a viewer of the one node and at a viewer of the other; the
first of these waits for JetStream's acknowledgement, too. Whatever is killed with SIGKILL is started again at once,
except the leader of several NATS servers; what is told is the longest time without a new picture at a viewer of the
node that serves (after its own kill: until a viewer that connects again has a picture).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from streamlod.server.edge.jetstream.messages import Names
from tests.bench.edge_bench import hop_delay
from tests.bench.pictures import longest_gap
from tests.server.conftest import make_clip
from tests.server.edge.jetstream.nats_servers import Nats, nats
from tests.server.edge.jetstream.recorder import waiting_bytes
from tests.server.edge.processes import Node, begin, listening
from tests.server.ports import free_ports
from tests.waiting import wait

_ELECTION_SECONDS = 12.0  # in which the NATS servers that are left have a leader again
_SETTLE_SECONDS = 60.0
_COUNTS = (100, 400, 1500)  # anchors by level


class Pair:
    """A node that publishes and a node that serves, which can be killed and started again on their ports."""

    def __init__(self, folder: Path, clip: Path, shared: Nats) -> None:
        config = shared.config(folder / "shared.toml")
        self._folder = folder
        self._commands = (
            ("serve", "--play", clip, "--state-dir", folder / "state", "--config", config),
            ("serve", "--config", config),
        )
        self.nodes: list[Node] = []
        for command in self._commands:
            self.nodes.append(listening(begin(folder, *command, port=free_ports(1)[0])))
        wait(lambda: self.nodes[0].stream()["state"] == "live")
        wait(lambda: self.nodes[1].get("/v1/streams/main").status_code == 200)

    def restart(self, number: int) -> None:
        """Kill a node and start it again."""
        self.nodes[number].kill()
        self.nodes[number] = listening(begin(self._folder, *self._commands[number], port=self.nodes[number].port))

    def close(self) -> None:
        for each in self.nodes:
            each.kill()


def kill_nats(shared: Nats) -> None:
    """Kill the server that leads the stream; a single one is started again at once."""
    if len(shared.servers) == 1:
        shared.servers[0].kill()
        shared.servers[0].start()
    else:
        shared.leader(Names("streamlod").packets("main")).kill()


def main() -> None:
    """Run all rounds and print a line each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--servers", type=int, choices=(1, 3), default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--short", action="store_true", help="5 seconds, each fault twice")
    options = parser.parse_args()
    if options.short:
        options.seconds, options.repeats = 5.0, 2
    found: dict[str, Any] = {"NATS servers": options.servers}

    def note(name: str, value: Any) -> None:
        found[name] = value
        print(f"{name}: {value}", flush=True)

    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        clip = make_clip(folder / "clip.slod", 1000, _COUNTS, key_every=100).path
        shared = stack.enter_context(nats(folder / "nats", options.servers))
        pair = Pair(folder, clip, shared)
        stack.callback(pair.close)
        port = pair.nodes[1].port
        faults: dict[str, Callable[[], None]] = {
            "NATS leader": lambda: kill_nats(shared),
            "serving node": lambda: pair.restart(1),
            "publishing node": lambda: pair.restart(0),
        }
        note("delay behind the hop [ms]: p50, p99, packets", hop_delay(pair.nodes, options.seconds)["1 hops"])
        for what in ("NATS leader", "serving node", "publishing node"):
            gaps, seconds = [], _ELECTION_SECONDS if what == "NATS leader" else 3.0
            for _ in range(options.repeats):
                gaps.append(round(longest_gap(port, faults[what], seconds), 2))
                for server in shared.servers:
                    if server.process is None:
                        server.start()
                    server.wait()
                wait(lambda: waiting_bytes(pair.nodes[0]) == 0, _SETTLE_SECONDS)
            note(f"kill -9 of the {what}: longest time without a picture [s]", gaps)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
