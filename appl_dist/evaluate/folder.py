"""The folder of an evaluation: what was asked, of which worlds, and the trials; written first, read by reports.

    evaluation.json   protocol, methods, seed, settings, and each session's machine, code and speed
    worlds.csv        generation set, difficulty and optimal time of every world
    trials.csv        one row a trial (trial_log.py)

A report needs nothing else; only replays need the worlds themselves.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from appl_dist.actor.protocol import Protocol
from appl_dist.errors import UserError
from appl_dist.evaluate.runner import course_of
from appl_dist.evaluate.trial_log import read_rows
from appl_dist.evaluate.trials import TRIALS_FILE, Method, Trial
from appl_dist.files import write_atomic
from appl_dist.sim.difficulty import NAMES
from appl_dist.sim.worlds import World

HEAD_FILE, COURSES_FILE = "evaluation.json", "worlds.csv"
VERSION = 2
_METRICS = tuple(name.replace(" ", "_") for name in NAMES)
_COLUMNS = ("world", "course", "generation_set", "optimal_time_s", *_METRICS)


@dataclass(frozen=True)
class Course:
    """What a report knows of a world. metrics: the five of `sim.metrics.NAMES`."""

    index: int
    fingerprint: str
    set_index: int
    optimal_time_s: float
    metrics: tuple[float, ...]


@dataclass(frozen=True)
class Head:
    """What was asked of an evaluation. groups: worlds reported together; settings: the configuration, plain.

    sessions: one for each time it ran: when, machine, code, trials, seconds, episodes/s, multiple of real time.
    """

    protocol: Protocol
    methods: tuple[Method, ...]
    groups: Mapping[str, tuple[int, ...]]
    seed: int
    trials_per_world: int
    settings: Mapping[str, Any]
    sessions: tuple[Mapping[str, Any], ...] = ()

    @property
    def trials_asked(self) -> int:
        return len(self.methods) * len({w for g in self.groups.values() for w in g}) * self.trials_per_world


@dataclass(frozen=True)
class Evaluation:
    """An evaluation folder, read. `trials` may be fewer than asked: it may still run, or have been stopped."""

    folder: Path
    head: Head
    courses: Mapping[int, Course]
    trials: tuple[Trial, ...]
    config_hash: str


def course_facts(world: World, protocol: Protocol) -> Course:
    metrics = tuple(float(v) for v in world.metrics)
    return Course(world.index, course_of(world), world.set_index, protocol.optimal_time_s(world), metrics)


def write_head(folder: Path, head: Head, courses: Sequence[Course]) -> Head:
    """Write evaluation.json and worlds.csv; what an earlier session of the same folder asked for is kept.

    Returns what was written.
    """
    if (folder / HEAD_FILE).is_file():
        old, known = read_head(folder), _read_courses(folder)
        if old.protocol != head.protocol:
            raise UserError(
                f"{folder}: was evaluated under other rules ({old.protocol.differences(head.protocol)}); "
                "use another folder"
            )
        labels = {m.label for m in head.methods}
        names = {name: sorted({*old.groups.get(name, ()), *g}) for name, g in head.groups.items()}
        head = replace(
            head,
            methods=(*(m for m in old.methods if m.label not in labels), *head.methods),
            groups={**old.groups, **{name: tuple(g) for name, g in names.items()}},
            sessions=(*old.sessions, *head.sessions),
        )
        courses = list({**known, **{c.index: c for c in courses}}.values())
    write_atomic(folder / COURSES_FILE, _courses_text(courses))
    save_head(folder, head)
    return head


def save_head(folder: Path, head: Head) -> None:
    plain = {"version": VERSION, **asdict(head)}
    write_atomic(folder / HEAD_FILE, json.dumps(plain, indent=1) + "\n")


def read_head(folder: Path) -> Head:
    """evaluation.json of `folder`. Raises UserError."""
    file = folder / HEAD_FILE
    try:
        plain = json.loads(file.read_text("utf-8"))
        if plain["version"] != VERSION:
            raise UserError(f"{file}: is of format {plain['version']}, this version reads {VERSION}; evaluate anew")
        return Head(
            protocol=Protocol(**plain["protocol"]),
            methods=tuple(Method(**m) for m in plain["methods"]),
            groups={str(name): tuple(int(w) for w in g) for name, g in plain["groups"].items()},
            seed=int(plain["seed"]),
            trials_per_world=int(plain["trials_per_world"]),
            settings=dict(plain["settings"]),
            sessions=tuple(plain["sessions"]),
        )
    except OSError as error:
        raise UserError(
            f"{file}: cannot be read ({error.strerror}); expected the folder of an evaluation, or of a run with one"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{file}: is damaged ({type(error).__name__}: {error}); evaluate anew") from None


def read_evaluation(folder: Path) -> Evaluation:
    """An evaluation's folder, or that of a training run with an evaluation in it. Raises UserError."""
    if not (folder / HEAD_FILE).is_file() and (folder / "evaluation" / HEAD_FILE).is_file():
        folder = folder / "evaluation"
    head = read_head(folder)
    courses = _read_courses(folder)
    trials, config_hash = read_rows(folder / TRIALS_FILE, Trial)
    for t in trials:
        if t.world not in courses or courses[t.world].fingerprint != t.course:
            raise UserError(f"{folder / TRIALS_FILE}: world {t.world} is not as {COURSES_FILE} says; evaluate anew")
        if t.protocol != head.protocol.name:
            raise UserError(f"{folder}: has trials of protocol {t.protocol!r}, {HEAD_FILE} says {head.protocol.name!r}")
    return Evaluation(folder, head, courses, tuple(trials), config_hash)


def _courses_text(courses: Sequence[Course]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for c in sorted(courses, key=lambda c: c.index):
        writer.writerow((c.index, c.fingerprint, c.set_index, c.optimal_time_s, *c.metrics))
    return text.getvalue()


def _read_courses(folder: Path) -> dict[int, Course]:
    file = folder / COURSES_FILE
    try:
        rows = list(csv.DictReader(io.StringIO(file.read_text("utf-8"))))
        found = [
            Course(
                int(r["world"]),
                r["course"],
                int(r["generation_set"]),
                float(r["optimal_time_s"]),
                tuple(float(r[m]) for m in _METRICS),
            )
            for r in rows
        ]
    except OSError as error:
        raise UserError(f"{file}: cannot be read ({error.strerror}); evaluate anew") from None
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file}: is damaged ({type(error).__name__}: {error}); evaluate anew") from None
    return {c.index: c for c in found}
