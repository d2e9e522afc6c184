"""docker/compose.yaml with a real engine: built, run, scaled, killed, stopped; then the ledger.

Building takes minutes, so it runs when asked for: APPL_TEST_DOCKER=1 python -m pytest tests/docker (=run: with the
images that are there).
BASE, BUILD_NETWORK, TORCH_INDEX and the PIP_ variables reach the build as in docker/compose.yaml.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILD_S, WAIT_S = 3600.0, 600.0
SMALL = "world.count=6 learner.min_transitions=60 learner.td3.hidden=[32,32] learner.checkpoint_every_s=3"
ACTOR_MB = 350  # the image, of which about 125 are the base's

pytestmark = pytest.mark.timeout(BUILD_S + 4 * WAIT_S)


def docker(*arguments: str, timeout_s: float = 120.0) -> str:
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)
    assert done.returncode == 0, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout.strip()


class Compose:
    """One project of docker/compose.yaml."""

    def __init__(self, command: list[str]) -> None:
        self._command = [*command, "-p", "appltest", "-f", str(ROOT / "docker" / "compose.yaml")]
        self._environment = {**os.environ, "RUN": "test", "TRANSITIONS": "1000000", "OVERRIDES": SMALL}

    def __call__(self, *arguments: str, timeout_s: float = 180.0) -> str:
        done = subprocess.run(
            [*self._command, *arguments],
            cwd=ROOT, env=self._environment, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{' '.join(arguments)}: {done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout.strip()

    def containers(self, service: str) -> list[dict[str, Any]]:
        """What the engine says of each, ended ones included."""
        ids = docker(
            "ps", "-aq", "--filter", "label=com.docker.compose.project=appltest", "--filter",
            f"label=com.docker.compose.service={service}", "--filter", "label=com.docker.compose.oneoff=False",
        ).split()  # fmt: skip
        found: list[dict[str, Any]] = json.loads(docker("inspect", *ids)) if ids else []
        return found

    def status(self) -> str:
        return self("exec", "-T", "learner", "appl-dist", "status")

    def wait(self, what: Callable[[], object], name: str) -> None:
        deadline = time.monotonic() + WAIT_S
        while time.monotonic() < deadline:
            if what():
                return
            time.sleep(1.0)
        pytest.fail(f"waited too long for {name}: {self('ps')}\n{self('logs', '--tail=30')}")


def command() -> list[str]:
    """`docker compose` or `docker-compose`; skips without either, or without an engine."""
    if os.environ.get("APPL_TEST_DOCKER") not in ("1", "run"):
        pytest.skip("builds images for minutes: set APPL_TEST_DOCKER=1 to run it")
    if shutil.which("docker") is None:
        pytest.skip("docker is not installed")
    if subprocess.run(["docker", "info"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no Docker engine answers")
    if subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode == 0:
        return ["docker", "compose"]
    if shutil.which("docker-compose"):
        return ["docker-compose"]
    pytest.skip("docker has no compose here")


@pytest.fixture
def compose() -> Iterator[Compose]:
    project = Compose(command())
    if os.environ["APPL_TEST_DOCKER"] == "1":
        project("build", timeout_s=BUILD_S)
    yield project
    project("down", "--volumes", "--timeout", "30")


def healthy(containers: list[dict[str, Any]]) -> bool:
    return bool(containers) and all(c["State"].get("Health", {}).get("Status") == "healthy" for c in containers)


def transitions(status: str) -> int:
    line = next(line for line in status.splitlines() if " transitions " in line and "/" in line)
    return int(line.split("/")[0].split()[-1].replace(",", ""))


def test_compose_runs_scales_survives_and_stops(compose: Compose) -> None:
    size = int(docker("image", "inspect", "--format", "{{.Size}}", "appl-dist-actor")) / 1e6
    assert size < ACTOR_MB
    compose("up", "-d", "--no-build", "--scale", "actor=3", timeout_s=WAIT_S)
    services = ("learner", "actor", "tensorboard")
    compose.wait(lambda: all(healthy(compose.containers(s)) for s in services), "all to be healthy")
    actors = compose.containers("actor")
    assert len(actors) == 3

    for container in (*actors, *compose.containers("learner")):
        name = container["Id"]
        assert docker("exec", name, "id", "-u") == "10001"
        touched = subprocess.run(["docker", "exec", name, "touch", "/opt/appl/x"], capture_output=True, check=False)
        assert b"Read-only file system" in touched.stderr
    torch = ["docker", "exec", actors[0]["Id"], "python3", "-c", "import torch"]
    assert b"No module named 'torch'" in subprocess.run(torch, capture_output=True, check=False).stderr
    assert json.load(urllib.request.urlopen("http://127.0.0.1:6006/data/runs", timeout=20)) == ["test"]

    before = transitions(compose.status())
    compose.wait(lambda: transitions(compose.status()) > before + 60, "transitions")
    for container in (actors[0], *compose.containers("learner")):  # not `docker kill`, which says: stay down
        os.kill(container["State"]["Pid"], signal.SIGKILL)
    compose.wait(lambda: len(compose.containers("learner")) == 1 and healthy(compose.containers("learner")), "learner")
    assert compose.containers("learner")[0]["RestartCount"] == 1
    before = transitions(compose.status())
    compose.wait(lambda: transitions(compose.status()) > before + 60, "transitions after the kills")
    compose.wait(lambda: all(f"actor-{i} " in compose.status() for i in range(3)), "all three actors")

    compose("kill", "-s", "TERM", "learner")
    ended = lambda: [c["State"]["Status"] for c in compose.containers("actor")] == ["exited"] * 3  # noqa: E731
    compose.wait(ended, "all actors to end")
    assert {c["State"]["ExitCode"] for c in compose.containers("actor")} == {0}
    ledger = compose("run", "--rm", "--no-deps", "-T", "learner", "ledger", "/runs/test")
    print(ledger)
    assert "lost 0, duplicate 0: the accounts agree" in ledger
