"""The process that says whether settings of the method can be, for `server.pipeline.checks`.

Standard input has ``{"preset": NAME, "set": {NAME: VALUE}}``; the output is ``[SUBJECT, FAULT]`` of the refusal, or
nothing.
"""

from __future__ import annotations

import json
import sys

from streamlod.core.errors import InputError
from streamlod.core.train import preset
from streamlod.core.train.presets.settings import with_settings


def main() -> None:
    """Check what standard input has."""
    given = json.load(sys.stdin)
    try:
        with_settings(preset(given["preset"]), given["set"])
    except InputError as error:
        sys.stdout.write(json.dumps([error.subject, error.fault]))


if __name__ == "__main__":
    main()
