"""Resume an earlier measurement: results that its report holds stay, and are not measured again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from streamlod.core.data.names import spoken
from streamlod.core.errors import InputError


def earlier_report(path: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The report at `path`, of which each of `facts` (data, machine, protocol, ...) holds; empty if there is no file.

    A report does not know which program wrote it: after a change of the method, measure into a new folder.

    Raises:
        InputError: the file cannot be read, is not JSON, or was measured differently. It is never replaced.
    """
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:
        raise InputError(path, f"is not a report ({error}); name another folder for the results") from error
    if not isinstance(found, dict):
        raise InputError(path, "is not a report; name another folder for the results")
    other = [each for name, value in facts.items() for each in _differing(name, as_json(value), found.get(name))]
    if other:
        fault = f"holds measurements that differ in {spoken(other)}; name another folder by --out, or remove it"
        raise InputError(path, fault)
    return found


def with_earlier(
    wanted: Sequence[dict[str, Any]],
    earlier: Sequence[dict[str, Any]],
    runs: str,
    same: Callable[[dict[str, Any]], Any],
) -> list[dict[str, Any]]:
    """The `wanted` entries of a report with the runs that `earlier` ones hold, then those that nothing new replaces.

    Args:
        runs: key of an entry's runs. same: what entries have in common of which one continues the other. Where that
            has changed, the wanted entry of a name takes the earlier one's place.
    """
    found = {json.dumps(same(entry), sort_keys=True): entry for entry in earlier}
    names = {entry["name"] for entry in wanted}
    continued = (found.get(json.dumps(same(entry), sort_keys=True), entry) for entry in wanted)
    begun = [{**old, **new, runs: old[runs]} for new, old in zip(wanted, continued, strict=True)]
    return [*begun, *(entry for entry in earlier if entry["name"] not in names)]


def missing_seeds(entry: dict[str, Any], runs: str, seeds: int) -> list[int]:
    """Which of the first `seeds` an entry has no run of."""
    return sorted({*range(seeds)} - {run["seed"] for run in entry[runs]})


def _differing(name: str, wanted: Any, found: Any) -> list[str]:
    """The name of a fact if it differs, or those of its parts that do where it has parts."""
    if isinstance(wanted, dict) and isinstance(found, dict):
        return [part for part in sorted({*wanted, *found}) if wanted.get(part) != found.get(part)]
    return [] if wanted == found else [name]


def as_json(value: Any) -> Any:
    """`value` as it comes back from a JSON file, to compare with one."""
    return json.loads(json.dumps(value))
