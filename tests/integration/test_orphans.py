"""What a killed actor has not sent reaches the learner through another one, without a new actor."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from appl_dist.launch.ledger import run_ledger
from tests.integration.test_fleet import Fleet


def waiting(spool: Path) -> int:
    return len(list(spool.glob("*.rollout")))


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.end()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_killed_actors_rollouts_are_sent_by_one_that_lives(fleet: Fleet) -> None:
    learner = fleet.learner()
    fleet.wait((fleet.run / "learner.json").exists, "the learner")
    actors = [fleet.start("actor", f"actor.run={fleet.run}") for _ in range(2)]
    fleet.grow(20)
    fleet.wait(lambda: fleet.names() == ["actor-0", "actor-1"], "both actors")
    dead, alive = fleet.run / "spool" / "actor-0", fleet.run / "spool" / "actor-1"

    learner.send_signal(signal.SIGSTOP)
    fleet.wait(lambda: waiting(dead) >= 2 and waiting(alive) >= 1, "rollouts that cannot be sent")
    victim = next(p for p in actors if p.pid == int((dead / "lock").read_text().split()[0]))
    os.kill(victim.pid, signal.SIGKILL)
    victim.wait(20)
    left = waiting(dead)
    assert left >= 2
    learner.send_signal(signal.SIGCONT)
    fleet.wait(lambda: waiting(dead) == 0, "the dead actor's rollouts to be sent")

    survivor = next(p for p in actors if p is not victim)
    fleet.wait(lambda: "rollouts that actor actor-0 left" in fleet.log(survivor), "the survivor to say so")
    learner.send_signal(signal.SIGINT)
    assert learner.wait(180) == 0, fleet.log(learner)
    assert survivor.wait(180) == 0, fleet.log(survivor)
    ledger = run_ledger(fleet.run)
    assert ledger.agrees, ledger.sentence()
    assert sorted(ledger.accounts) == ["actor-0", "actor-1"]
    account = ledger.accounts["actor-0"]
    assert account.stored == account.sent > 0
    assert account.waiting == 0
