"""`trials.csv`: one row a finished trial, appended and flushed, safe to interrupt and to go on from.

    # appl_dist trials 1 config 5f0c…        format version, hash of what all rows have in common
    method,policy,world,trial,seed,…          the fields of the row's dataclass
    default,3a7b…,17,0,6188…,…

A row that was cut short by a crash or a full disk is dropped; floats are written so that reading gives
the same bits back. A lock keeps a second evaluation out of the folder.
"""

from __future__ import annotations

import csv
import fcntl
import io
import logging
import os
from collections.abc import Iterable
from dataclasses import astuple, fields
from pathlib import Path
from types import TracebackType
from typing import Any, get_type_hints

from appl_dist.errors import UserError

log = logging.getLogger(__name__)

_MAGIC = "# appl_dist trials 1 config "


class TrialLog:
    """Rows of the frozen dataclass `row_type` (str, int, float and bool fields, a `key`) in a file.

    Opening creates the folder and the file, or reads the rows that are there into `rows` by key.
    Raises UserError if the file belongs to another configuration, is no trial log, is being written by
    another process, or cannot be written.
    """

    def __init__(self, path: Path, row_type: type, config_hash: str) -> None:
        self.path = path
        self.rows: dict[Any, Any] = {}
        self._type = row_type
        self._names = [f.name for f in fields(row_type)]
        hints = get_type_hints(row_type)
        self._parsers = [_PARSERS[hints[name]] for name in self._names]
        self._header = f"{_MAGIC}{config_hash}\n{','.join(self._names)}\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UserError(f"{path}: {error.strerror}; choose a folder that can be written") from None
        try:
            self._lock()
            self._read()
        except BaseException:
            os.close(self._fd)
            raise

    def __enter__(self) -> TrialLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)

    def append(self, row: Any) -> None:
        """Write one row through to the system; on failure the file is left at its last whole row."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(_cell(v) for v in astuple(row))
        self._write(text.getvalue().encode())
        self.rows[row.key] = row

    def matching(self, jobs: Iterable[Any]) -> dict[Any, Any]:
        """The rows that answer one of `jobs`, by key; UserError if a row is of another policy or seed."""
        found = {}
        for job in jobs:
            row = self.rows.get(job.key)
            if row is None:
                continue
            if row.policy != job.policy:
                raise UserError(
                    f"{self.path}: method {job.method!r} was measured with policy {row.policy} and is now "
                    f"{job.policy}; give the changed policy another label or evaluate into another folder"
                )
            if row.seed != job.seed:
                raise UserError(f"{self.path}: rows have other seeds than asked for; use another folder")
            found[job.key] = row
        return found

    def _lock(self) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"{self.path}: another evaluation is writing here; wait or use another folder") from None

    def _read(self) -> None:
        with open(self._fd, "rb", closefd=False) as file:
            data = file.read()
        header = self._header.encode()
        if header.startswith(data):  # empty, or cut short in the header
            os.ftruncate(self._fd, 0)
            os.lseek(self._fd, 0, os.SEEK_SET)
            self._size = 0
            self._write(header)
            return
        magic, columns = header.split(b"\n")[:2]
        first, _, rest = data.partition(b"\n")
        second = rest.partition(b"\n")[0]
        if not first.startswith(_MAGIC.encode()):
            raise UserError(f"{self.path}: is not a trial log; move it away or use another folder")
        if first != magic:
            raise UserError(
                f"{self.path}: holds trials of other settings "
                f"({first.decode('utf8', 'replace').removeprefix('# ')}, now {magic.decode().split()[-1]}); "
                "use another folder or the settings of then"
            )
        if second != columns:
            raise UserError(f"{self.path}: has other columns than this version writes; use another folder")
        self._size = len(header)
        lines = data[len(header) :].splitlines(keepends=True)
        for number, line in enumerate(lines, start=3):
            row = self._row(line)
            if row is None and number == len(lines) + 2:
                break
            if row is None:
                raise UserError(f"{self.path}: line {number} is no trial; correct or delete the line")
            self.rows[row.key] = row
            self._size += len(line)
        if self._size < len(data):
            log.warning("%s: dropped %d bytes after the last whole row", self.path, len(data) - self._size)
            os.ftruncate(self._fd, self._size)
        os.lseek(self._fd, self._size, os.SEEK_SET)

    def _row(self, line: bytes) -> Any | None:
        if not line.endswith(b"\n"):
            return None
        try:
            cells = next(csv.reader([line.decode()]))
            return self._type(*(parse(c) for parse, c in zip(self._parsers, cells, strict=True)))
        except (ValueError, StopIteration):
            return None

    def _write(self, data: bytes) -> None:
        try:
            written = os.write(self._fd, data)
            if written < len(data):
                written += os.write(self._fd, data[written:])  # a full disk raises here
        except OSError as error:
            os.ftruncate(self._fd, self._size)
            os.lseek(self._fd, self._size, os.SEEK_SET)
            raise UserError(
                f"{self.path}: {error.strerror}; the {len(self.rows)} trials before are kept, "
                "make room and run the same command to go on"
            ) from None
        self._size += len(data)


def _cell(value: Any) -> str:
    return str(int(value)) if isinstance(value, bool) else str(value)


def _parse_bool(text: str) -> bool:
    if text not in ("0", "1"):
        raise ValueError(text)
    return text == "1"


_PARSERS: dict[Any, Any] = {str: str, int: int, float: float, bool: _parse_bool}
