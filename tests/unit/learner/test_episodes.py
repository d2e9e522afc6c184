"""Episode figures: staleness against the newest policy, and infos that cannot be."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from appl_dist.learner.episodes import STALE_VERSIONS, EpisodeStatistics
from appl_dist.spec import Rollout
from tests.unit.wire.support import make_rollout

INFO = {
    "ended": True, "success": True, "time_s": 12.0, "return_": 3.0, "world": 4, "policy_epoch": 2, "policy_version": 90,
}  # fmt: skip


def rollout(transitions: int = 3, **changes: Any) -> Rollout:
    return replace(make_rollout(0, transitions), info={**INFO, **changes})


def test_the_stale_share_counts_transitions_of_old_policies_and_of_earlier_learners() -> None:
    statistics = EpisodeStatistics(failed_time_s=70.0)
    statistics.current = (2, 100)
    statistics.add(rollout(6))
    statistics.add(rollout(3, policy_version=99 - STALE_VERSIONS))
    assert statistics.figures()["stale_share"] == pytest.approx(3 / 9)
    statistics.add(rollout(3, policy_epoch=1, policy_version=500, ended=False))  # of a learner process before
    figures = statistics.figures()
    assert figures["stale_share"] == pytest.approx(6 / 12)
    assert figures["episodes"] == 2
    assert figures["staleness"] == pytest.approx((10 + 1 + STALE_VERSIONS) / 2)


def test_a_failed_trial_counts_the_protocols_time() -> None:
    statistics = EpisodeStatistics(failed_time_s=70.0)
    statistics.add(rollout(success=False))
    statistics.add(rollout(success=True))
    assert statistics.figures()["time_s"] == pytest.approx((70.0 + 12.0) / 2)
    assert statistics.worlds() == {4: (2, 0.5, 41.0)}


@pytest.mark.parametrize(
    "changes",
    [
        {"time_s": math.nan},
        {"return_": "high"},
        {"world": math.inf},
        {"world": None},
        {"policy_version": []},
        {"success": 1},
        {"time_s": 1e300},
        {"world": -1},
        {"policy_epoch": 2**60},
    ],
)
def test_a_malformed_info_changes_nothing(changes: dict[str, Any]) -> None:
    statistics = EpisodeStatistics(failed_time_s=70.0)
    before = statistics.figures()
    with pytest.raises(ValueError, match="got"):
        statistics.add(rollout(**changes))
    with pytest.raises(ValueError, match="EpisodeInfo: got fields"):
        statistics.add(make_rollout(0))
    assert statistics.figures() == before
