"""Maps from the wire as frozen dataclasses: every field there, of its type and within its bounds, or ValueError.

A dataclass states its own limits as `Annotated[int, Range(low, high)]` or `Annotated[str, Length(most)]`. Without
one an int is within 0..MAX_COUNT, a float is finite, and a string is printable and at most MAX_TEXT characters long.
A value of type Any is left to its reader.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

MAX_COUNT = 2**53  # exact in any language
MAX_TEXT = 255
MAX_ITEMS = 100_000

T = TypeVar("T")


@dataclass(frozen=True)
class Range:
    """The numbers a field allows, both ends included."""

    low: float
    high: float


@dataclass(frozen=True)
class Length:
    """The number of printable characters a string may have."""

    most: int


ANY_COUNT, ANY_FLOAT = Range(0, MAX_COUNT), Range(-math.inf, math.inf)


def decode(kind: type[T], values: object) -> T:
    """The dataclass `kind` from a received map; ValueError names the first field that is missing, unknown or wrong."""
    hints = _hints(typing.cast(typing.Hashable, kind))
    if not isinstance(values, Mapping):
        raise ValueError(f"{kind.__name__}: got {values!r:.40}; expected a map")
    if values.keys() != hints.keys():
        raise ValueError(f"{kind.__name__}: got fields {sorted(map(str, values))[:20]}; expected {sorted(hints)}")
    return kind(**{name: _value(hint, values[name], name, None) for name, hint in hints.items()})


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind, include_extras=True)


def _value(hint: Any, value: Any, name: str, limits: Range | Length | None) -> Any:
    if hint is Any:
        return value
    if dataclasses.is_dataclass(hint):
        return decode(typing.cast(type, hint), value)
    origin, inside = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _value(inside[0], value, name, inside[1])
    if origin in (types.UnionType, typing.Union):  # X | None
        return None if value is None else _value(inside[0], value, name, limits)
    if origin is tuple:
        if not isinstance(value, list | tuple) or len(value) > MAX_ITEMS:
            raise ValueError(f"{name}: got {value!r:.40}; expected a list of at most {MAX_ITEMS}")
        return tuple(_value(inside[0], item, name, limits) for item in value)
    if origin is dict:
        if not isinstance(value, dict) or len(value) > MAX_ITEMS:
            raise ValueError(f"{name}: got {value!r:.40}; expected a map of at most {MAX_ITEMS}")
        return {_value(inside[0], k, name, None): _value(inside[1], v, name, limits) for k, v in value.items()}
    return _plain(hint, value, name, limits)


def _plain(hint: Any, value: Any, name: str, limits: Range | Length | None) -> Any:
    if hint is float and type(value) is int and abs(value) <= MAX_COUNT:
        value = float(value)
    if type(value) is not hint:
        raise ValueError(f"{name}: got {value!r:.40}; expected {hint.__name__}")
    most = limits.most if isinstance(limits, Length) else MAX_TEXT
    if hint is str and not (len(value) <= most and value.isprintable()):
        raise ValueError(f"{name}: got {value!r:.40}; expected up to {most} printable characters")
    if hint in (int, float):
        allowed = limits if isinstance(limits, Range) else (ANY_COUNT if hint is int else ANY_FLOAT)
        if not (math.isfinite(value) and allowed.low <= value <= allowed.high):
            raise ValueError(f"{name}: got {value!r:.40}; allowed {allowed.low:g}..{allowed.high:g}")
    return value
