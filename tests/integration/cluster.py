"""A learner and actors as real processes of the command line, to be killed, frozen, cut off and restarted."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from appl_dist.launch.ledger import Ledger, run_ledger
from tests.metrics_file import transitions
from tests.unit.wire.support import free_endpoint

LEARNER = [
    "world.count=6", "timing=ideal", "run.transitions=1000000", "learner.min_transitions=60",
    "learner.samples_per_insert=64", "learner.td3.hidden=[16,16]", "learner.replay_capacity=20000",
    "learner.checkpoint_every_s=2", "learner.report_every_s=0.2", "wire.timeout_s=60",
]  # fmt: skip
PATIENCE_S = 200.0  # only bounds a failing test


class Cable:
    """Forwards TCP connections to a port; pulled, it forwards nothing and tells nobody."""

    def __init__(self, to_port: int) -> None:
        self._to_port = to_port
        self._plugged = threading.Event()
        self._plugged.set()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._sockets = [self._server]
        threading.Thread(target=self._accept, daemon=True).start()

    def pull(self) -> None:
        self._plugged.clear()

    def plug(self) -> None:
        self._plugged.set()

    def close(self) -> None:
        self.plug()
        for open_socket in self._sockets:
            open_socket.close()

    def _accept(self) -> None:
        while True:
            try:
                near = self._server.accept()[0]
            except OSError:
                return
            threading.Thread(target=self._connect, args=(near,), daemon=True).start()

    def _connect(self, near: socket.socket) -> None:
        self._plugged.wait()
        try:
            far = socket.create_connection(("127.0.0.1", self._to_port))
        except OSError:  # nobody listens there now: as the far end would say
            near.close()
            return
        self._sockets += [near, far]
        for source, sink in ((near, far), (far, near)):
            threading.Thread(target=self._forward, args=(source, sink), daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(1 << 16):
                self._plugged.wait()
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)
        except OSError:
            pass


class Cluster:
    """One run under `root`: `root/run` of the learner, `root/spools/ID` of each actor; a cable between them.

    host, prefix: where the learner listens instead, and what starts an actor there; then without the cable.
    """

    def __init__(
        self,
        root: Path,
        *learner: str,
        actor: tuple[str, ...] = (),
        tls: bool = False,
        host: str = "",
        prefix: tuple[str, ...] = (),
    ) -> None:
        self.root, self.run = root, root / "run"
        self.root.mkdir(parents=True, exist_ok=True)
        scheme = "tls" if tls else "tcp"
        self._listen = free_endpoint().replace("tcp", scheme)
        self.cable = Cable(int(self._listen.rsplit(":", 1)[1]))
        self._connect = f"{scheme}/127.0.0.1:{self.cable.port}"
        if host:
            self._listen = self._connect = self._listen.replace("127.0.0.1", host)
        self._prefix = prefix
        self._learner, self._actor = (*learner, *(("wire.security=none",) if host else ())), actor
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start_learner(self, folder: str = "run") -> None:
        """New, or continued from what is in the folder."""
        self.run = self.root / folder
        key = "run.resume" if (self.run / "replay").exists() else "run.folder"
        self._start(
            "learner", "learner", f"wire.endpoint={self._listen}", f"{key}={self.run}", *LEARNER, *self._learner
        )

    def begin(self) -> None:
        """A new learner, there and ready: an actor that starts now need not wait for it."""
        self.start_learner()
        self.wait_for(lambda: "TD3 on" in self.log("learner"), "the learner")

    def start_actor(self, actor_id: str, spool: str = "", name: str = "", code: str = "") -> None:
        """code: Python to run before the command line."""
        spool_folder = self.root / "spools" / (spool or actor_id)
        settings = [f"wire.endpoint={self._connect}", f"actor.id={actor_id}", f"actor.spool={spool_folder}"]
        settings += ["wire.timeout_s=60", *self._actor]
        self._start(name or actor_id, "actor", *settings, code=code, prefix=self._prefix)

    def signal(self, name: str, number: int) -> None:
        self.processes[name].send_signal(number)

    def kill(self, *names: str) -> None:
        for name in names:
            self.processes[name].kill()
        for name in names:
            self.processes[name].wait(20)

    def wait(self, name: str) -> tuple[int, str]:
        """(exit status, what it printed)"""
        status = self.processes[name].wait(PATIENCE_S)
        return status, self.log(name)

    def log(self, name: str) -> str:
        file = self.root / f"{name}.log"
        return file.read_text() if file.exists() else ""

    def steps(self) -> int:
        """Transitions in replay, as last reported."""
        return transitions(self.run)

    def wait_for(self, what: Callable[[], object], says: str) -> float:
        """How long it took, s."""
        began = time.monotonic()
        while not what():
            if time.monotonic() - began > PATIENCE_S:
                logs = "\n".join(f"--- {name}\n{self.log(name)[-1500:]}" for name in self.processes)
                raise AssertionError(f"waited too long for {says}\n{logs}")
            time.sleep(0.05)
        return time.monotonic() - began

    def wait_for_more(self, transitions: int = 1) -> float:
        before = self.steps()
        return self.wait_for(
            lambda: self.steps() >= before + transitions, f"{transitions} more than {before} transitions"
        )

    def finish(self) -> Ledger:
        """End the run in order and compare the accounts."""
        self.signal("learner", signal.SIGINT)
        for name, process in self.processes.items():
            assert process.wait(PATIENCE_S) is not None, name
        return run_ledger(self.run, [self.root / "spools"])

    def close(self) -> None:
        for process in self.processes.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        self.cable.close()

    def _start(self, name: str, role: str, *settings: str, code: str = "", prefix: tuple[str, ...] = ()) -> None:
        run = f"{code}; import sys; from appl_dist.__main__ import main; sys.exit(main())"
        command = [sys.executable, "-c", run] if code else [sys.executable, "-m", "appl_dist"]
        with (self.root / f"{name}.log").open("ab") as out:
            self.processes[name] = subprocess.Popen(
                [*prefix, *command, role, *settings],
                cwd=self.root,
                stdout=out,
                stderr=subprocess.STDOUT,
                env=dict(os.environ),
            )
