"""Key expressions of the wire, and the names allowed in them.

    appl/run                                     what runs here: run id and frozen config
    appl/RUN/upload/ACTOR                        rollouts in, acks out
    appl/RUN/claim/ACTOR/INCARNATION             token: this process uploads as ACTOR
    appl/RUN/work/ACTOR                          results of an evaluation in, jobs out
    appl/RUN/weights                             newest policy
    appl/RUN/state                               desired state of the actors
    appl/RUN/status                              the learner's numbers for the terminal
    appl/RUN/alive/ROLE/ID/INCARNATION           token: this process is there
    appl/RUN/progress/ROLE/ID                    what it has done, once a second

The wire version is in the headers, not in the keys: a peer of another version gets a refusal that says so
instead of silence.
"""

from __future__ import annotations

import re

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
RUN = "appl/run"
ANY = "*"


def is_name(text: object) -> bool:
    """Whether `text` may stand as one segment: 1..64 of A-Z a-z 0-9 _ . -, a letter or digit first."""
    return isinstance(text, str) and NAME.fullmatch(text) is not None


def check_name(field: str, text: str) -> str:
    """`text`, or ValueError naming `field`."""
    if not is_name(text):
        raise ValueError(f"{field}: got {text!r}; allowed 1..64 of A-Z a-z 0-9 _ . - (letter or digit first)")
    return text


def upload(run_id: str, actor_id: str) -> str:
    return f"appl/{run_id}/upload/{actor_id}"


def work(run_id: str, actor_id: str) -> str:
    return f"appl/{run_id}/work/{actor_id}"


def claim(run_id: str, actor_id: str, incarnation: str) -> str:
    return f"appl/{run_id}/claim/{actor_id}/{incarnation}"


def weights(run_id: str) -> str:
    return f"appl/{run_id}/weights"


def state(run_id: str) -> str:
    return f"appl/{run_id}/state"


def status(run_id: str) -> str:
    return f"appl/{run_id}/status"


def alive(run_id: str, role: str, member_id: str, incarnation: str) -> str:
    return f"appl/{run_id}/alive/{role}/{member_id}/{incarnation}"


def progress(run_id: str, role: str, member_id: str) -> str:
    return f"appl/{run_id}/progress/{role}/{member_id}"
