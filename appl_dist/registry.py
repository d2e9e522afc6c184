"""Names that a configuration may choose from, one `Registry` a kind: policies, rewards, observations, protocols.

A configuration, which the learner also serves to its actors, holds names and never import paths: it chooses among what
is installed on each machine, and runs no other code. A user's package adds names by an entry point of the group
`appl_dist`: the module it names is imported when a name is unknown without it (docs/extending.md).
"""

from __future__ import annotations

import functools
import importlib.metadata
from typing import Generic, TypeVar

from appl_dist.errors import UserError

T = TypeVar("T")
ENTRY_POINTS = "appl_dist"


class Registry(Generic[T]):
    """Name to `T` for one `kind` of thing, such as "policy"."""

    def __init__(self, kind: str, entries: dict[str, T]) -> None:
        self.kind = kind
        self._entries = dict(entries)

    def register(self, name: str, entry: T) -> None:
        """Add `entry`. ValueError: the name is taken, or is not letters, digits, '_' and '-'."""
        if name in self._entries:
            raise ValueError(f"{self.kind} {name!r}: the name is taken; registered are {', '.join(self.names())}")
        if not name.replace("_", "a").replace("-", "a").isalnum():
            raise ValueError(f"{self.kind} {name!r}: a name has letters, digits, '_' and '-'")
        self._entries[name] = entry

    def get(self, name: str) -> T:
        """The entry of `name`; UserError lists the known names."""
        if name not in self:
            raise UserError(f"{self.kind}: got {name!r}; allowed {', '.join(self.names())}")
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        if name not in self._entries:
            _load_plugins()
        return name in self._entries

    def names(self) -> list[str]:
        """The known names in alphabetical order."""
        return sorted(self._entries)


@functools.cache
def _load_plugins() -> None:
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:
            raise UserError(f"entry point {point.name} = {point.value}: cannot be loaded: {error}") from error
