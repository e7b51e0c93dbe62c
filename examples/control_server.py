"""Control a server: python examples/control_server.py http://127.0.0.1:8000 scene.slod

Creates a stream that plays a recording, waits until it is live, and deletes it. The server must be able to read the
file, and take it from this address: docs/operations.md says who may name files.
"""

from __future__ import annotations

import os
import sys

from streamlod import ServerClient


def main(address: str, path: str) -> None:
    with ServerClient(address, token=os.environ.get("STREAMLOD_TOKEN")) as server:
        print("version", server.server()["version"])
        server.create("example", {"play": path, "start": True})
        try:
            for event in server.events("example", last_id="0"):
                print(f"{event.type} {dict(event.data)}")
                if server.stream("example").state in {"live", "ended", "failed"}:
                    break
            print([stream.id for stream in server.streams()])
        finally:
            server.delete("example")


if __name__ == "__main__":
    main(*sys.argv[1:])
