"""Where a run's numbers go: TensorBoard events for watching, metrics.jsonl for figures.

tensorboard's own event writer is used directly: torch.utils.tensorboard takes 1.9 s to import and adds
nothing for scalars. A line of metrics.jsonl is one record: `unix_s`, `step` (transitions) and the scalars.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from appl_dist.errors import UserError
from appl_dist.files import explain

METRICS_FILE = "metrics.jsonl"


class MetricsWriter:
    """Appends scalars to `folder`. An events file is new at each start; metrics.jsonl goes on."""

    def __init__(self, folder: str | Path, clock: Callable[[], float] = time.time) -> None:
        self.folder, self._clock = Path(folder), clock
        path = self.folder / METRICS_FILE
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            _drop_cut_line(path)
            self._file = open(path, "a", encoding="utf-8")  # noqa: SIM115
        except OSError as e:
            raise UserError(f"{path}: cannot be written: {explain(e)}") from None
        self._events = EventFileWriter(str(self.folder), flush_secs=10)

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Append one record at `step`, in transitions received. A number that is not finite becomes null."""
        now = self._clock()
        values = [Summary.Value(tag=name, simple_value=value) for name, value in scalars.items()]
        self._events.add_event(Event(wall_time=now, step=step, summary=Summary(value=values)))
        finite = {name: float(v) if math.isfinite(v) else None for name, v in scalars.items()}
        self._file.write(json.dumps({"unix_s": round(now, 3), "step": step, **finite}) + "\n")
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
