"""What a report is about: one or more evaluations brought together, or refused where they do not compare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from appl_dist.actor.protocol import Protocol
from appl_dist.errors import UserError
from appl_dist.evaluate.analysis import Analysis, analyse
from appl_dist.evaluate.folder import Course, Evaluation, read_evaluation
from appl_dist.evaluate.provenance import same_machine
from appl_dist.evaluate.trials import Trial
from appl_dist.report.caveats import caveats

METRICS_FILE = "metrics.jsonl"


@dataclass(frozen=True)
class Source:
    """An evaluation and, where it belongs to a training run, the run's metrics file."""

    evaluation: Evaluation
    metrics: Path | None


@dataclass(frozen=True)
class ReportData:
    """origin: where a trial of the analysis lies: its evaluation and its name there, by (method, world, trial)."""

    title: str
    protocol: Protocol
    sources: tuple[Source, ...]
    courses: Mapping[int, Course]
    analysis: Analysis
    origin: Mapping[tuple[str, int, int], tuple[Evaluation, Trial]]
    caveats: tuple[str, ...] = ()


def gather(runs: Sequence[Path]) -> ReportData:
    """Read and bring together evaluations. Raises UserError for those that do not compare.

    A method of the same label, policy, settings and seed in two of them is the same, and its trials count once; one
    that differs in any of these is told apart by its folder's name. A trial that another kind of machine drove with
    other results is no error: the first counts, and a caveat says so.
    """
    if not runs:
        raise UserError("report: got no folder; give that of an evaluation, or of a run with one")
    sources = [Source(e, _metrics(e.folder)) for e in map(read_evaluation, runs)]
    first = sources[0].evaluation
    courses: dict[int, Course] = {}
    for source in sources:
        _check_comparable(first, source.evaluation)
        for index, course in source.evaluation.courses.items():
            if courses.setdefault(index, course) != course:
                raise UserError(
                    f"{first.folder} and {source.evaluation.folder}: world {index} is not the same course in both; "
                    "report them separately"
                )
    labels = _labels([s.evaluation for s in sources])
    origin: dict[tuple[str, int, int], tuple[Evaluation, Trial]] = {}
    groups: dict[str, list[int]] = {}
    differing = 0
    for source in sources:
        e = source.evaluation
        for t in e.trials:
            key = (labels[_identity(e, t.method, t.policy)], t.world, t.trial)
            known = origin.setdefault(key, (e, t))[1]
            if known != t:
                _check_elsewhere(e, t, *origin[key])
                differing += 1
        for name, worlds in e.head.groups.items():
            groups[name] = sorted({*groups.get(name, []), *worlds})
    methods = list(dict.fromkeys(labels.values()))
    protocol = first.head.protocol
    analysis = analyse(
        [replace(t, method=key[0]) for key, (_, t) in origin.items()],
        [m for m in methods if any(key[0] == m for key in origin)],
        groups,
        limit_s=protocol.limit_s,
        failed_time_s=protocol.failed_time_s,
        seed=first.head.seed,
    )
    if not analysis.groups:
        folders = ", ".join(str(s.evaluation.folder) for s in sources)
        raise UserError(f"{folders}: no world has trials of every method yet; nothing to report")
    known_caveats = caveats(analysis, [s.evaluation for s in sources], differing)
    title = " against ".join(reversed(analysis.methods)) if len(analysis.methods) <= 3 else "Evaluation"
    return ReportData(title, protocol, tuple(sources), courses, analysis, origin, known_caveats)


def _check_elsewhere(a: Evaluation, trial: Trial, b: Evaluation, other: Trial) -> None:
    """Another machine may give a trial other bits; on the same kind of machine, only other code does."""
    machines = [[s.get("machine") or {} for s in e.head.sessions] for e in (a, b)]
    if all(same_machine(m, n) for m in machines[0] for n in machines[1]):
        raise UserError(
            f"{a.folder}: {trial.method}/{trial.world}/{trial.trial} differs from the same trial in {b.folder} "
            f"(time {trial.time_s} and {other.time_s} s) on the same kind of machine: other code drove one of them"
        )


def _metrics(folder: Path) -> Path | None:
    """metrics.jsonl of the training run that an evaluation folder lies in."""
    file = folder.parent / METRICS_FILE
    return file if file.is_file() else None


def _check_comparable(a: Evaluation, b: Evaluation) -> None:
    if a.head.protocol != b.head.protocol:
        raise UserError(
            f"{a.folder} and {b.folder} cannot be compared: they follow the protocols {a.head.protocol.name!r} and "
            f"{b.head.protocol.name!r} ({a.head.protocol.differences(b.head.protocol)}), whose times do not compare; "
            "report them separately"
        )


_Identity = tuple[str, str, str, int]


def _identity(evaluation: Evaluation, label: str, policy: str) -> _Identity:
    return label, policy, evaluation.config_hash, evaluation.head.seed


def _labels(evaluations: Sequence[Evaluation]) -> dict[_Identity, str]:
    found: dict[_Identity, Evaluation] = {}
    for e in evaluations:
        for m in e.head.methods:
            found.setdefault(_identity(e, m.label, m.fingerprint), e)
    names = [identity[0] for identity in found]
    labels: dict[_Identity, str] = {}
    for identity, e in found.items():
        label = identity[0]
        if names.count(label) > 1:
            folder = e.folder.parent if e.folder.name == "evaluation" else e.folder
            label = f"{label} ({folder.name})"
        while label in labels.values():
            label += "'"
        labels[identity] = label
    return labels
