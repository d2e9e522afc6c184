"""The scripts for Slurm, and the settings they come from. tests/slurm runs them on a real one."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from appl_dist import overrides
from appl_dist.config import Settings, load
from appl_dist.errors import UserError
from appl_dist.launch import slurm
from appl_dist.launch.launch_settings import LaunchSettings

FOLDER, CWD = Path("/shared/runs/a"), Path("/home/u/my work")


def settings(*overrides: str) -> Settings:
    return load(["launch=slurm", "launch.actors=500", *overrides])


def options(text: str) -> list[str]:
    return [line.removeprefix("#SBATCH ") for line in text.splitlines() if line.startswith("#SBATCH ")]


def test_what_is_asked_for_is_in_the_scripts() -> None:
    chosen = settings(
        "launch.actors_per_task=16", "launch.partition=cpu", "launch.account=lab", "launch.time=2-00:00:00",
        "launch.actor_memory_gb=0.5", "launch.learner_memory_gb=16", "launch.extra=['--qos=long']",
        "launch.signal_s=90", "launch.learner_extra=['--gres=gpu:1']",
    )  # fmt: skip
    (_, learner), (_, actors) = slurm.scripts(chosen, FOLDER, CWD)
    for text in (learner, actors):
        for option in (
            "--requeue", "--time=2-00:00:00", "--partition=cpu", "--account=lab", "--signal=B:USR1@90", "--qos=long",
        ):  # fmt: skip
            assert option in options(text)
    assert {"--mem=16384M", "--cpus-per-task=4", "--gres=gpu:1"} <= set(options(learner))
    assert {"--array=0-31", "--mem=8192M", "--cpus-per-task=16"} <= set(options(actors))
    assert "--gres=gpu:1" not in options(actors)
    assert "cd '/home/u/my work'" in learner


@pytest.mark.parametrize(("actors", "per_task"), [(1, 1), (1, 16), (16, 16), (17, 16), (500, 7)])
def test_every_actor_is_in_exactly_one_task(actors: int, per_task: int) -> None:
    chosen = settings(f"launch.actors={actors}", f"launch.actors_per_task={per_task}")
    text = slurm.scripts(chosen, FOLDER, CWD)[1][1]
    counting = "\n".join(line for line in text.splitlines() if line.startswith(("first=", "count=")))
    total = 0
    for task in range(slurm.tasks(chosen.launch)):
        script = f"SLURM_ARRAY_TASK_ID={task}\n{counting}\necho $count"
        count = int(subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True).stdout)
        assert 1 <= count <= per_task
        total += count
    assert total == actors


@pytest.mark.parametrize("overrides", [(), ("launch.activate=venv/bin/activate",), ("launch.container=appl.sif",)])
def test_the_scripts_are_bash(overrides: tuple[str, ...]) -> None:
    for _, text in slurm.scripts(settings(*overrides), FOLDER, CWD):
        done = subprocess.run(["bash", "-n"], input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_a_container_sees_the_run_and_what_is_bound() -> None:
    text = slurm.scripts(settings("launch.container=/images/appl.sif", "launch.bind=[/data/barn]"), FOLDER, CWD)[0][1]
    assert (
        "apptainer exec --pwd '/home/u/my work' --bind '/home/u/my work' --bind /shared/runs/a --bind /data/barn"
        in text
    )
    assert "/images/appl.sif appl-dist learner" in text


@pytest.mark.parametrize("name", ["a b", "a%j", "a'b", 'a"b', "lr=1e-4", "a#b", "a(b", "$HOME", "ü", "a\\b"])
def test_every_folder_reaches_the_learner_and_the_actors(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cwd = tmp_path / name
    folder = cwd / "runs" / name
    folder.mkdir(parents=True)
    said = tmp_path / "said"
    said.write_text(f"""#!/bin/sh\nprintf '%s\\n' "$@" > {tmp_path}/arguments\n""")
    said.chmod(0o755)
    monkeypatch.setattr(slurm.sys, "executable", str(said))
    job = {"SLURM_JOB_ID": "7", "SLURM_ARRAY_TASK_ID": "0", "PATH": "/usr/bin:/bin"}
    for _, text in slurm.scripts(settings(), folder, cwd):
        assert name not in "".join(options(text))
        subprocess.run(["bash"], input=text, text=True, env=job, check=True)
        told = (tmp_path / "arguments").read_text().splitlines()
        assert f"--config={folder}/config.json" in told
    assert overrides.split([told[4]], Settings)[0] == [("actor.run", str(folder))]
    assert told[5:] == ["actor.id=actor-0", "actors=1"]


def test_a_learner_with_wrong_settings_ends_its_job_after_three_attempts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (("learner", "echo x >> attempts; exit 2"), ("scancel", 'echo "$@" > cancelled'), ("sleep", ":")):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setattr(slurm.sys, "executable", str(tmp_path / "learner"))
    script = slurm.scripts(settings(), FOLDER, tmp_path)[0][1]
    done = subprocess.run(["bash"], input=script, text=True, env={"PATH": f"{tmp_path}:/usr/bin:/bin"}, check=False)
    assert done.returncode == 2
    assert (tmp_path / "attempts").read_text() == "x\n" * 3
    assert "-actors" in (tmp_path / "cancelled").read_text()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"actors": 0}, "launch.actors"),
        ({"actors_per_task": 0}, "launch.actors_per_task: got 0; allowed 1..1024"),
        ({"time": "a day"}, "launch.time"),
        ({"partition": "a b"}, "launch.partition"),
        ({"port": 70_000}, "launch.port"),
        ({"signal_s": 1}, "launch.signal_s"),
        ({"activate": "a", "container": "b"}, "launch.activate, launch.container"),
        ({"extra": ("qos=long",)}, "launch.extra"),
        ({"learner_extra": ("--a\nrm",)}, "launch.learner_extra"),
        ({"system": "pbs"}, "launch.system"),
    ],
)
def test_a_setting_that_cannot_be_is_named(change: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words.replace(".", r"\.")):
        replace(LaunchSettings(system="slurm", actors=4), **change)
