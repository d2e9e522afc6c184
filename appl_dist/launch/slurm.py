"""The two Slurm jobs of a run: a learner, and an array of jobs with actors. Plain text, to read, keep and change.

Both queue again by themselves: when their node fails (`--requeue`), and `signal_s` before their time limit, after a
checkpoint. The actors find the learner through the run's folder, which must lie on a file system that all nodes share.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from appl_dist.config import CONFIG_FILE, Settings
from appl_dist.launch.launch_settings import LaunchSettings
from appl_dist.launch.runs import LEARNER_FILE
from appl_dist.overrides import quoted
from appl_dist.wire.credentials import ACTOR

_AGAIN = """\
# SIGUSR1 comes {signal_s} s before the time limit: {what}, and queue again.
again() {{ kill -{signal} "$child" && wait "$child"; scontrol requeue "{job}"; exit 0; }}
trap again USR1
"""

_LEARNER = """\
# A learner that dies goes on from its files; one that keeps dying ends the job and the actors', after three attempts if
# the reason is a mistake in its settings (status 2).
for attempt in 1 2 3 4 5 6 7 8 9 10; do
    {command} &
    child=$!
    wait "$child"
    status=$?
    [ "$status" -eq 0 ] && exit 0
    echo "the learner ended with status $status (attempt $attempt)"
    [ "$status" -eq 2 ] && [ "$attempt" -ge 3 ] && break
    sleep $((3 * attempt))
done
scancel --quiet --user="$USER" --name={actors}
exit "$status"
"""

_ACTORS = """\
first=$(( SLURM_ARRAY_TASK_ID * {per_task} ))
count=$(( {actors} - first < {per_task} ? {actors} - first : {per_task} ))
{command} &
child=$!
wait "$child"
"""


def tasks(settings: LaunchSettings) -> int:
    """How many jobs the array has."""
    return -(-settings.actors // settings.actors_per_task)


def scripts(settings: Settings, folder: Path, cwd: Path) -> list[tuple[str, str]]:
    """(file name, text) of the learner's script and of the actors', in the order to submit them from `folder`.

    Their logs are named from there: a line of #SBATCH has no quoting that would take every folder's name.
    """
    return [("learner.sbatch", _learner(settings, folder, cwd)), ("actors.sbatch", _actors(settings, folder, cwd))]


def forget(folder: Path) -> None:
    """Remove what an earlier learner wrote about its whereabouts: actors wait for the one to come."""
    (folder / LEARNER_FILE).unlink(missing_ok=True)


def _learner(settings: Settings, folder: Path, cwd: Path) -> str:
    s = settings.launch
    endpoint = settings.wire.endpoint
    scheme = endpoint.partition("/")[0]
    port = str(s.port) if s.port else "$(( 20000 + SLURM_JOB_ID % 20000 ))"
    options = [
        *_options(s, s.learner_cpus, s.learner_memory_gb),
        "--output=logs/learner.log",
        *s.learner_extra,
    ]
    command = _command(s, folder, cwd, f"learner {_q(f'--config={folder / CONFIG_FILE}')}")
    return _script(
        f"{settings.run.id}-learner",
        options,
        s,
        cwd,
        _AGAIN.format(signal_s=s.signal_s, what="write a checkpoint", signal="USR1", job="$SLURM_JOB_ID"),
        _LEARNER.format(
            command=f'{command} wire.endpoint="{scheme}/0.0.0.0:{port}"', actors=_q(f"{settings.run.id}-actors")
        ),
    )


def _actors(settings: Settings, folder: Path, cwd: Path) -> str:
    s = settings.launch
    per_task = s.actors_per_task
    share = min(per_task, s.actors)
    options = [
        f"--array=0-{tasks(s) - 1}",
        *_options(s, share * s.actor_cpus, share * s.actor_memory_gb),
        "--output=logs/actors-%a.log",
        *s.actor_extra,
    ]
    command = _command(
        s,
        folder,
        cwd,
        f"actors {_q(f'--config={folder / CONFIG_FILE}')} {_q(quoted('actor.run', str(folder)))} "
        f"actor.id={_q(settings.wire.identity or ACTOR)}-$SLURM_ARRAY_TASK_ID actors=$count",
    )
    return _script(
        f"{settings.run.id}-actors",
        options,
        s,
        cwd,
        _AGAIN.format(
            signal_s=s.signal_s,
            what="send what there is",
            signal="TERM",
            job="${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID",
        ),
        _ACTORS.format(per_task=per_task, actors=s.actors, command=command),
    )


def _options(s: LaunchSettings, cpus: int, memory_gb: float) -> list[str]:
    wanted = [
        "--nodes=1",
        "--ntasks=1",
        f"--cpus-per-task={cpus}",
        f"--mem={round(1024 * memory_gb)}M" if memory_gb else "",
        f"--time={s.time}",
        f"--partition={s.partition}" if s.partition else "",
        f"--account={s.account}" if s.account else "",
        "--requeue",
        "--open-mode=append",
        f"--signal=B:USR1@{s.signal_s}",
        *s.extra,
    ]
    return [option for option in wanted if option]


def _script(name: str, options: list[str], s: LaunchSettings, cwd: Path, *body: str) -> str:
    head = [f"#SBATCH {option}" for option in (f"--job-name={name}", *options)]
    start = [f"cd {_q(cwd)}", *([f". {_q(Path(s.activate).absolute())}"] if s.activate else [])]
    note = "# Submit from the run's folder, where logs/ is."
    return "\n".join(["#!/bin/bash", *head, "", note, *start, "", *body])


def _command(s: LaunchSettings, folder: Path, cwd: Path, role: str) -> str:
    if s.container:
        binds = "".join(f" --bind {_q(p)}" for p in (folder, *s.bind))
        image = _q(Path(s.container).absolute())
        return f"apptainer exec --pwd {_q(cwd)} --bind {_q(cwd)}{binds} {image} appl-dist {role}"
    if s.activate:
        return f"appl-dist {role}"
    return f"{_q(sys.executable)} -m appl_dist {role}"


def _q(value: object) -> str:
    return shlex.quote(str(value))
