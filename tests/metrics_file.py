"""metrics.jsonl of a run that a learner is writing to, for tests that follow one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def records(run: Path) -> list[dict[str, Any]]:
    """The whole lines so far, oldest first; a line being written, or cut by a kill, is left out."""
    file = run / "metrics.jsonl"
    lines = file.read_text().splitlines(keepends=True) if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def transitions(run: Path) -> int:
    """Transitions in replay, as last written; 0 before the first line."""
    return next((int(record["step"]) for record in reversed(records(run))), 0)
