"""Run folders: continued with their own configuration, and where their learner is."""

from __future__ import annotations

import concurrent.futures
import json
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from appl_dist.config import Settings, load
from appl_dist.errors import UserError
from appl_dist.launch.environment import check_not_trained_on, training_of
from appl_dist.launch.roles import Patience, open_spool
from appl_dist.launch.runs import Whereabouts, announce, announce_gone, prepare, require_run, run_id_of, whereabouts
from appl_dist.launch.status import check
from appl_dist.overrides import quoted
from appl_dist.planner.dwa import DWA
from appl_dist.policy_file import PolicyFile
from appl_dist.wire.key_expressions import is_name
from appl_dist.wire.run_status import ActorStatus, RunStatus

SMALL = ["world.count=6", "evaluation.worlds=0:1"]


def test_a_resumed_run_keeps_its_configuration_and_its_length(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}", "run.transitions=777", "learner.n_step=3", "run.seed=5"]))
    resumed, folder = prepare(load([f"run.resume={tmp_path / 'a'}", "actors=7"]))
    assert folder == tmp_path / "a"
    assert (resumed.run.transitions, resumed.run.seed, resumed.learner.n_step) == (777, 5, 3)
    assert (resumed.actors, resumed.world.count) == (7, 6)
    longer, _ = prepare(load([f"run.resume={tmp_path / 'a'}", "run.transitions=999"]))
    assert longer.run.transitions == 999
    assert load([f"run.resume={tmp_path / 'a'}"]).run.transitions == 999


def test_what_would_change_the_meaning_of_a_run_is_refused_on_resume(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}"]))
    with pytest.raises(UserError, match=r"learner\.n_step: got 3, the run in .*a has 1; a continued run may"):
        load([f"run.resume={tmp_path / 'a'}", "learner.n_step=3"])
    assert load([f"run.resume={tmp_path / 'a'}", "learner.n_step=1"]).learner.n_step == 1


def test_learning_rates_may_change_on_resume_and_stay_changed(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}"]))
    prepare(load([f"run.resume={tmp_path / 'a'}", "learner.td3.critic_lr=1e-4", "learner.samples_per_insert=64"]))
    again = load([f"run.resume={tmp_path / 'a'}"]).learner
    assert (again.td3.critic_lr, again.samples_per_insert) == (1e-4, 64)


def test_a_longer_run_never_explores_more_again(tmp_path: Path) -> None:
    first, _ = prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}", "run.transitions=1000"]))
    longer, _ = prepare(load([f"run.resume={tmp_path / 'a'}", "run.transitions=9000"]))
    assert longer.run.transitions == 9000
    assert longer.explore == first.explore
    noise = [longer.explore.sigma(n) for n in range(0, 9000, 100)]
    assert noise == sorted(noise, reverse=True)
    assert noise[10:] == pytest.approx([first.explore.sigma_floor] * len(noise[10:]))


def test_a_learner_goes_on_in_the_folder_of_its_run(tmp_path: Path) -> None:
    prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}", "learner.n_step=3"]))
    again, _ = prepare(load([f"run.folder={tmp_path / 'a'}", "run.transitions=9"]), or_continue=True)
    assert (again.run.transitions, again.learner.n_step) == (9, 3)
    with pytest.raises(UserError, match=r"run\.resume="):
        prepare(load([*SMALL, f"run.folder={tmp_path / 'a'}"]))


@pytest.mark.parametrize(
    "name", ["lr=1e-4,seed=3", "a b", "20260101_120000", "x[/y]", "münchen", "it's", "#1", "(a)", "-"]
)
def test_any_folder_holds_a_run(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    made, _ = prepare(load([*SMALL, f"run.folder={folder}"]))
    assert made.run.folder == str(folder)
    assert is_name(made.run.id)
    assert run_id_of(folder) == made.run.id
    assert load([f"--config={folder / 'config.json'}"]) == made
    assert load([f"--config={folder / 'config.json'}", quoted("actor.spool", str(folder))]).actor.spool == str(folder)
    assert prepare(load([f"run.resume={folder}"]))[0].run.id == made.run.id


def test_runs_made_in_the_same_second_have_folders_and_names_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [load([*SMALL, f"run.seed={seed}"]) for seed in range(8)]
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        made = list(pool.map(prepare, given))
    assert len({folder for _, folder in made}) == 8
    assert len({settings.run.id for settings, _ in made}) == 8
    for settings, folder in made:
        assert json.loads((folder / "config.json").read_text())["run"]["seed"] == settings.run.seed


def test_of_two_that_want_one_folder_one_gets_it(tmp_path: Path) -> None:
    given = [load([*SMALL, f"run.folder={tmp_path / 'a'}", f"run.seed={seed}"]) for seed in range(8)]

    def make(settings: Settings) -> str:
        try:
            return prepare(settings)[0].run.id
        except UserError as error:
            return str(error)

    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        found = list(pool.map(make, given))
    assert found.count(run_id_of(tmp_path / "a")) == 1
    assert sum("already holds a run" in text for text in found) == 7


def test_a_run_is_not_evaluated_on_its_training_worlds_unless_asked(tmp_path: Path) -> None:
    arguments = ["world.count=6", "evaluation.worlds=0:3", f"run.folder={tmp_path / 'a'}"]
    with pytest.raises(UserError, match=r"evaluation\.worlds: 2 of the worlds in '0:3' are among the training worlds"):
        prepare(load(arguments))
    assert not (tmp_path / "a").exists()
    prepare(load([*arguments, "evaluation.training_worlds=true"]))


def test_a_policy_says_where_it_was_trained_and_is_not_tested_there(tmp_path: Path) -> None:
    settings = load(["world.count=6", "world.train=1:4", "evaluation.worlds=3:5"])
    fixed = PolicyFile(values=DWA.defaults, space=DWA, training=training_of(settings))
    fixed.save(tmp_path / "p")
    assert PolicyFile.load(tmp_path / "p").training == fixed.training
    with pytest.raises(UserError, match=r"mine was trained on 1 of these 2 worlds, 3 among them"):
        check_not_trained_on(settings, [("mine", str(tmp_path / "p"))])
    check_not_trained_on(load(["world.count=6", "evaluation.worlds=0:1"]), [("mine", str(tmp_path / "p"))])


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


def test_another_runs_learner_at_the_same_address_is_told_apart() -> None:
    require_run("mine-1", "mine-1", "tcp/127.0.0.1:1")
    with pytest.raises(UserError, match=r"tcp/127\.0\.0\.1:1 has run mine-2, not mine-1; give each run a port"):
        require_run("mine-1", "mine-2", "tcp/127.0.0.1:1")


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


def test_networks_fit_ordinary_processors_unless_the_papers_are_asked_for() -> None:
    for experiment in ("laptop", "barn_hour"):
        assert load([f"experiment={experiment}"]).learner.td3.hidden == (256, 256)
    assert load(["learner=paper"]).learner.td3.hidden == (512, 512, 512)
    # `make train` ends within a quarter of an hour, whatever the machine makes of its transitions.
    assert 0 < load([]).run.minutes <= 12
