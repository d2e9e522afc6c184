"""Where a run's numbers go: TensorBoard events for watching, metrics.csv for figures.

tensorboard's own event writer is used directly: torch.utils.tensorboard adds nothing for scalars.
metrics.csv is long (step, name, value): metrics come at different times and a resumed run may have new ones.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from appl_dist.errors import UserError

_COLUMNS = ["time_s", "step", "name", "value"]


@dataclass(frozen=True)
class Row:
    """One number of metrics.csv; `time_s` since the epoch, `step` in transitions received."""

    time_s: float
    step: int
    name: str
    value: float


class MetricsWriter:
    """Appends scalars to `folder`. Its events file is new at each start; metrics.csv goes on."""

    def __init__(self, folder: str | Path, clock: Callable[[], float] = time.time) -> None:
        self.folder, self._clock = Path(folder), clock
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            _drop_cut_line(self.folder / "metrics.csv")
            self._file = open(self.folder / "metrics.csv", "a", newline="", encoding="utf-8")  # noqa: SIM115
        except OSError as e:
            raise UserError(f"metrics folder {folder}: cannot be written: {e.strerror}") from None
        self._csv = csv.writer(self._file)
        if self._file.tell() == 0:
            self._csv.writerow(_COLUMNS)
        self._events = EventFileWriter(str(self.folder), flush_secs=30)

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Append the scalars at `step` (transitions received) to both files."""
        now = self._clock()
        values = [Summary.Value(tag=name, simple_value=value) for name, value in scalars.items()]
        self._events.add_event(Event(wall_time=now, step=step, summary=Summary(value=values)))
        self._csv.writerows([f"{now:.3f}", step, name, repr(float(v))] for name, v in scalars.items())
        self._file.flush()

    def close(self) -> None:
        """Flush both files."""
        self._events.close()
        self._file.close()

    def __enter__(self) -> MetricsWriter:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _drop_cut_line(path: Path) -> None:
    """Remove a last line that a kill left without its end, so that appending cannot join two."""
    if not path.exists():
        return
    with open(path, "r+b") as file:
        data = file.read()
        if not data.endswith(b"\n"):
            file.truncate(data.rfind(b"\n") + 1)


def read_metrics(folder: str | Path) -> Iterator[Row]:
    """The rows of metrics.csv in order; a last line cut by a kill is left out."""
    path = Path(folder) / "metrics.csv"
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as e:
        raise UserError(f"{path}: cannot be read: {e.strerror}") from None
    for number, line in enumerate(csv.reader(lines[1:]), 2):
        try:
            time_s, step, name, value = line
            row = Row(float(time_s), int(step), name, float(value))
        except ValueError:
            if number == len(lines):
                return
            raise UserError(f"{path}, line {number}: got {line}; expected {','.join(_COLUMNS)}") from None
        yield row
