"""A small evaluation from policies and worlds to files, in the real environment."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.errors import UserError
from appl_dist.evaluate.comparison import evaluate
from appl_dist.evaluate.folder import read_evaluation
from appl_dist.evaluate.trial_replay import check_settings, find_trial, replay
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.worlds import World

METHODS = [("default", "default"), ("fixed", "set:max_vel_x=1,vx_samples=10"), ("mine", "appld:no-context")]
SHORT = replace(PROTOCOLS.get("appl"), limit_s=8.0, failed_time_s=9.0)


def quiet() -> Console:
    return Console(file=io.StringIO(), record=True, width=150)


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return generate_worlds(2, seed=0)


def test_an_evaluation_goes_on_grows_and_replays(tmp_path: Path, worlds: list[World]) -> None:
    console = quiet()
    found = evaluate(METHODS, worlds, 1, tmp_path, protocol=SHORT, workers=2, seed=3, console=console)
    assert len(found.trials) == 6
    assert found.session["trials"] == 6
    assert "times real time" in console.export_text()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["groups"]["all"]["methods"]) == {"default", "fixed", "mine"}

    written = (tmp_path / "trials.csv").read_bytes()
    more = evaluate(METHODS, worlds, 1, tmp_path, protocol=SHORT, workers=0, seed=3, console=quiet())
    assert more.trials == found.trials
    assert more.session == {}
    assert (tmp_path / "trials.csv").read_bytes() == written
    with pytest.raises(UserError, match="other seeds"):
        evaluate(METHODS, worlds, 1, tmp_path, protocol=SHORT, workers=0, seed=4, console=quiet())
    with pytest.raises(UserError, match="different protocols do not compare"):
        evaluate(METHODS, worlds, 1, tmp_path, protocol="challenge", workers=0, seed=3, console=quiet())
    with pytest.raises(UserError, match="other settings"):
        evaluate(METHODS, worlds, 1, tmp_path, protocol=replace(SHORT, limit_s=9.0), workers=0, seed=3, console=quiet())

    grown = evaluate([("new", "appli:A2")], worlds[:1], 1, tmp_path, protocol=SHORT, workers=0, seed=3, console=quiet())
    assert grown.session["trials"] == 1
    read = read_evaluation(tmp_path)
    assert [m.label for m in read.head.methods] == ["default", "fixed", "mine", "new"]
    assert len(read.trials) == 7
    assert len(read.head.sessions) == 2
    assert set(read.courses) == {0, 1}

    env = NavigationEnv(worlds, protocol=SHORT)
    check_settings(read, {"protocol": SHORT})
    with pytest.raises(UserError, match="settings now differ"):
        check_settings(read, {"protocol": PROTOCOLS.get("appl")})
    for trial in read.trials:
        assert replay(env, trial).difference == ""
    seen = replay(env, find_trial(read, "fixed/1/0"), every_ms=500)
    assert seen.difference == ""  # watching changes nothing
    assert len(seen.frames) > 10
    assert seen.scan_points(seen.frames[3]).shape[1] == 2
    other = replace(read.trials[0], parameters=read.trials[1].parameters)
    assert "digest" in replay(env, other).difference
    with pytest.raises(UserError, match="not the course of then"):
        replay(env, replace(read.trials[0], course="0"))
    with pytest.raises(UserError, match="did not end the trial"):
        replay(env, replace(read.trials[0], parameters=read.trials[0].parameters.split(";")[0]))
    env.close()


def test_trials_are_named_by_method_world_and_number_or_by_row(tmp_path: Path, worlds: list[World]) -> None:
    evaluate([("a/b", "default")], worlds[:1], 1, tmp_path, protocol=SHORT, workers=0, console=quiet())
    read = read_evaluation(tmp_path)
    assert find_trial(read, "a/b/0/0") == find_trial(read, "1") == read.trials[0]
    for wrong in ("0", "2", "a/b/0/7", "nonsense", "a/0/0"):
        with pytest.raises(UserError, match=r"rows 1\.\.1|no such trial"):
            find_trial(read, wrong)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"methods": [("mine", "nowhere.policy")]}, "nowhere.policy"),
        ({"methods": []}, "methods: got none"),
        ({"methods": [("a", "default"), ("a", "default")]}, "used twice"),
        ({"groups": {"test": [0, 99]}}, "world 99"),
        ({"worlds": []}, "worlds: got none"),
        ({"protocol": "fast"}, "protocol: got 'fast'"),
        ({"trials_per_world": 0}, "trials: got 0"),
        ({"workers": -1}, "workers: got -1"),
    ],
)
def test_bad_input_is_one_sentence_before_any_trial(
    tmp_path: Path, worlds: list[World], change: dict[str, object], words: str
) -> None:
    arguments: dict[str, object] = {
        "methods": METHODS[:1],
        "worlds": worlds,
        "trials_per_world": 1,
        "folder": tmp_path / "out",
        "console": quiet(),
    }
    with pytest.raises(UserError, match=words):
        evaluate(**(arguments | change))  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("evaluation.json", None, "expected the folder of an evaluation"),
        ("evaluation.json", "{", "is damaged"),
        ("evaluation.json", '{"version": 1}', "is of format 1"),
        ("evaluation.json", '{"version": 2}', "is damaged"),
        ("worlds.csv", None, "cannot be read"),
        ("worlds.csv", "world\n0\n", "is damaged"),
        ("trials.csv", None, "cannot be read"),
        ("trials.csv", "PAR1", "is not a trial log"),
    ],
)
def test_a_damaged_folder_is_named(
    tmp_path: Path, worlds: list[World], file: str, content: str | None, words: str
) -> None:
    tiny = replace(SHORT, limit_s=0.5)
    evaluate([("a", "default")], worlds[:1], 1, tmp_path, protocol=tiny, workers=0, console=quiet())
    read_evaluation(tmp_path)
    (tmp_path / file).unlink()
    if content is not None:
        (tmp_path / file).write_text(content)
    with pytest.raises(UserError, match=words) as told:
        read_evaluation(tmp_path)
    assert file in str(told.value)
