"""`appl-dist launch`: a run's folder made here, its processes started where `launch.system` says."""

from __future__ import annotations

import logging
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

from appl_dist.config import Settings
from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.launch import slurm
from appl_dist.launch.runs import new_id, prepare, run_folder

log = logging.getLogger(__name__)

SUBMIT_S = 60.0


def launch(settings: Settings) -> int:
    """Start the run, or only show how (`launch.print_only`)."""
    if settings.launch.system == "local":
        from appl_dist.launch.local import train

        if settings.launch.print_only:
            raise UserError("launch.print_only: nothing is submitted with launch=local; choose launch=slurm")
        return train(replace(settings, actors=settings.launch.actors or settings.actors))
    if settings.launch.print_only:
        folder = run_folder(settings).resolve()
        shown = replace(settings, run=replace(settings.run, id=new_id(folder)))
        for name, text in slurm.scripts(shown, folder, Path.cwd()):
            print(f"##### {folder / 'slurm' / name}\n{text}")
        return 0
    if shutil.which("sbatch") is None:
        raise UserError("launch=slurm: there is no sbatch on this machine; run this where jobs are submitted")
    folder = run_folder(settings).resolve()
    settings, folder = prepare(replace(settings, run=replace(settings.run, folder=str(folder))))
    (folder / "logs").mkdir(exist_ok=True)
    slurm.forget(folder)
    submitted: list[str] = []
    for name, text in slurm.scripts(settings, folder, Path.cwd()):
        path = folder / "slurm" / name
        write_atomic(path, text)
        try:
            submitted.append(_submit(path))
        except UserError:
            for job in submitted:
                subprocess.run(["scancel", job], check=False)
            raise
    learner, actors = submitted
    array = slurm.tasks(settings.launch)
    print(f"learner: job {learner}; actors: job {actors}, an array of {array}; logs in {folder}/logs")
    print(f"watch: appl-dist status {shlex.quote(f'actor.run={folder}')}")
    resume = shlex.quote(f"run.resume={folder}")
    print(f"stop: scancel {learner} {actors}; continue: appl-dist launch launch=slurm … {resume}")
    return 0


def _submit(script: Path) -> str:
    """The number of the job, which starts in the run's folder."""
    try:
        done = subprocess.run(
            ["sbatch", "--parsable", str(script)],
            cwd=script.parent.parent,
            capture_output=True,
            text=True,
            timeout=SUBMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise UserError(f"sbatch did not answer within {SUBMIT_S:.0f} s") from None
    if done.returncode != 0:
        raise UserError(f"sbatch refused {script}: {' '.join(done.stderr.split())}")
    return done.stdout.strip().split(";")[0]
