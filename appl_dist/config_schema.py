"""Frozen settings dataclasses as OmegaConf schemas and back, and OmegaConf's complaints as sentences."""

from __future__ import annotations

import copy
import dataclasses
import functools
import re
import typing
from dataclasses import field
from typing import Any, TypeVar

from hydra.errors import OverrideParseException
from omegaconf.errors import OmegaConfBaseException

from appl_dist.config_groups import choices

T = TypeVar("T")


@functools.cache
def schema_of(cls: type) -> type:
    """A mutable twin of a frozen settings class: OmegaConf takes `frozen` to mean that nothing may be overridden."""
    hints = typing.get_type_hints(cls)
    rows: list[Any] = []
    for f in dataclasses.fields(cls):
        hint = hints[f.name]
        if dataclasses.is_dataclass(hint):
            twin = schema_of(typing.cast(type, hint))
            rows.append((f.name, twin, field(default_factory=twin)))
        elif f.default is not dataclasses.MISSING:
            default: Any = list(f.default) if isinstance(f.default, tuple) else f.default
            rows.append((f.name, _plain(hint), field(default_factory=functools.partial(copy.copy, default))))
        elif f.default_factory is not dataclasses.MISSING:
            rows.append((f.name, _plain(hint), field(default_factory=f.default_factory)))
        else:
            rows.append((f.name, _plain(hint), "???"))
    return dataclasses.make_dataclass(cls.__name__, rows)


def _plain(hint: Any) -> Any:
    """A type OmegaConf can check: literals become strings, tuples of any length become lists."""
    origin = typing.get_origin(hint)
    if origin is typing.Literal:
        return str
    if origin is tuple:
        return list[typing.get_args(hint)[0]]  # type: ignore[misc]
    return hint


def build(cls: type[T], values: dict[str, Any]) -> T:
    """The dataclass of nested plain `values`, every field given. ValueError: what its own checks refuse."""
    hints = typing.get_type_hints(cls)
    arguments: dict[str, Any] = {}
    for f in dataclasses.fields(cls):  # type: ignore[arg-type]
        value = values[f.name]
        if dataclasses.is_dataclass(hints[f.name]):
            value = build(typing.cast(type, hints[f.name]), value)
        elif isinstance(value, list):
            value = tuple(value)
        arguments[f.name] = value
    return cls(**arguments)


def sentence(error: BaseException) -> str:
    """One line of a Hydra or OmegaConf error, with the key it is about."""
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    key = getattr(cause, "full_key", None)
    first = " ".join(line.strip() for line in str(cause).splitlines()[:1])
    if isinstance(error, OverrideParseException) and error.override.partition("=")[0] not in first:
        name, _, value = error.override.partition("=")
        return f"{name}: cannot read {value!r}: {first}; a value with special characters needs quotes: \"{name}='…'\""
    choice = re.search(r"Could not find '(\w+)/([^']*)'", first)
    if choice:
        return f"{choice[1]}: got {choice[2]!r}; allowed {', '.join(choices(choice[1]))}"
    first = re.sub(r"Could not override '([^']+)'\.?", r"\1: no such key.", first)
    first = re.sub(r"Key '[^']+' is not in struct", "no such key; `appl-dist train --help` lists them", first)
    first = re.sub(r"Ambiguous value for argument '([^']+)'", r"\1: a value with commas needs quotes: key='a,b'", first)
    if key and not first.startswith(str(key)):
        first = f"{key}: {first}"
    return first
