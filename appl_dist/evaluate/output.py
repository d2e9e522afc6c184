"""Results written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from appl_dist.errors import UserError


def write_atomic(path: Path, data: str | bytes) -> None:
    """Replace `path` by `data`; a reader sees the old file or the new one. UserError if it cannot."""
    partial = path.with_name(path.name + ".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data.encode() if isinstance(data, str) else data)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError(
            f"{path}: {error.strerror}; finished trials are kept, run the same command again to write the results"
        ) from None
