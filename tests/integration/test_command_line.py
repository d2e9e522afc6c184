"""What a user gets wrong: one sentence that names it, exit status 2, nothing left half done."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest


def appl_dist(*arguments: str, cwd: Path, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "appl_dist", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=timeout_s, check=False)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["tarin"], "role 'tarin': expected one of train, learner"),
        (["train", "actor=3"], "actor"),
        (["train", "nonsense=3"], "nonsense"),
        (["train", "actors=-1"], "actors: got -1; allowed 0..4000"),
        (["train", "actors=many"], "actors"),
        (["train", "learner.gamma=1.5"], "learner.gamma: got 1.5; allowed 0..1"),
        (["train", "learner.td3.polyak=0"], "polyak: got 0"),
        (["train", "timing=slow"], "timing"),
        (["train", "run.seed=0,1"], "run.seed=0,1: a value with commas needs quotes"),
        (["train", "just words"], "'just words': expected key=value"),
        (["train", "world.path=/no/such/worlds"], "/no/such/worlds"),
        (["train", "world.train=0:5:-1"], "'0:5:-1'"),
        (["train", "world.train=4000", "world.count=6"], "4000"),
        (["train", "run.resume=nowhere"], "nowhere"),
        (["train", "wire.endpoint=somewhere"], "wire.endpoint: got 'somewhere'; expected tcp/HOST:PORT"),
        (["train", "protocol=marathon"], "protocol: got 'marathon'; allowed appl, challenge"),
        (["evaluate", "evaluation.methods=mine"], "evaluation.methods"),
        (["evaluate", "+evaluation.methods.mine=missing.safetensors", "world.count=6"], "missing.safetensors"),
        (
            ["evaluate", "+evaluation.methods.mine='set:max_vel_x=9'", "world.count=6"],
            "max_vel_x = 9; dwa allows 0.2..2",
        ),
        (["evaluate", "protocol=appl", "protocol.limit_s=0"], "protocol.limit_s: got 0"),
        (["evaluate", "timing=slow"], "timing: got 'slow'; allowed gazebo, ideal, robot"),
        (["replay", "nowhere", "1"], "nowhere/evaluation.json: cannot be read"),
        (["report", "nowhere"], "expected the folder of an evaluation"),
        (["status", "actor.run=missing"], "actor.run: no folder at missing"),
        (["actor", "actor.run=missing"], "actor.run: no folder at missing"),
        (["ledger", "missing"], "missing is no run's folder"),
        (["launch", "launch=slurm"], "launch.actors: got 0"),
        (["ledger"], "RUN"),
        (["conformance", "missing.jsonl.gz"], "missing.jsonl.gz"),
        (["conformance", "x", "--arithmetic", "quick"], "invalid choice: 'quick'"),
        (["replay"], "folder"),
        (["keys", "k", "--days", "many"], "invalid int value: 'many'"),
        (["worlds", "check", "missing.tar.gz"], "missing.tar.gz"),
    ],
)
def test_a_mistake_gets_one_sentence(arguments: list[str], says: str, tmp_path: Path) -> None:
    result = appl_dist(*arguments, cwd=tmp_path)
    assert result.returncode == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert says in lines[0]
    assert "Traceback" not in result.stderr
    assert not any(tmp_path.rglob("*.tmp"))


def test_a_broken_world_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / "barn_worlds.npz").write_bytes(b"PK\x03\x04 not really")
    result = appl_dist("train", "world.path=worlds", cwd=tmp_path)
    assert result.returncode == 2
    assert "barn_worlds.npz" in result.stderr
    assert "Traceback" not in result.stderr


def test_an_actor_without_a_learner_says_so(tmp_path: Path) -> None:
    result = appl_dist("actor", "wire.endpoint=tcp/127.0.0.1:9", "wire.timeout_s=1", cwd=tmp_path)
    assert result.returncode == 2
    assert "no learner answered at tcp/127.0.0.1:9" in result.stderr


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_actor_that_still_connects_ends_at_once(number: signal.Signals, status: int, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        endpoint = f"wire.endpoint=tcp/127.0.0.1:{silent.getsockname()[1]}"
        # A shell that runs us in the background has SIGINT ignored.
        command = ["env", "--default-signal=INT", sys.executable, "-m", "appl_dist", "actor", endpoint]
        actor = subprocess.Popen([*command, "wire.timeout_s=120"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        silent.settimeout(60.0)
        silent.accept()[0].close()  # it has called
        actor.send_signal(number)
        _, told = actor.communicate(timeout=60.0)
    assert actor.returncode == status
    assert "Traceback" not in told


def test_a_taken_port_is_told_by_train(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"wire.endpoint=tcp/127.0.0.1:{taken.getsockname()[1]}"
        result = appl_dist("train", "world.count=6", "actors=1", endpoint, "run.folder=run", cwd=tmp_path)
    assert result.returncode == 2
    assert "already in use" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_run_folder_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text("{}")
    result = appl_dist("train", "run.folder=run", cwd=tmp_path)
    assert result.returncode == 2
    assert "run.resume=run" in result.stderr


@pytest.mark.parametrize("role", ["train", "learner", "actor", "evaluate"])
def test_help_lists_groups_and_keys(role: str, tmp_path: Path) -> None:
    result = appl_dist(role, "--help", cwd=tmp_path)
    assert result.returncode == 0
    assert "timing" in result.stdout
    assert "gazebo, ideal, robot" in result.stdout
    assert "samples_per_insert" in result.stdout


@pytest.mark.timeout(900)
def test_evaluate_replay_and_report_in_a_row(tmp_path: Path) -> None:
    arguments = ("world.count=2", "evaluation.worlds=all", "evaluation.trials=1", "evaluation.folder=here")
    short = ("protocol.limit_s=4", "evaluation.workers=1", "+evaluation.methods.fast='set:max_vel_x=2'")
    done = appl_dist("evaluate", *arguments, *short, cwd=tmp_path, timeout_s=600.0)
    assert done.returncode == 0, done.stderr
    assert "times real time" in done.stdout
    assert "Mean traversal time" in done.stdout
    text = (tmp_path / "here" / "report.html").read_text()
    assert "each bit-equal to its row" in text
    assert "film_fast" in text
    again = appl_dist("replay", "here", "all", cwd=tmp_path)
    assert again.returncode == 0, again.stdout
    assert again.stdout.count("; bit-equal") == 4
    rows = (tmp_path / "here" / "trials.csv").read_text().replace(" 20 0.1 ", " 21 0.1 ")
    (tmp_path / "here" / "trials.csv").write_text(rows)
    other = appl_dist("replay", "here", "default/0/0", "fast/1/0", cwd=tmp_path)
    assert other.returncode == 1
    assert "NOT equal" in other.stdout
    filmed = appl_dist("replay", "here", "fast/0/0", "--film", "f.gif", "--figure", "f.png", cwd=tmp_path)
    assert (tmp_path / "f.gif").read_bytes().startswith(b"GIF8"), filmed.stderr
    assert (tmp_path / "f.pdf").exists()
    two = appl_dist("replay", "here", "all", "--film", "f.gif", cwd=tmp_path)
    assert (two.returncode, "a picture is of one" in two.stderr) == (2, True)
