"""Run folders: continued with their own configuration, and where their learner is."""

from __future__ import annotations

import logging
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from appl_dist.config import load
from appl_dist.errors import UserError
from appl_dist.launch.roles import Patience, open_spool
from appl_dist.launch.runs import Whereabouts, announce, announce_gone, prepare, require_run, whereabouts
from appl_dist.launch.status import check
from appl_dist.wire.status import ActorStatus, RunStatus

SMALL = ["world.count=6", "evaluation.worlds=0:2"]


def test_a_resumed_run_keeps_its_configuration_and_its_length(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}", "run.transitions=777", "learner.n_step=3", "run.seed=5"]))
    resumed, folder = prepare(load([f"run.resume={tmp_path / 'a'}", "actors=7"]))
    assert folder == tmp_path / "a"
    assert (resumed.run.transitions, resumed.run.seed, resumed.learner.n_step) == (777, 5, 3)
    assert (resumed.actors, resumed.world.count) == (7, 6)
    longer, _ = prepare(load([f"run.resume={tmp_path / 'a'}", "run.transitions=999"]))
    assert longer.run.transitions == 999
    assert load([f"run.resume={tmp_path / 'a'}"]).run.transitions == 999


def test_what_a_resumed_run_cannot_change_is_ignored_aloud(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}"]))
    with caplog.at_level(logging.WARNING):
        resumed = load([f"run.resume={tmp_path / 'a'}", "learner.n_step=3"])
    assert resumed.learner.n_step == 1
    assert "learner.n_step is ignored" in caplog.text


def test_a_learner_goes_on_in_the_folder_of_its_run(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}", "learner.n_step=3"]))
    again, _ = prepare(load([f"run.folder={tmp_path / 'a'}", "run.transitions=9"]), or_continue=True)
    assert (again.run.transitions, again.learner.n_step) == (9, 3)
    with pytest.raises(UserError, match=r"run\.resume="):
        prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}"]))


def test_a_folder_that_cannot_name_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"run\.folder: got .*a b; its last part names the run"):
        prepare(load([*SMALL, f"run.folder={tmp_path / 'a b'}"]))


def test_where_the_learner_is(tmp_path: Path) -> None:
    assert whereabouts(tmp_path) == Whereabouts("", ended=False)
    announce(tmp_path, "tcp/0.0.0.0:7447")
    assert whereabouts(tmp_path) == Whereabouts(f"tcp/{socket.gethostname()}:7447", ended=False)
    announce(tmp_path, "tls/[::1]:7448")
    assert whereabouts(tmp_path).endpoint == "tls/[::1]:7448"
    announce_gone(tmp_path, ended=True)
    assert whereabouts(tmp_path) == Whereabouts("", ended=True)
    (tmp_path / "learner.json").write_text("{")
    with pytest.raises(UserError, match=r"learner\.json"):
        whereabouts(tmp_path)


def test_another_runs_learner_at_the_same_address_is_told_apart(tmp_path: Path) -> None:
    require_run(tmp_path / "mine", "mine")
    with pytest.raises(UserError, match=r"no learner of the run in .*mine: the one that answers has run theirs"):
        require_run(tmp_path / "mine", "theirs")


def test_an_actor_takes_the_first_free_name_and_first_of_all_a_dead_ones_rollouts(tmp_path: Path) -> None:
    own = load([f"actor.run={tmp_path}"]).actor
    with open_spool(own, own, "r") as a, open_spool(own, own, "r") as b, open_spool(own, own, "r") as c:
        assert [s.owner for s in (a, b, c)] == ["r/actor-0", "r/actor-1", "r/actor-2"]
        (c.folder / "000000000000.rollout").write_bytes(b"\0" * 8)
    with open_spool(own, own, "r") as again:
        assert again.owner == "r/actor-2"


def test_patience_counts_only_an_unbroken_absence() -> None:
    now, present = [0.0], [False]
    patience = Patience(lambda: present[0], 60.0, clock=lambda: now[0])
    for now[0], present[0], over in ((50, False, False), (55, True, False), (110, False, False), (116, False, True)):
        assert patience.is_over() is over


def test_health_is_more_than_an_answer() -> None:
    actor = ActorStatus("actor-0", 1.0, world=3, version=1, pending=0, silent_s=1.0, host="here")
    answer = RunStatus(
        run_id="r", run_transitions=100, transitions=10, updates=5, elapsed_s=9.0, age_s=1.0, transitions_per_s=1.0,
        updates_per_s=1.0, samples_per_insert=1.0, queue=0, version=1, sigma=0.1, episodes=1, success=None, time_s=None,
        return_=None, staleness=0.0, stale_share=0.0, refused={}, held_back="", actors=(actor,),
    )  # fmt: skip
    check(answer)
    check(answer, "here")
    with pytest.raises(UserError, match="has not moved for 61 s"):
        check(replace(answer, age_s=61.0))
    for actors in ((), (replace(actor, host="elsewhere"),), (replace(actor, silent_s=61.0),)):
        with pytest.raises(UserError, match="no actor on here"):
            check(replace(answer, actors=actors), "here")
