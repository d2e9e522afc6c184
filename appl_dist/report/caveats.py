"""What a reader must know before trusting a table's numbers; the caveats stand in every form of every table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from appl_dist.evaluate.analysis import Analysis
from appl_dist.evaluate.folder import Evaluation
from appl_dist.evaluate.provenance import same_machine

FEW_WORLDS = 10


def caveats(analysis: Analysis, evaluations: Sequence[Evaluation], differing: int = 0) -> tuple[str, ...]:
    """One sentence each. differing: trials that two of the evaluations have with different results."""
    return (*_of_trials(analysis), *_of_missing(evaluations), *_of_training(analysis, evaluations),
            *_of_machines(evaluations, differing))  # fmt: skip


def _of_trials(analysis: Analysis) -> Iterator[str]:
    counts = [len(analysis.samples[m].times_s[w]) for w in analysis.worlds for m in analysis.methods]
    if len(set(counts)) > 1:
        yield (
            f"Trial numbers are unequal ({min(counts)} to {max(counts)} a world and method): every trial counts, every "
            "world weighs the same, and only common trial numbers are paired."
        )
    if min(counts, default=2) == 1:
        yield (
            "Some worlds have one trial of a method: no significance there, and intervals hold the spread between "
            "worlds alone."
        )
    few = [g.name for g in analysis.groups if len(g.worlds) < FEW_WORLDS]
    if few:
        yield f"Fewer than {FEW_WORLDS} worlds in {_list(few)}: intervals are rough, and none is given for one world."
    left_out = {w for s in analysis.samples.values() for w in s.times_s} - set(analysis.worlds)
    if left_out:
        yield f"{_number(len(left_out), 'world')} without trials of every method left out."


def _of_missing(evaluations: Iterable[Evaluation]) -> Iterator[str]:
    for e in evaluations:
        asked = e.head.trials_asked
        if len(e.trials) < asked:
            missing = asked - len(e.trials)
            yield f"{e.folder}: {missing:,} of {asked:,} trials are missing; the evaluation is not finished."


def _of_training(analysis: Analysis, evaluations: Iterable[Evaluation]) -> Iterator[str]:
    learned = sorted({m.label for e in evaluations for m in e.head.methods if m.spec.endswith(".safetensors")})
    if not learned:
        return
    yield (
        f"{_list(learned)}: one training run each. Intervals hold the spread of trials and worlds, not that of "
        "training seeds."
    )
    if any(g.name == "train" for g in analysis.groups):
        yield "The worlds 'train' are training worlds: a learned policy may have seen them."


def _of_machines(evaluations: Iterable[Evaluation], differing: int) -> Iterator[str]:
    machines: list[Mapping[str, Any]] = []
    for session in (s for e in evaluations for s in e.head.sessions):
        machine = session.get("machine") or {}
        if not any(same_machine(machine, known) for known in machines):
            machines.append(machine)
    if len(machines) > 1:
        names = _list(str(m.get("processor", "unknown")) for m in machines)
        yield (
            f"Trials were driven on {len(machines)} kinds of machine ({names}): trials of one seed may differ in bits "
            "between them."
        )
    if differing:
        yield (
            f"{_number(differing, 'trial')} of the same seed came out differently in two evaluations; the first "
            "evaluation's result counts."
        )


def _list(names: Iterable[str]) -> str:
    return ", ".join(names)


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}" + ("" if count == 1 else "s")
