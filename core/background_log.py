"""A log that holds nobody up: a thread writes it, and lines are left out while nobody takes them.

A write to a pipe blocks once its reader stands still, and the event loop with it; one to a pipe without a reader, or
to a full disk, fails.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import threading
import time
from datetime import UTC, datetime

LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
LOG_FORMAT_VARIABLE = "STREAMLOD_LOG_FORMAT"  # of the environment, so that workers have it too: text or json
MAX_LINES = 1000  # that wait
_FLUSH_SECONDS = 1.0
_STDERR = 2


class BackgroundHandler(logging.Handler):
    """Writes records to a file descriptor, from a thread of its own.

    Args:
        descriptor: of the log.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()  # unlike Queue, signal handlers may put into it
        self._left_out, self._writing = 0, False
        threading.Thread(target=self._run, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Have the record written soon, or leave it out where too many wait."""
        if self._lines.qsize() >= MAX_LINES:
            self._left_out += 1
            return
        try:
            self._lines.put(self.format(record))
        except Exception:
            self.handleError(record)

    def flush(self) -> None:
        """Wait a moment for what is not written yet."""
        limit = time.monotonic() + _FLUSH_SECONDS
        while (self._writing or not self._lines.empty()) and time.monotonic() < limit:
            time.sleep(0.01)

    def _run(self) -> None:
        while True:
            line, self._writing = self._lines.get(), True
            count, self._left_out = self._left_out, 0
            self._write(f"{line}\n" + (f"({count} lines were left out, as nobody took them)\n" if count else ""))
            self._writing = False

    def _write(self, text: str) -> None:
        data = memoryview(text.encode(errors="backslashreplace"))
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:  # nobody reads, or the disk is full: there is nowhere to say so
            return


class JsonFormatter(logging.Formatter):
    """A record as one line of JSON: time, level, logger, message, and its facts (`extra={"facts": ...}`)."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        time_text = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        line = {"time": time_text, "level": record.levelname, "logger": record.name, "message": record.getMessage()}
        line |= getattr(record, "facts", {})
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line)


def log_in_background() -> None:
    """From now on, have what goes to the process's log written by a thread, in the format of the environment."""
    handler = BackgroundHandler(_STDERR)
    as_json = os.environ.get(LOG_FORMAT_VARIABLE) == "json"
    handler.setFormatter(JsonFormatter() if as_json else logging.Formatter(LOG_FORMAT))
    logging.getLogger().handlers = [handler]
    logging.captureWarnings(True)
