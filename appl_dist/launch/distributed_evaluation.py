"""An evaluation's trials driven by actors elsewhere: the same processes that collect rollouts for a learner.

The evaluator listens where a learner would. An actor that connects is told that an evaluation runs here, and drives
trials until there are no more. A trial depends on its job alone, so it is the same bit for bit wherever it is driven.
"""

from __future__ import annotations

import json
import logging
import socket
import tempfile
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from appl_dist.config import Settings, as_dict, from_dict
from appl_dist.errors import UserError
from appl_dist.evaluate.runner import NavigationRunner
from appl_dist.evaluate.trials import Job, Method, Trial, decode_trace
from appl_dist.launch.environment import EVALUATION, environment_arguments, worlds_of
from appl_dist.wire.bus import Bus
from appl_dist.wire.control import ControlClient, ControlServer
from appl_dist.wire.liveness import Presence, Roster
from appl_dist.wire.run_status import Progress
from appl_dist.wire.typed import MAX_TEXT, Length, decode
from appl_dist.wire.work import WorkClient, WorkServer

log = logging.getLogger(__name__)

LEAVE_S = 5.0


@dataclass(frozen=True)
class _ServedMethod:
    label: str
    spec: Annotated[str, Length(4096)]
    fingerprint: str


@dataclass(frozen=True)
class _Served:
    """What an evaluator serves besides its settings. files: labels of the methods whose policy it sends."""

    methods: tuple[_ServedMethod, ...]
    files: tuple[str, ...]


class SpreadCrew:
    """The workers of an evaluation, wherever they are; its length is how many have driven a trial."""

    def __init__(self, bus: Bus, run_id: str, settings: Settings) -> None:
        self._bus, self._run_id, self._settings = bus, run_id, settings
        self._workers = 0

    def __len__(self) -> int:
        return self._workers

    def __call__(
        self, jobs: Sequence[Job], runner: Callable[[], Callable[[Job], Trial]]
    ) -> Generator[Trial, None, None]:
        """Yield every job's trial in order of completion; see `evaluate.workers.run_parallel`."""
        if not jobs:
            return
        assert isinstance(runner, NavigationRunner)
        for m in runner.methods:
            if len(m.label) > MAX_TEXT:
                raise UserError(f"policy label: got {m.label!r:.80}; allowed up to {MAX_TEXT} characters")
        files = {m.label: content for m in runner.methods if (content := _content(m)) is not None}
        methods = [{"label": m.label, "spec": m.spec, "fingerprint": m.fingerprint} for m in runner.methods]
        config = {EVALUATION: as_dict(self._settings), "methods": methods, "files": list(files)}
        roster = Roster(self._bus, self._run_id)
        server = WorkServer(
            self._bus, self._run_id, [asdict(job) for job in jobs], files, lambda i, result: _trial(jobs[i], result)
        )
        control = ControlServer(self._bus, self._run_id, json.dumps(config))
        try:
            for _, trial in server.results():
                yield trial
                self._workers = max(self._workers, len([m for m in roster.members() if m.role == "actor"]))
        finally:
            control.set_state("stop")
            deadline = time.monotonic() + LEAVE_S
            while time.monotonic() < deadline and any(m.alive and m.role == "actor" for m in roster.members()):
                time.sleep(0.1)
            log.info("trials handed to %d actors: %s", len(self), dict(server.counts))
            for part in (control, server, roster):
                part.close()


def drive_trials(bus: Bus, run_id: str, served: dict[str, Any], worker: str, stop: Callable[[], bool]) -> int:
    """Drive trials for the evaluation at the other end until there are no more; returns how many."""
    settings = from_dict(served[EVALUATION])
    control = ControlClient(bus, run_id)
    presence = Presence(bus, run_id, "actor", worker)
    client = WorkClient(bus, run_id, worker, lambda: stop() or control.state() == "stop")
    driven = 0
    try:
        with tempfile.TemporaryDirectory(prefix="appl-dist-") as folder:
            runner = _runner(settings, served, client, Path(folder))
            courses, drive = runner.courses(), runner()
            work = client.next()
            while work is not None:
                job = _received(Job, work.what)
                if courses.get(job.world) != job.course:
                    raise UserError(f"world {job.world} is not the evaluator's; give every machine the same world.path")
                presence.beat(Progress(world=job.world, transitions=driven, host=socket.gethostname()[:MAX_TEXT]))
                trial = drive(job)
                driven += 1
                work = client.next((work, asdict(trial)))
    except UserError as error:
        client.fail(str(error))
        raise
    except Exception:
        client.fail(traceback.format_exc(limit=-3))
        raise
    finally:
        for part in (control, presence):
            part.close()
    return driven


def _runner(settings: Settings, served: dict[str, Any], client: WorkClient, folder: Path) -> NavigationRunner:
    described = _received(_Served, {name: value for name, value in served.items() if name != EVALUATION})
    methods = []
    for i, m in enumerate(described.methods):
        spec = m.spec
        if m.label in described.files:
            path = folder / f"{i}.safetensors"
            path.write_bytes(client.file(m.label))
            spec = str(path)
        methods.append(Method(m.label, spec, m.fingerprint))
    worlds = worlds_of(settings, settings.evaluation.worlds)
    return NavigationRunner(
        tuple(worlds), tuple(methods), {**environment_arguments(settings), "protocol": settings.protocol}
    )


def _content(method: Method) -> bytes | None:
    path = Path(method.spec)
    return path.read_bytes() if path.is_file() else None


T = TypeVar("T")


def _received(kind: type[T], values: object) -> T:
    """`decode` for a worker, to whom what cannot be read is a UserError."""
    try:
        return decode(kind, values)
    except ValueError as error:
        raise UserError(
            f"evaluation: the evaluator's {kind.__name__.lstrip('_').lower()} cannot be read: {error}"
        ) from None


def _trial(job: Job, received: dict[str, Any]) -> Trial:
    """The received trial of `job`; ValueError naming the field that cannot be."""
    trace = received.get("parameters")  # longer than a text of the wire
    if not isinstance(trace, str) or (trace and not np.isfinite(decode_trace(trace)).all()):
        raise ValueError(f"parameters: got {trace!r:.80}; expected a trace of finite numbers")
    trial = replace(decode(Trial, {**received, "parameters": ""}), parameters=trace)
    for name, value in asdict(job).items():
        if getattr(trial, name) != value:
            raise ValueError(f"{name}: got {getattr(trial, name)!r:.80}; the job has {value!r}")
    return trial
