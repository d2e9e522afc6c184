"""`trials.csv`: one row a finished trial, appended and flushed, safe to interrupt and to go on from.

    # appl_dist trials 2 protocol appl config 5f0c…    format version, what all rows have in common
    method,policy,protocol,world,course,trial,…         the fields of the row's dataclass
    default,3a7b…,appl,17,90d3…,0,6188…,…

CSV and not Parquet: a row is appended and whole the moment a trial ends, where a Parquet file is unreadable
until its footer is written; any tool reads it, and 24,000 trials with their traces are about 15 MB.
A row that was cut short by a crash or a full disk is dropped; floats are written so that reading gives
the same bits back. A lock keeps a second evaluation out of the folder.
"""

from __future__ import annotations

import csv
import io
import logging
import os
import re
from collections.abc import Iterable
from dataclasses import astuple, fields
from pathlib import Path
from types import TracebackType
from typing import Any, get_type_hints

from appl_dist.errors import UserError
from appl_dist.files import explain, lock

log = logging.getLogger(__name__)

_MAGIC = "# appl_dist trials 2 "
_HEADER = re.compile(r"# appl_dist trials 2 protocol (\S*) config (\S*)")


class TrialLog:
    """Rows of the frozen dataclass `row_type` (str, int, float and bool fields, a `key`) in a file.

    Opening creates the folder and the file, or reads the rows that are there into `rows` by key.
    Raises UserError if the file belongs to another protocol or configuration, is no trial log, is being
    written by another process, or cannot be written.
    """

    def __init__(self, path: Path, row_type: type, protocol: str, config_hash: str) -> None:
        self.path = path
        self.rows: dict[Any, Any] = {}
        self._type = row_type
        self._header = f"{_MAGIC}protocol {protocol} config {config_hash}\n{_columns(row_type)}\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UserError(f"{path}: cannot be written: {explain(error)}") from None
        try:
            lock(self._fd, path, f"{path}: another evaluation is writing here; wait or use another folder")
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
            if row.course != job.course:
                raise UserError(f"{self.path}: world {job.world} was another course then; use another folder")
            found[job.key] = row
        return found

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
        rows, self._size, found = _parse(self.path, data, self._type)
        wanted = self._header.partition("\n")[0]
        if found != wanted:
            (old, old_config), (new, new_config) = (_HEADER.fullmatch(h).groups() for h in (found, wanted))  # type: ignore[union-attr]
            if old != new:
                raise UserError(
                    f"{self.path}: holds trials of protocol {old!r}, this is {new!r}; "
                    "times of different protocols do not compare: use another folder"
                )
            raise UserError(
                f"{self.path}: holds trials of other settings (config {old_config}, now {new_config}); "
                "use another folder or the settings of then"
            )
        self.rows = rows
        if self._size < len(data):
            log.warning("%s: dropped %d bytes after the last whole row", self.path, len(data) - self._size)
            os.ftruncate(self._fd, self._size)
        os.lseek(self._fd, self._size, os.SEEK_SET)

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


def read_rows(path: Path, row_type: type) -> tuple[list[Any], str]:
    """The whole rows of a trial log, also of one that is being written, and its config hash. Raises UserError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); expected the trials of an evaluation") from None
    rows, _, header = _parse(path, data, row_type)
    return list(rows.values()), _HEADER.fullmatch(header).group(2)  # type: ignore[union-attr]


def _columns(row_type: type) -> str:
    return ",".join(f.name for f in fields(row_type))


def _parse(path: Path, data: bytes, row_type: type) -> tuple[dict[Any, Any], int, str]:
    """Rows by key, the bytes they and the header take, and the first line."""
    lines = data.splitlines(keepends=True)
    first = lines[0].decode("utf8", "replace").rstrip("\n") if lines else ""
    if _HEADER.fullmatch(first) is None:
        older = re.match(r"# appl_dist trials (\d+) ", first)
        what = f"is of format {older.group(1)}, this version reads 2" if older else "is not a trial log"
        raise UserError(f"{path}: {what}; move it away or use another folder")
    if len(lines) < 2 or lines[1].decode("utf8", "replace").rstrip("\n") != _columns(row_type):
        raise UserError(f"{path}: has other columns than this version writes; use another folder")
    hints = get_type_hints(row_type)
    parsers = [_PARSERS[hints[f.name]] for f in fields(row_type)]
    rows: dict[Any, Any] = {}
    size = len(lines[0]) + len(lines[1])
    for number, line in enumerate(lines[2:], start=3):
        row = _row(line, row_type, parsers)
        if row is None:
            if number == len(lines):
                break
            raise UserError(f"{path}: line {number} is no trial; correct or delete the line")
        if row.key in rows:
            raise UserError(f"{path}: line {number} holds a trial a second time; delete the line")
        rows[row.key] = row
        size += len(line)
    return rows, size, first


def _row(line: bytes, row_type: type, parsers: list[Any]) -> Any | None:
    if not line.endswith(b"\n"):
        return None
    try:
        cells = next(csv.reader([line.decode()]))
        return row_type(*(parse(c) for parse, c in zip(parsers, cells, strict=True)))
    except (ValueError, StopIteration, csv.Error):
        return None


def _cell(value: Any) -> str:
    return str(int(value)) if isinstance(value, bool) else str(value)


def _parse_bool(text: str) -> bool:
    if text not in ("0", "1"):
        raise ValueError(text)
    return text == "1"


_PARSERS: dict[Any, Any] = {str: str, int: int, float: float, bool: _parse_bool}
