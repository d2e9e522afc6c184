"""`appl-dist replay` and `appl-dist report`: what an evaluation's folder is enough for."""

from __future__ import annotations

import sys
from pathlib import Path

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.world_split import select_worlds
from appl_dist.arguments import ArgumentParser
from appl_dist.config import from_dict
from appl_dist.errors import UserError
from appl_dist.evaluate.folder import Evaluation, read_evaluation
from appl_dist.evaluate.provenance import code, machine, same_machine
from appl_dist.evaluate.trial_replay import check_settings, find_trial, replay, trial_name
from appl_dist.launch.environment import environment_arguments

MOMENT_MS = 100


def open_env(evaluation: Evaluation, worlds_path: str | None = None) -> NavigationEnv:
    """The environment in which `evaluation` drove its trials. Raises UserError if it cannot be had again.

    worlds_path: where its worlds lie now, if elsewhere.
    """
    head = evaluation.head
    if not head.settings:
        raise UserError(f"{evaluation.folder}: has no settings to replay with; evaluate with appl-dist evaluate")
    settings = from_dict(dict(head.settings))
    arguments = environment_arguments(settings) | {"protocol": head.protocol}
    check_settings(evaluation, arguments)
    world = settings.world
    wanted = ",".join(str(i) for i in sorted(evaluation.courses))
    worlds = select_worlds(world.path if worlds_path is None else worlds_path, world.count, world.seed, wanted)
    return NavigationEnv(worlds, **arguments)


def replay_main(argv: list[str]) -> int:
    """Drive trials again; status 1 if one is not bit-equal to its row, though this machine recorded it."""
    parser = ArgumentParser(
        prog="appl-dist replay",
        description="Drive trials of an evaluation again from their rows and compare, bit for bit.",
    )
    parser.add_argument("folder", type=Path, help="folder of an evaluation, or of a run with one")
    parser.add_argument("trials", nargs="+", metavar="ROW", help="METHOD/WORLD/TRIAL, or a row's number from 1, or all")
    parser.add_argument("--film", type=Path, help="write a film of the trial: a .gif, or an .mp4 where ffmpeg is")
    parser.add_argument("--figure", type=Path, help="write NAME.png and NAME.pdf: path, lidar and costmap")
    parser.add_argument("--profile", type=Path, help="write NAME.png and NAME.pdf: parameters along the way")
    parser.add_argument("--colour", default="speed", help="of the figure's path: speed, or a parameter's name")
    parser.add_argument("--at", type=float, help="moment of the figure's lidar and costmap, s (default: half-way)")
    parser.add_argument("--worlds", help="where the worlds lie, if not where they were")
    args = parser.parse_args(argv)
    evaluation = read_evaluation(args.folder)
    if args.trials == ["all"]:
        trials = list(evaluation.trials)
    else:
        trials = [find_trial(evaluation, name) for name in args.trials]
    pictures = [p for p in (args.film, args.figure, args.profile) if p is not None]
    if pictures and len(trials) != 1:
        raise UserError(f"--film, --figure, --profile: got {len(trials)} trials; a picture is of one")
    env = open_env(evaluation, args.worlds)
    different = 0
    try:
        if args.colour not in ("speed", *env.space.names):
            raise UserError(f"--colour: got {args.colour!r}; allowed speed, {', '.join(env.space.names)}")
        for trial in trials:
            recording = replay(env, trial, MOMENT_MS if pictures else 0)
            verdict = "bit-equal"
            if recording.difference:
                elsewhere = _other_machine(evaluation)
                different += not elsewhere
                verdict = f"NOT equal: {recording.difference}{elsewhere or _versions(evaluation)}"
            sys.stdout.write(
                f"{trial_name(trial)}: {trial.outcome} after {trial.time_s:g} s, {trial.distance_m:.2f} m, "
                f"{trial.collisions} collisions, {trial.recoveries} recoveries; {verdict}\n"
            )
            sys.stdout.flush()
            if args.film:
                from appl_dist.report.film import write_film

                write_film(recording, args.film)
            if args.figure or args.profile:
                from appl_dist.report.maps import inset_figure, parameter_figure
                from appl_dist.report.style import save_figure

                if args.profile:
                    save_figure(parameter_figure(recording), args.profile.with_suffix(""))
                if args.figure:
                    at_s = recording.frames[-1].t_s / 2.0 if args.at is None else args.at
                    frame = min(recording.frames, key=lambda f: abs(f.t_s - at_s))
                    save_figure(inset_figure(recording, frame, args.colour), args.figure.with_suffix(""))
    finally:
        env.close()
    for picture in pictures:
        sys.stdout.write(f"{picture}\n")
    return 1 if different else 0


def report_main(argv: list[str]) -> int:
    """Tables, figures and one page of evaluations."""
    parser = ArgumentParser(
        prog="appl-dist report", description="Write one HTML page, tables and figures of evaluations."
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folders of evaluations, or of runs with one")
    parser.add_argument("--out", type=Path, help="folder to write into (default: the first evaluation's)")
    parser.add_argument("--no-replays", action="store_true", help="leave out maps and films, which drive trials again")
    args = parser.parse_args(argv)
    from appl_dist.report.build import write_report

    out = args.out or read_evaluation(args.runs[0]).folder
    report = write_report(args.runs, out, None if args.no_replays else open_env)
    sys.stdout.write(f"{report.folder / 'report.html'}\n")
    return 0


def _other_machine(evaluation: Evaluation) -> str:
    """What explains a difference by itself: a kind of machine that rounds differently; "" on the same kind."""
    now = machine()
    others = [s["machine"] for s in evaluation.head.sessions if not same_machine(s["machine"], now)]
    if not others:
        return ""
    return f" (recorded on {others[0]['processor']}, this is {now['processor']}: bits may differ between machines)"


def _versions(evaluation: Evaluation) -> str:
    """What may explain a difference."""
    now = code()
    then = evaluation.head.sessions[-1]["code"] if evaluation.head.sessions else {}
    if not then or then == now:
        return ""
    return (
        f" (recorded by version {then['version']} {then['commit'][:8]}, this is {now['version']} {now['commit'][:8]})"
    )
