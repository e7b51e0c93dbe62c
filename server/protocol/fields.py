"""Fields of messages that are numbers or flags, refused with close code 4400 where they are anything else."""

from __future__ import annotations

from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError

_MAX_INTEGER = 2**53  # the largest integers that every JSON reader keeps exactly


def whole(value: object, name: str) -> int:
    """The integer of at least 0 of a field.

    Raises:
        SessionError: 4400, it is anything else.
    """
    if type(value) is not int or not 0 <= value <= _MAX_INTEGER:
        raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must be an integer of at least 0")
    return value


def flag(message: dict[str, Any], name: str) -> bool:
    """The boolean of a field, False without it.

    Raises:
        SessionError: 4400, it is anything else.
    """
    value = message.get(name, False)
    if not isinstance(value, bool):
        raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must be true or false")
    return value


def numbers(message: dict[str, Any], name: str, count: int, largest: float) -> list[float]:
    """The numbers of a field.

    Raises:
        SessionError: 4400, there are others than `count`, or some are larger than `largest`.
    """
    values = message.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must be a list of {count} numbers")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= largest:  # also for NaN
            raise SessionError(CloseCode.BAD_MESSAGE, f"{name} must hold numbers of at most {largest:g}")
    return [float(value) for value in values]
