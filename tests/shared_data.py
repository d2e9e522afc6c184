"""Reference data kept beside the repository: `shared("reference", "tp.jsonl.gz")`.

The data is too large for the repository; it lies in a folder `shared` next to it. A checkout without it
skips the tests that need it; a build server (CI=true) must have it and fails without.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[1].parent / "shared"


def shared(*parts: str) -> Path:
    """Path of a reference file; without it skips the calling test, or fails it when CI=true."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        reason = f"reference data {'/'.join(parts)} is not in ../shared, beside the repository"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return path
