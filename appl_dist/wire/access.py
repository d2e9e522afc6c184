"""Who may say what: the access rules that the learner's router applies before any of our code sees a message.

Everything that is not listed is refused, in silence (the sender sees no answer). Sizes are bounded per key the same
way. Without credentials everyone may say what any actor may; with them, each identity only what its own name covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import MAX_HEADER_BYTES, MAX_ROLLOUT_BYTES
from appl_dist.wire.credentials import LEARNER, VIEWER
from appl_dist.wire.key_expressions import ANY
from appl_dist.wire.liveness import MAX_PROGRESS_BYTES
from appl_dist.wire.work import MAX_RESULT_BYTES

# What actors and viewers may ask of the learner, and be told by it unasked.
ASKED = (keys.RUN, keys.weights(ANY), keys.state(ANY), keys.status(ANY))
TOLD = (keys.weights(ANY), keys.state(ANY))
_LEARNER_TOKEN = keys.alive(ANY, "learner", ANY, ANY)


def _actor(names: Sequence[str]) -> dict[str, list[str]]:
    """Message kinds an actor may send, with their keys, for the actor ids in `names` (zenoh key expressions)."""
    return {
        "query": [*ASKED, *(key(ANY, name) for name in names for key in (keys.upload, keys.work))],
        "put": [keys.progress(ANY, "actor", name) for name in names],
        "declare_subscriber": list(TOLD),
        "liveliness_token": [
            key for name in names for key in (keys.claim(ANY, name, ANY), keys.alive(ANY, "actor", name, ANY))
        ],
        "declare_liveliness_subscriber": [_LEARNER_TOKEN],
        "liveliness_query": [_LEARNER_TOKEN],
    }


_VIEWER = {
    "query": list(ASKED),
    "declare_liveliness_subscriber": [_LEARNER_TOKEN],
    "liveliness_query": [_LEARNER_TOKEN],
}


def access_control(users: Sequence[str] | None, by: str) -> dict[str, Any]:
    """zenoh's `access_control`. users: names of all identities, None for a wire open to anyone who can reach it.

    by: how a connection proves its name, "usernames" or "cert_common_names".
    """
    rules: list[dict[str, Any]] = [
        {"id": "hear", "permission": "allow", "flows": ["egress"], "messages": _MESSAGES, "key_exprs": ["**"]}
    ]
    subjects, policies = [], []
    allowed = (
        {"anyone": _actor([ANY])} if users is None else {name: _allowed(name) for name in users if name != LEARNER}
    )
    for name, said in allowed.items():
        subjects.append({"id": name} if users is None else {"id": name, by: [name]})
        ids = []
        for message, key_exprs in said.items():
            ids.append(f"{name} {message}")
            rules.append(
                {
                    "id": ids[-1],
                    "permission": "allow",
                    "flows": ["ingress"],
                    "messages": [message],
                    "key_exprs": key_exprs,
                }
            )
        policies.append({"rules": ["hear", *ids], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _allowed(name: str) -> dict[str, list[str]]:
    return _VIEWER if name == VIEWER else _actor([name, f"{name}-$*"])


def size_limits() -> list[dict[str, Any]]:
    """zenoh's `low_pass_filter`: larger messages are dropped by the transport."""
    data = ["put", "delete", "query", "reply"]
    limits = {
        "upload": ([keys.upload(ANY, ANY)], MAX_ROLLOUT_BYTES + MAX_HEADER_BYTES),
        "work": ([keys.work(ANY, ANY)], MAX_RESULT_BYTES),
        "progress": ([keys.progress(ANY, ANY, ANY)], MAX_PROGRESS_BYTES),
        "questions": (list(ASKED), 2 * MAX_HEADER_BYTES),
    }
    return [
        {"id": name, "flows": ["ingress"], "messages": data, "key_exprs": key_exprs, "size_limit": size}
        for name, (key_exprs, size) in limits.items()
    ]


def rate_limits() -> list[dict[str, Any]]:
    """zenoh's `downsampling`: what one connection says faster than this is dropped by the transport.

    Uploads are not among them: the learner's queue bounds those by actor (`upload.UploadServer`).
    """
    limits = {
        "progress": ("put", [keys.progress(ANY, ANY, ANY)], _PROGRESS_HZ),
        "questions": ("query", list(ASKED), _QUESTIONS_HZ),
    }
    return [
        {
            "id": name,
            "flows": ["ingress"],
            "messages": [message],
            "rules": [{"key_expr": key, "freq": hertz} for key in key_exprs],
        }
        for name, (message, key_exprs, hertz) in limits.items()
    ]


_PROGRESS_HZ = 10.0
_QUESTIONS_HZ = 100.0  # of each kind
_MESSAGES = [
    "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
    "liveliness_token", "declare_liveliness_subscriber", "liveliness_query",
]  # fmt: skip
