"""docker/compose.yaml with a real engine, plain and with mutual TLS: built, scaled, killed, stopped; then the ledger.

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
import sys
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
USER = 10001
SERVICES = ("learner", "actor", "tensorboard")

pytestmark = pytest.mark.timeout(BUILD_S + 4 * WAIT_S)


def run(command: list[str], timeout_s: float = 120.0, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment},
        capture_output=True, text=True, timeout=timeout_s, check=False,
    )  # fmt: skip


def docker(*arguments: str) -> str:
    done = run(["docker", *arguments])
    assert done.returncode == 0, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout.strip()


class Compose:
    """One project of docker/compose.yaml; with `keys`, of compose.tls.yaml over it."""

    def __init__(self, command: list[str], keys: Path | None) -> None:
        files = ["compose.yaml", *(["compose.tls.yaml"] if keys else [])]
        self._command = [*command, "-p", "appltest", *(f"--file={ROOT / 'docker' / file}" for file in files)]
        self._environment = {"RUN": "test", "TRANSITIONS": "1000000", "OVERRIDES": SMALL, "KEYS": str(keys or "")}
        self.wire = ["wire=tls", "wire.keys=/keys"] if keys else []

    def __call__(self, *arguments: str, timeout_s: float = 240.0) -> str:
        done = run([*self._command, *arguments], timeout_s, **self._environment)
        assert done.returncode == 0, f"{' '.join(arguments)}: {done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout.strip()

    def up(self) -> None:
        self("up", "-d", "--no-build", "--scale", "actor=3", timeout_s=WAIT_S)
        self.wait(lambda: all(healthy(self.containers(s)) for s in SERVICES), "all to be healthy")

    def containers(self, service: str) -> list[dict[str, Any]]:
        """What the engine says of each, ended ones included."""
        ids = docker(
            "ps", "-aq", "--filter", "label=com.docker.compose.project=appltest", "--filter",
            f"label=com.docker.compose.service={service}", "--filter", "label=com.docker.compose.oneoff=False",
        ).split()  # fmt: skip
        # One that has gone meanwhile is not in the answer.
        found: list[dict[str, Any]] = json.loads(run(["docker", "inspect", *ids]).stdout or "[]") if ids else []
        return found

    def everyone(self) -> list[dict[str, Any]]:
        return [container for service in SERVICES for container in self.containers(service)]

    def status(self) -> str:
        """What the learner says, "" while it does not answer."""
        endpoint = ["wire.endpoint=tls/localhost:7447"] if self.wire else []
        names = [c["Id"] for c in self.containers("learner")]
        return run(["docker", "exec", *names, "appl-dist", "status", *self.wire, *endpoint]).stdout

    def transitions(self) -> int:
        """-1 while the learner does not answer."""
        counts = [line.split("/")[0] for line in self.status().splitlines() if " transitions " in line and "/" in line]
        return int(counts[0].split()[-1].replace(",", "")) if counts else -1

    def grow(self, more: int) -> None:
        before = self.transitions()
        self.wait(lambda: self.transitions() > before + more, f"{more} transitions after {before}")

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
    if run(["docker", "info"]).returncode != 0:
        pytest.skip("no Docker engine answers")
    if run(["docker", "compose", "version"]).returncode == 0:
        return ["docker", "compose"]
    if shutil.which("docker-compose"):
        return ["docker-compose"]
    pytest.skip("docker has no compose here")


@pytest.fixture(params=["plain", "tls"])
def keys(request: pytest.FixtureRequest, tmp_path: Path) -> Path | None:
    """The keys of a run for the images' user; none for a run without."""
    if request.param == "plain":
        return None
    command()
    folder = tmp_path / "keys"
    made = run([sys.executable, "-m", "appl_dist", "keys", str(folder), "--host", "learner"])
    assert made.returncode == 0, made.stderr
    try:
        for path in (folder, *folder.rglob("*")):
            os.chown(path, USER, USER)
    except PermissionError:
        pytest.skip(f"giving the keys to user {USER} takes root")
    return folder


@pytest.fixture
def compose(keys: Path | None) -> Iterator[Compose]:
    project = Compose(command(), keys)
    if os.environ["APPL_TEST_DOCKER"] == "1":
        project("build", timeout_s=BUILD_S)
    yield project
    project("stop", "--timeout", "30")
    project("down", "--volumes")


def healthy(containers: list[dict[str, Any]]) -> bool:
    """Whether each one's check has passed since it started: on a busy machine some check or other times out."""
    passed = [any(run["ExitCode"] == 0 for run in c["State"].get("Health", {}).get("Log") or ()) for c in containers]
    return bool(passed) and all(passed)


