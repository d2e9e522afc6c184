"""The whole chain, from a runner to the tables, on times with a planted effect: it is found, and nothing else is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.evaluate.folder import Course, Head, write_head
from appl_dist.evaluate.trials import Job, Method, Trial, run_trials
from appl_dist.report.data import gather
from appl_dist.report.tables import all_tables
from tests.unit.evaluate.synthetic import make_trial

WORLDS = range(100)
TRIALS = 12
NOISE_S = 2.0
EASIER = frozenset(range(0, 30))  # "effect" is 5 s faster here,
HARDER = frozenset(range(30, 40))  # 5 s slower here, and equal in the other sixty
METHODS = (Method("default", "a"), Method("null", "b"), Method("effect", "c"))


@dataclass(frozen=True)
class Planted:
    def __call__(self) -> Planted:
        return self

    def run(self, job: Job) -> Trial:
        rng = np.random.default_rng([job.seed, len(job.method)])
        time_s = 20.0 + 0.1 * (job.world % 7) + NOISE_S * float(rng.normal())
        if job.method == "effect":
            time_s += 5.0 * ((job.world in HARDER) - (job.world in EASIER))
        return replace(make_trial(job.method, job.world, job.trial, time_s), policy=job.policy, seed=job.seed)


@dataclass(frozen=True)
class Factory:
    def __call__(self):  # type: ignore[no-untyped-def]
        return Planted().run


def test_what_was_planted_is_found_and_nothing_else(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    # The metric "tortuosity" tells where the effect is; the other four are noise.
    courses = []
    for w in WORLDS:
        metrics = rng.normal(size=5)
        metrics[4] = (w in HARDER) - 1.0 * (w in EASIER) + 0.3 * rng.normal()
        courses.append(Course(w, "", w % 12, 5.0, tuple(float(m) for m in metrics)))
    head = Head(PROTOCOLS.get("appl"), METHODS, {"all": tuple(WORLDS)}, 0, TRIALS, {})
    run_trials(METHODS, WORLDS, TRIALS, Factory(), workers=2, folder=tmp_path, protocol="appl", config_hash="c")
    write_head(tmp_path, head, courses)
    data = gather([tmp_path])
    group = data.analysis.groups[0]
    tables = {t.name: t for t in all_tables(data.analysis, data.courses, "time")}

    effect = group.comparisons["effect", "default"]
    found = {
        w for w, q, d in zip(effect.worlds, effect.q_values, effect.difference_s, strict=True) if q < 0.05 and d < 0
    }
    assert found >= EASIER
    assert len(found - EASIER) <= 3  # 5 % of forty, and chance
    assert effect.improvement_low_s < 1.0 < effect.improvement_high_s
    assert effect.win_low > 0.5

    null = group.comparisons["null", "default"]
    assert null.better + null.worse <= 11  # of 100 worlds 5 are expected without correction
    assert null.better_fdr + null.worse_fdr == 0
    assert null.improvement_low_s < 0.0 < null.improvement_high_s
    assert null.win_low < 0.5 < null.win_high

    rows = {(r["worlds"], r["metric"]): r for r in tables["difficulty"].records}
    assert rows["time of effect", "tortuosity"]["q_value"] < 0.001
    assert rows["effect faster than default", "tortuosity"]["rho"] < -0.5
    others = [r for (what, metric), r in rows.items() if metric != "tortuosity" or "effect" not in what]
    assert sum(r["q_value"] < 0.05 for r in others) <= 1
    wins = {(r["method"], r["versus"]): r for r in tables["wins"].records}
    assert 30 <= wins["effect", "default"]["better"] <= 36
    assert 10 <= wins["effect", "default"]["worse"] <= 16


def test_without_any_effect_few_evaluations_claim_one() -> None:
    """The rate that is stated: with no effect at all 1 evaluation in 20 claims any world at a discovery rate of 5 %."""
    from appl_dist.evaluate.statistics import collect, compare

    rng = np.random.default_rng(4)
    claims = intervals = 0
    repeats = 200
    for _ in range(repeats):
        times_s = 20.0 + NOISE_S * rng.normal(size=(2, 40, 10))
        rows = [
            make_trial(m, w, k, float(times_s[i, w, k]))
            for i, m in enumerate("ab")
            for w in range(40)
            for k in range(10)
        ]
        c = compare("a", "b", collect(rows, 70.0), range(40), rng=rng, bootstrap_samples=200)
        claims += c.better_fdr + c.worse_fdr > 0
        intervals += c.improvement_low_s < 0.0 < c.improvement_high_s
    assert claims <= 20  # 10 expected, standard deviation 3
    assert intervals >= 184  # 190 expected or more: worlds without a spread of their own are resampled twice
