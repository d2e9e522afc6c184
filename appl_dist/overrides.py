"""`key=value` arguments: the value of a text key is taken as written, every other one follows Hydra's grammar.

Hydra guesses a type from what a value looks like: 20260101_120000 becomes a number, and `=`, `#` or `(` end the
parsing. What is text by the schema therefore never reaches it. Quotes around a whole value are optional.
"""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Sequence
from typing import Any

from appl_dist.errors import UserError

Text = str | list[str]

_ARGUMENT = re.compile(r"([~+]{0,2})([A-Za-z_][\w/.@-]*)(=.*)?", re.DOTALL)
_ITEM = re.compile(r"""\s*('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[^,'"\[\]]+?)\s*(?:,|$)""", re.DOTALL)
_INTERPOLATION = re.compile(r"\$\{[^}]*\}")  # Hydra's, as in ${oc.env:USER}


def split(overrides: Sequence[str], schema: type) -> tuple[list[tuple[str, Text]], list[str]]:
    """(key, text or texts) of the text keys of the dataclass `schema`, and the other arguments for Hydra.

    UserError: an argument that is no key=value.
    """
    texts: list[tuple[str, Text]] = []
    others = []
    for override in overrides:
        match = _ARGUMENT.fullmatch(override)
        if match is None or (match[3] is None and not match[1].startswith("~")):
            raise UserError(f"argument {override!r}: expected key=value, as in run.transitions=50000")
        key, value = match[2], (match[3] or "")[1:]
        text: Text | None = None
        if match[1] in ("", "+", "++") and not _INTERPOLATION.search(value):
            hint = _hint(schema, key)
            if hint is str or typing.get_origin(hint) is typing.Literal:
                text = unquoted(value)
            elif hint == tuple[str, ...]:
                text = _listed(value)
        if text is None:
            others.append(override)
        else:
            texts.append((key, text))
    return texts, others


def path(schema: type, key: str) -> list[str]:
    """The names along `key`; what follows a map's name is one entry, dots included."""
    hint: Any = schema
    names = key.split(".")
    for at, name in enumerate(names):
        if typing.get_origin(hint) is dict:
            return [*names[:at], ".".join(names[at:])]
        hint = _field(hint, name)
    return names


def assign(plain: dict[str, Any], key: str, text: Text, schema: type) -> None:
    """Set `key` in nested maps."""
    *groups, last = path(schema, key)
    for group in groups:
        plain = plain.setdefault(group, {})
    plain[last] = text


def _hint(schema: type, key: str) -> Any:
    """The type of what `key` names; None if it names nothing."""
    hint: Any = schema
    for name in path(schema, key):
        hint = typing.get_args(hint)[1] if typing.get_origin(hint) is dict and name else _field(hint, name)
    return hint


def _field(hint: Any, name: str) -> Any:
    return typing.get_type_hints(hint).get(name) if dataclasses.is_dataclass(hint) else None


def _listed(value: str) -> list[str] | None:
    """The texts in "[a, 'b,c']"; None if that is no such list."""
    if not (value.startswith("[") and value.endswith("]")):
        return None
    items, at, inside = [], 0, value[1:-1].strip()
    while at < len(inside):
        match = _ITEM.match(inside, at)
        if match is None:
            return None
        items.append(unquoted(match[1]))
        at = match.end()
    return items


def quoted(key: str, value: object) -> str:
    """`key=value` as an argument for another process, whatever the text holds."""
    if not isinstance(value, str):
        return f"{key}={value}"
    inside = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"{key}='{inside}'"


def unquoted(value: str) -> str:
    """The text of a value in quotes, `\\'` being a quote; a value without them as it is."""
    if len(value) < 2 or value[0] not in "'\"" or value[-1] != value[0]:
        return value
    return re.sub(r"\\([\\'\"])", r"\1", value[1:-1])