def test_compose_runs_scales_survives_and_stops(compose: Compose, keys: Path | None) -> None:
    sizes = {n: int(docker("image", "inspect", "--format", "{{.Size}}", f"appl-dist-{n}")) for n in SERVICES[:2]}
    print({name: f"{size / 1e6:.0f} MB" for name, size in sizes.items()})
    assert sizes["actor"] / 1e6 < ACTOR_MB
    compose.up()
    actors, learners = compose.containers("actor"), compose.containers("learner")
    assert (len(actors), len(learners)) == (3, 1)
    confined(compose)
    torch = run(["docker", "exec", actors[0]["Id"], "python3", "-c", "import torch"])
    assert "No module named 'torch'" in torch.stderr
    assert json.load(urllib.request.urlopen("http://127.0.0.1:6006/data/runs", timeout=20)) == ["test"]
    if keys:
        kept_out(actors[0]["Id"])

    compose.grow(60)
    for container in (actors[0], *learners):  # not `docker kill`, which says: stay down
        os.kill(container["State"]["Pid"], signal.SIGKILL)
    compose.wait(lambda: [c["RestartCount"] for c in compose.containers("learner")] == [1], "a second learner")
    compose.wait(lambda: healthy(compose.containers("learner")), "the second learner to be healthy")
    compose.grow(60)
    compose.wait(lambda: all(f"actor-{i} " in compose.status() for i in range(3)), "all three actors")

    # As Ctrl-C does, and `up` another time.
    compose("stop")
    assert {c["State"]["ExitCode"] for s in ("learner", "actor") for c in compose.containers(s)} == {0}
    assert_balanced(compose)
    compose.up()
    compose.grow(60)

    # The learner's end is everyone's.
    compose("kill", "-s", "TERM", "learner")
    compose.wait(lambda: [c["State"]["Status"] for c in compose.containers("actor")] == ["exited"] * 3, "their end")
    assert {c["State"]["ExitCode"] for c in compose.containers("actor")} == {0}
    assert_balanced(compose)
    if keys:
        nowhere(compose, keys)


def confined(compose: Compose) -> None:
    """Every container: its own user, no capability, one writable volume, everything else read-only."""
    for container in compose.everyone():
        name = container["Id"]
        assert docker("exec", name, "id", "-u") == str(USER)
        assert "Read-only file system" in run(["docker", "exec", name, "touch", "/opt/appl/x"]).stderr
        assert "CapEff:\t0000000000000000" in docker("exec", name, "cat", "/proc/1/status")
        writable = {m["Destination"] for m in container["Mounts"] if m["RW"]} - {"/keys"}
        assert writable <= {"/runs"}, container["Mounts"]


def kept_out(actor: str) -> None:
    """Another container on the same network, without a certificate or with a name that is not its own."""
    for arguments in (["wire.endpoint=tcp/learner:7447"], ["wire=lan", "wire.keys=/keys"]):
        said = run(["docker", "exec", actor, "appl-dist", "status", "wire.endpoint=tcp/learner:7447", *arguments])
        assert said.returncode == 2, said
        assert len(said.stderr.strip().splitlines()) == 1, said.stderr
    assert "No such file" in run(["docker", "exec", actor, "ls", "/keys/learner", "/keys/ca"]).stderr


def nowhere(compose: Compose, keys: Path) -> None:
    """No key or password in the engine's own records, in what was logged, or in the volume."""
    secrets = [p.read_text().splitlines()[1] for p in keys.glob("*/key.pem")]
    secrets += [p.read_text().strip().partition(":")[2] for p in keys.glob("*/password")]
    assert len(secrets) == 7  # four keys, the authority's among them, and three passwords
    written = json.dumps(compose.everyone()) + compose("logs", "--no-color")
    assert not any(secret in written for secret in secrets)
    patterns = [word for secret in secrets for word in ("-e", secret)]
    search = [*compose._command, "run", "--rm", "--no-deps", "-T", "--entrypoint", "grep", "learner", "-rFl", *patterns]
    found = run([*search, "/runs"], **compose._environment)
    assert (found.returncode, found.stdout) == (1, ""), found


def assert_balanced(compose: Compose) -> None:
    ledger = compose("run", "--rm", "--no-deps", "-T", "learner", "ledger", "/runs/test")
    print(ledger)
    assert "lost 0, duplicate 0: the accounts agree" in ledger
