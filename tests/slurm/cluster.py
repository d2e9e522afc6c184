"""A Slurm cluster on this machine: munged, slurmctld and several slurmd, each a node of its own, in one folder.

    python -m tests.slurm.cluster 3        # a cluster to try things on, until Ctrl-C; prints what to export

Everything listens on this host and runs as this user; nothing of an installed Slurm is read or changed.
"""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "scontrol", "scancel", "squeue")
START_S = 60.0

_CONF = """\
ClusterName=appl
SlurmctldHost={host}
SlurmctldPort={port}
AuthType=auth/munge
# A requeued job waits until its credential has expired, 120 s unless told.
AuthInfo=socket={folder}/munge.socket,cred_expire=5
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool.%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2,sched_min_interval=0,bf_interval=2
SlurmdParameters=config_overrides
SlurmdTimeout=10
KillWait=20
ReturnToService=2
{nodes}
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def missing_programs() -> list[str]:
    return [name for name in PROGRAMS if _which(name) is None]


class Cluster:
    """Construct to start, `close` to end. `environment`: what sbatch and its like need to reach it."""

    def __init__(self, folder: Path, nodes: int, cpus: int = 4) -> None:
        self.folder = folder
        self.names = [f"n{i + 1}" for i in range(nodes)]
        self._daemons: dict[str, subprocess.Popen[bytes]] = {}
        host = socket.gethostname()
        ports = _free_ports(nodes + 1)
        rows = [
            f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cpus} RealMemory=4000"
            for name, port in zip(self.names, ports[1:], strict=True)
        ]
        folder.mkdir(parents=True, exist_ok=True)
        os.chmod(folder, 0o755)
        for name in ("state", *(f"spool.{n}" for n in self.names)):
            (folder / name).mkdir(exist_ok=True)
        conf = _CONF.format(
            host=f"{host}(127.0.0.1)", port=ports[0], folder=folder, user=getpass.getuser(), nodes="\n".join(rows)
        )
        (folder / "slurm.conf").write_text(conf)
        (folder / "cgroup.conf").write_text("CgroupPlugin=autodetect\n")
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def run(self, *command: str) -> str:
        """What a Slurm command prints; CalledProcessError with its words if it fails."""
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=60, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
        return done.stdout.strip()

    def node_of(self, job: str) -> str:
        """The node a job (or JOB_TASK) runs on, "" if none."""
        return self.run("squeue", "--noheader", "--states=RUNNING", "--format=%N", "--job", job)

    def states(self) -> dict[str, str]:
        """The state of each node, such as "IDLE", "MIXED" or "DOWN"."""
        rows = self.run("scontrol", "show", "nodes", "--oneliner").splitlines()
        fields = [dict(f.split("=", 1) for f in row.split() if "=" in f) for row in rows]
        return {f["NodeName"]: f["State"] for f in fields}

    def kill_daemon(self, node: str) -> None:
        """kill -9 of a node's slurmd; what it started lives on."""
        self._daemons[node].kill()
        self._daemons[node].wait()

    def kill_node(self, node: str) -> list[int]:
        """kill -9 of a node's slurmd and of everything it started, as when the power fails. Returns the ids."""
        steps = self._processes_of(node)
        self.kill_daemon(node)
        for process in steps:
            process.kill()
        return [p.pid for p in steps]

    def start_node(self, node: str) -> None:
        self._daemon(node, "slurmd", "-D", "-N", node, "-f", str(self.folder / "slurm.conf"))

    def close(self) -> None:
        """End all daemons and whatever they started."""
        mine = self.processes()
        for daemon in reversed(self._daemons.values()):
            daemon.kill()
            daemon.wait()
        munged = self.folder / "munged.pid"
        if munged.exists():
            os.kill(int(munged.read_text()), signal.SIGTERM)
            munged.unlink(missing_ok=True)
        for process in mine:
            if process.is_running():
                process.kill()

    def processes(self) -> list[psutil.Process]:
        """Every job step of this cluster, and all below."""
        return [p for node in self.names for p in self._processes_of(node)]

    def _processes_of(self, node: str) -> list[psutil.Process]:
        """Job steps of a node, first, then all below them: the scripts' environment names the node."""
        below, steps = [], []
        for process in psutil.process_iter():
            try:
                environment, parent = process.environ(), process.parent()
            except (psutil.Error, OSError):
                continue
            if environment.get("SLURM_CONF") == str(self.folder / "slurm.conf") and (
                environment.get("SLURMD_NODENAME") == node
            ):
                below.append(process)
                if parent is not None and parent.name() == "slurmstepd":
                    steps.append(parent)
        return [*steps, *below]

    def _start(self) -> None:
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        f = self.folder
        self._execute(
            "munged", "--force", f"--key-file={key}", f"--socket={f}/munge.socket", f"--pid-file={f}/munged.pid",
            f"--log-file={f}/munged.log", f"--seed-file={f}/munged.seed",
        )  # fmt: skip
        self._daemon("slurmctld", "slurmctld", "-D", "-f", str(f / "slurm.conf"))
        for name in self.names:
            self.start_node(name)
        self._wait(lambda: set(self.states().values()) == {"IDLE"})

    def _execute(self, program: str, *arguments: str) -> None:
        subprocess.run([_which(program) or program, *arguments], check=True, env=self.environment)

    def _daemon(self, name: str, program: str, *arguments: str) -> None:
        with (self.folder / f"{name}.out").open("ab") as out:
            self._daemons[name] = subprocess.Popen(
                [_which(program) or program, *arguments], stdin=subprocess.DEVNULL, stdout=out, stderr=out,
                env=self.environment,
            )  # fmt: skip

    def _wait(self, ready: Callable[[], bool]) -> None:
        deadline = time.monotonic() + START_S
        why: object = "nodes are not idle"
        while time.monotonic() < deadline:
            for name, daemon in self._daemons.items():
                if daemon.poll() is not None:
                    raise RuntimeError(f"{name} ended: {(self.folder / f'{name}.out').read_text()[-1000:]}")
            try:
                if ready():
                    return
            except RuntimeError as error:  # slurmctld does not answer yet
                why = error
            time.sleep(0.3)
        raise RuntimeError(f"the cluster did not start within {START_S:.0f} s: {why}")


def _which(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for s in sockets:
            s.bind(("127.0.0.1", 0))
        return [s.getsockname()[1] for s in sockets]
    finally:
        for s in sockets:
            s.close()


def main() -> None:
    signals = {signal.SIGINT, signal.SIGTERM}
    cluster = Cluster(Path(tempfile.mkdtemp(prefix="appl-slurm-")), int(sys.argv[1]) if len(sys.argv) > 1 else 3)
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        print(f"export SLURM_CONF={cluster.folder}/slurm.conf", flush=True)
        signal.sigwait(signals)
    finally:
        cluster.close()
        shutil.rmtree(cluster.folder, ignore_errors=True)


if __name__ == "__main__":
    main()
