"""`appl-dist ROLE …`: dispatch to one role. A user's mistake ends in one sentence and exit status 2."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
from collections.abc import Callable

from appl_dist.errors import PARENT_VARIABLE, PASSING, USER_ERROR, PassingFault, UserError
from appl_dist.files import explain
from appl_dist.terminal import discard_output, prepare_streams, printable, start_logging

log = logging.getLogger(__name__)

ROLES = {
    "train": "run a learner and its actors on this machine, then evaluate the policy",
    "learner": "run only the learner; actors anywhere connect to wire.endpoint",
    "actor": "run one actor: appl-dist actor wire.endpoint=tcp/HOST:7447",
    "actors": "run several, supervised: appl-dist actors actors=16 actor.run=RUN (or wire.endpoint=…)",
    "launch": "run on a cluster: appl-dist launch launch=slurm launch.actors=500",
    "status": "ask a run how it is: appl-dist status wire.endpoint=… (--here: and its actors on this host)",
    "evaluate": "compare policies on worlds: appl-dist evaluate +evaluation.methods.mine=FILE",
    "replay": "drive trials of an evaluation again, film them: appl-dist replay FOLDER METHOD/WORLD/TRIAL --film t.gif",
    "report": "one page, tables and figures of evaluations: appl-dist report FOLDER…",
    "keys": "make certificates and passwords for a run on several machines: appl-dist keys FOLDER",
    "ledger": "compare what actors sent with what is in replay: appl-dist ledger RUN [SPOOL_FOLDER …]",
    "worlds": "check, generate, count or draw BARN worlds",
    "conformance": "replay reference vectors of the ROS planner: appl-dist conformance FILE… [--arithmetic fast]",
}


def main(argv: list[str] | None = None) -> int:
    """Run one role; the exit status. 2: a user's mistake, in one sentence on standard error."""
    prepare_streams()
    try:
        status = _main(argv)
        sys.stdout.flush()
        sys.stderr.flush()
    except BrokenPipeError:  # whoever read our output has seen enough
        discard_output()
        return 128 + signal.SIGPIPE
    except OSError as error:  # a full disk behind our output
        with contextlib.suppress(OSError):
            print(f"appl-dist: the output cannot be written: {explain(error)}", file=sys.stderr, flush=True)
        discard_output()
        return USER_ERROR
    return status


def _main(argv: list[str] | None) -> int:
    arguments = sys.argv[1:] if argv is None else argv
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_usage())
        return 0
    role, rest = arguments[0], arguments[1:]
    # One process is one core's worth of work; numpy reads this when it is first imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    start_logging(role)
    try:
        if role not in ROLES:
            raise UserError(f"role {role!r}: expected one of {', '.join(ROLES)}")
        return _run(role, rest)
    except UserError as error:
        print(f"appl-dist {printable(role)}: {printable(str(error))}", file=sys.stderr)
        # A launcher gives up on a child that keeps failing, unless the reason may pass.
        return PASSING if isinstance(error, PassingFault) and PARENT_VARIABLE in os.environ else USER_ERROR
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.filename is None:
            raise
        print(f"appl-dist {printable(role)}: {printable(str(error.filename))}: {explain(error)}", file=sys.stderr)
        log.debug("where it happened", exc_info=True)
        return USER_ERROR
    except KeyboardInterrupt:
        return 130


def _run(role: str, rest: list[str]) -> int:
    if role == "worlds":
        from appl_dist.sim.worlds_command import worlds_main

        return worlds_main(rest)
    if role == "replay":
        from appl_dist.launch.report_commands import replay_main

        return replay_main(rest)
    if role == "report":
        from appl_dist.launch.report_commands import report_main

        return report_main(rest)
    if role == "conformance":
        from appl_dist.planner.conformance import main as conformance

        return conformance(rest)
    if role == "keys":
        from appl_dist.launch.make_keys import main as keys

        return keys(rest)
    if role == "ledger":
        from appl_dist.launch.ledger import main as ledger
        from appl_dist.launch.view import make_console

        return ledger(rest, make_console())
    if any(a in ("-h", "--help") for a in rest):
        print(_help(role))
        return 0
    from appl_dist.config import load

    if role == "status":
        from appl_dist.launch.status import HERE, status

        return status(load([a for a in rest if a != HERE]), here=HERE in rest)
    settings = load(rest)
    run: Callable[..., int]
    if role == "train":
        from appl_dist.launch.local import train as run
    elif role == "learner":
        from appl_dist.launch.roles import learner as run
    elif role == "actor":
        from appl_dist.launch.roles import actor as run
    elif role == "actors":
        from appl_dist.launch.fleet import actors as run
    elif role == "launch":
        from appl_dist.launch.cluster import launch as run
    else:
        from appl_dist.launch.evaluation import evaluate as run
    return run(settings)


def _usage() -> str:
    rows = "\n".join(f"  {name:<12} {text}" for name, text in ROLES.items())
    return f"usage: appl-dist ROLE [key=value …]\n\n{rows}\n\nappl-dist ROLE --help lists what a role takes."


def _help(role: str) -> str:
    from omegaconf import OmegaConf

    from appl_dist.config import compose_dict
    from appl_dist.config_groups import choices, groups

    listed = "\n".join(f"  {group:<12} {', '.join(choices(group))}" for group in groups())
    return (
        f"appl-dist {role}: {ROLES[role]}\n\n"
        f"usage: appl-dist {role} [group=choice …] [key=value …]\n"
        f"  e.g. appl-dist {role} timing=robot world.path=../shared/barn run.seed=1\n\n"
        f"groups and their choices\n{listed}\n\n"
        f"keys and their defaults\n{OmegaConf.to_yaml(OmegaConf.create(compose_dict([])))}"
    )


if __name__ == "__main__":
    sys.exit(main())
