"""Arrays that live in sparse files and claim disk before they write, so a full disk is an error, not SIGBUS.

Storing into a memory map of a sparse file on a full disk kills the process with SIGBUS: no exception, no
message. `claim` therefore has the file system reserve each chunk (posix_fallocate) before its first store.
Stores survive the death of the process (the kernel owns the pages); only `sync` survives a power cut.
"""

from __future__ import annotations

import json
import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.files import explain, lock, write_atomic

CHUNK_BYTES = 8 << 20


class MappedArray:
    """`data`, a 1-D array of `length` zero-initialised records, in a sparse file or (path None) in memory."""

    def __init__(self, path: Path | None, dtype: np.dtype[Any], length: int) -> None:
        self.path = path
        self.bytes = dtype.itemsize * length
        self._fd: int | None = None
        self.data: NDArray[Any]
        if path is None:
            self.data = np.zeros(length, dtype)  # untouched pages cost no memory either
            return
        self._claimed = np.zeros(-(-self.bytes // CHUNK_BYTES), np.bool_)
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        size = os.fstat(self._fd).st_size
        if size not in (0, self.bytes):
            os.close(self._fd)
            raise UserError(f"{path}: has {size} bytes, expected {self.bytes}; damaged or from another version")
        try:
            os.ftruncate(self._fd, self.bytes)
        except OSError as e:
            os.close(self._fd)
            raise UserError(f"{path}: cannot be {self.bytes} bytes long: {e.strerror}") from None
        self._map = mmap.mmap(self._fd, self.bytes)
        self._map.madvise(mmap.MADV_RANDOM)  # sampling jumps about: reading ahead would only evict pages
        self.data = np.ndarray(length, dtype, self._map)

    def claim(self, start: int, stop: int) -> None:
        """Make records [start, stop) safe to store into. UserError if the disk has no room for them."""
        if self._fd is None:
            return
        assert self.path is not None
        first = start * self.data.itemsize // CHUNK_BYTES
        last = (stop * self.data.itemsize - 1) // CHUNK_BYTES
        for chunk in range(first, last + 1):
            if self._claimed[chunk]:
                continue
            offset = chunk * CHUNK_BYTES
            size = min(CHUNK_BYTES, self.bytes - offset)
            try:
                os.posix_fallocate(self._fd, offset, size)
            except OSError as e:
                raise UserError(
                    f"{self.path}: cannot claim {size / 2**20:.0f} MB more on disk: {e.strerror}. "
                    "Nothing stored is lost: free some space, or choose another folder or a smaller capacity"
                ) from None
            self._claimed[chunk] = True

    def sync(self) -> None:
        """Wait until every store is on disk (process death never loses a store, a power cut can)."""
        if self._fd is not None:
            os.fdatasync(self._fd)

    def close(self) -> None:
        """Let go of the file. `data` of a file is unusable afterwards."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
            self.data = np.zeros(0, self.data.dtype)  # the map unmaps itself with its last view
            del self._map


class FolderClaim:
    """One process's hold on a replay folder, and the record of what its files were made for.

    UserError if another process holds it, or if its meta.json differs from `meta`. Files without a complete
    meta.json are left-overs of a start that never came to storing anything, and are removed.
    """

    def __init__(self, folder: Path, meta: dict[str, Any], files: Sequence[str]) -> None:
        self.folder, self.meta = folder, meta
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as e:
            raise UserError(f"replay folder {folder}: cannot be used: {explain(e)}") from None
        try:
            lock(self._fd, folder / "lock", f"replay folder {folder}: another learner is using it")
            if (folder / "meta.json").exists():
                self._check()
            else:
                for name in files:
                    (folder / name).unlink(missing_ok=True)
        except BaseException:
            self.release()
            raise

    def complete(self) -> None:
        """Record, once every file exists, what they are for."""
        write_atomic(self.folder / "meta.json", json.dumps(self.meta), sync=True)

    def release(self) -> None:
        """Let another process have the folder."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _check(self) -> None:
        try:
            found = json.loads((self.folder / "meta.json").read_text("utf-8"))
        except (OSError, ValueError) as e:
            raise UserError(f"replay folder {self.folder}: meta.json cannot be read: {e}") from None
        for key, wanted in self.meta.items():
            got = found.get(key) if isinstance(found, dict) else None
            if got != wanted:
                raise UserError(
                    f"replay folder {self.folder}: {key} is {got!r} there, this run has {wanted!r}; "
                    "continue with the settings it was made with, or choose an empty folder"
                )
