"""What the wire's tests share: rollouts that can be told apart, stores, free ports."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from appl_dist.spec import Rollout
from appl_dist.wire.codec import Ack, UploadHeader
from tests.paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE


def make_rollout(tag: int, transitions: int = 3) -> Rollout:
    """A rollout whose numbers follow from `tag`, which it also carries in its info."""
    rng = np.random.default_rng(tag)
    return Rollout(
        rng.uniform(-1, 1, (transitions + 1, OBSERVATION_SIZE)).astype(np.float32),
        rng.uniform(-1, 1, (transitions, 8)).astype(np.float32),
        rng.normal(size=transitions).astype(np.float32),
        bool(tag % 2),
        {"tag": tag},
        LIDAR_BEAMS,
    )


class ListStore:
    """A replay that is a list for each actor and insists on the right order."""

    def __init__(self) -> None:
        self.rollouts: dict[str, list[Rollout]] = {}

    def insert(self, rollout: Rollout, actor_id: str, seq: int) -> None:
        assert seq == self.expected_seq(actor_id)
        self.rollouts.setdefault(actor_id, []).append(rollout)

    def expected_seq(self, actor_id: str) -> int:
        return len(self.rollouts.get(actor_id, ()))

    def tags(self, actor_id: str) -> list[int]:
        return [rollout.info["tag"] for rollout in self.rollouts.get(actor_id, ())]


class FileStore:
    """A replay that keeps one line a rollout in a file: what a killed process stored is still there."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        self._counts: dict[str, int] = {}
        for actor, _, _ in self.read(path):
            self._counts[actor] = self._counts.get(actor, 0) + 1

    @staticmethod
    def read(path: Path) -> list[tuple[str, int, int]]:
        """(actor, seq, tag) in the order stored."""
        lines = path.read_text().split("\n")[:-1] if path.exists() else []
        return [(actor, int(seq), int(tag)) for actor, seq, tag in (line.split() for line in lines)]

    def insert(self, rollout: Rollout, actor_id: str, seq: int) -> None:
        assert seq == self.expected_seq(actor_id)
        os.write(self._file, f"{actor_id} {seq} {rollout.info['tag']}\n".encode())
        self._counts[actor_id] = seq + 1

    def expected_seq(self, actor_id: str) -> int:
        return self._counts.get(actor_id, 0)


class ScriptedSink:
    """An upload sink that answers what the test says, then stores."""

    def __init__(self, *answers: Ack | Exception) -> None:
        self.answers = list(answers)
        self.seen: list[int] = []

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        if self.answers:
            answer = self.answers.pop(0)
            if isinstance(answer, Exception):
                raise answer
            return answer
        self.seen.append(rollout.info["tag"])
        return Ack("stored", expected=len(self.seen))

    def expected_seq(self, actor_id: str) -> int:
        return len(self.seen)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def wait_until(condition: Callable[[], object], timeout_s: float = 20.0) -> bool:
    """Poll until true; the time-out only bounds a failing test."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True
