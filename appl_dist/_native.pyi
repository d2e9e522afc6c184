"""The C core is typed at its Python wrappers (sim/, planner/), which check what goes in and what comes out."""

from typing import Any

def __getattr__(name: str) -> Any: ...
