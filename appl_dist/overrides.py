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

_ARGUMENT = re.compile(r"([~+]{0,2})([A-Za-z_][\w/.@-]*)(=.*)?", re.DOTALL)
_INTERPOLATION = re.compile(r"\$\{[^}]*\}")  # Hydra's, as in ${oc.env:USER}


def split(overrides: Sequence[str], schema: type) -> tuple[list[tuple[str, str]], list[str]]:
    """(key, text) of the text keys of the dataclass `schema`, and the other arguments for Hydra.

    UserError: an argument that is no key=value.
    """
    texts, others = [], []
    for override in overrides:
        match = _ARGUMENT.fullmatch(override)
        if match is None or (match[3] is None and not match[1].startswith("~")):
            raise UserError(f"argument {override!r}: expected key=value, as in run.transitions=50000")
        key, value = match[2], (match[3] or "")[1:]
        if match[1] in ("", "+", "++") and is_text(schema, key) and not _INTERPOLATION.search(value):
            texts.append((key, unquoted(value)))
        else:
            others.append(override)
    return texts, others


def is_text(schema: type, key: str) -> bool:
    """Whether `key` names a field of type str, or an entry of a map of them."""
    hint: Any = schema
    parts = key.split(".")
    for at, part in enumerate(parts):
        if typing.get_origin(hint) is dict:
            return typing.get_args(hint)[1] is str and all(parts[at:])
        if not dataclasses.is_dataclass(hint) or part not in (hints := typing.get_type_hints(hint)):
            return False
        hint = hints[part]
    return hint is str or typing.get_origin(hint) is typing.Literal


def assign(plain: dict[str, Any], key: str, text: str, schema: type) -> None:
    """Set `key` in nested maps; what follows a map's name is one entry, dots included."""
    hint: Any = schema
    *groups, last = key.split(".")
    for at, group in enumerate(groups):
        hint = typing.get_type_hints(hint)[group]
        plain = plain.setdefault(group, {})
        if typing.get_origin(hint) is dict:
            last = ".".join([*groups[at + 1 :], last])
            break
    plain[last] = text


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
