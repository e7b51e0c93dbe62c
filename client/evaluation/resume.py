"""Resume an earlier measurement: results that its report holds are not measured again."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)


def earlier_report(path: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The report at `path` if each of `facts` (data, machine, protocol, ...) is the same in it; empty otherwise.

    A report does not know which program wrote it: after a change of the method, measure into a new folder.

    Raises:
        InputError: the file cannot be read or is not JSON. Other files, with other facts, are replaced.
    """
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:
        raise InputError(path, f"is not a report ({error}); name another folder for the results") from error
    if not isinstance(found, dict) or any(found.get(name) != as_json(value) for name, value in facts.items()):
        _log.info("%s was measured differently and is replaced", path)
        return {}
    return found


def as_json(value: Any) -> Any:
    """`value` as it comes back from a JSON file, to compare with one."""
    return json.loads(json.dumps(value))
