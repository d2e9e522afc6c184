"""How many transitions per second one learner takes in, and how fast its policies reach a fleet.

    python benchmarks/learner_ingest.py                              # everything below
    python benchmarks/learner_ingest.py ingest --clients 1 8 64 500  # the learner only stores
    python benchmarks/learner_ingest.py train --clients 1 8 64 500   # the learner also trains, as fast as it can
    python benchmarks/learner_ingest.py weights --clients 500        # the papers' policy to every client

The learner is the real one (wire, ingest, replay on disk, TD3 of the papers' size). Clients are light actors in a few
processes: each has its own connection and uploads recorded transitions in batches of about 64 KB, the next as soon as
the last one is acknowledged. All of it shares this machine's cores, so the clients' work is part of the cost.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import socket
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil
from paper_sizes import LAYOUT

from appl_dist.learner.settings import LearnerSettings, TD3Settings
from appl_dist.planner.dwa import DWA
from appl_dist.spec import Rollout
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus
from appl_dist.wire.codec import Ack, UploadHeader, decode_header, encode_header, encode_rollout
from appl_dist.wire.session import open_session
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings

if TYPE_CHECKING:  # clients are light: torch and the simulator are imported where they are used
    from appl_dist.learner.learner import Learner

RUN = "bench"
BATCH = 41  # transitions: 64 KB
CLIENT_PROCESSES = 4
FOR_EVER = 10**9


def record(count: int) -> list[bytes]:
    """`count` batches of real transitions: random parameters in generated worlds."""
    from appl_dist.actor.env import NavigationEnv
    from appl_dist.actor.rollout import collect
    from appl_dist.sim.generate import generate_worlds

    env, rng, episodes = NavigationEnv(generate_worlds(20, 0)), np.random.default_rng(0), []
    while sum(map(len, episodes)) < count * BATCH:
        rollout = collect(env, lambda _: rng.uniform(-1, 1, len(DWA)).astype(np.float32), seed=None if episodes else 0)
        assert rollout is not None
        episodes.append(rollout)
    env.close()
    observations = np.concatenate([e.observations[:-1] for e in episodes] + [episodes[-1].observations[-1:]])
    actions, rewards = (np.concatenate([getattr(e, name) for e in episodes]) for name in ("actions", "rewards"))
    info = {**episodes[-1].info, "policy_epoch": 1, "policy_version": 1}
    return [
        encode_rollout(
            Rollout(
                observations[i : i + BATCH + 1],
                actions[i : i + BATCH],
                rewards[i : i + BATCH],
                True,
                info,
                LAYOUT.scan_size,
            )
        )
        for i in range(0, count * BATCH, BATCH)
    ]


def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def learner(bus: Bus, folder: Path, train: bool) -> Learner:
    """A learner that never holds an upload back, and trains at full speed or not at all."""
    from appl_dist.learner.learner import Learner
    from appl_dist.learner.run_info import Run

    settings = LearnerSettings(
        td3=TD3Settings(), replay_capacity=500_000, samples_tolerance=FOR_EVER,
        min_transitions=1000 if train else FOR_EVER,
    )  # fmt: skip
    run = Run(RUN, folder, 0, 10**10, 0.0, {}, DWA, LAYOUT, 70.0, lambda _: 0.0)
    return Learner(bus, run, settings)


class Client:
    """One actor: uploads, waits for the answer, uploads the next."""

    def __init__(self, address: str, name: str) -> None:
        self.name = name
        self.session = open_session(WireSettings(address, timeout_s=60.0), listen=False)
        self.claim = self.session.announce(keys.claim(RUN, name, self.session.identity))
        welcome = self._ask(b"", 0, 0)
        assert welcome.status == "welcome", welcome
        self.epoch = welcome.epoch
        self.latencies_s: list[float] = []

    def upload(self, blobs: list[bytes], stop: threading.Event) -> None:
        for seq in itertools.count():
            began = time.perf_counter()
            ack = self._ask(blobs[seq % len(blobs)], seq, self.epoch)
            assert ack.status == "stored", ack
            if stop.is_set():
                return
            self.latencies_s.append(time.perf_counter() - began)

    def _ask(self, blob: bytes, seq: int, epoch: int) -> Ack:
        header = UploadHeader(RUN, self.name, self.session.identity, epoch, seq, BATCH if blob else 0, not blob)
        while True:
            answer = self.session.get(keys.upload(RUN, self.name), blob, encode_header(header), timeout_s=60.0)
            ack = Ack("busy") if answer is None else decode_header(Ack, answer.payload)
            if ack.status != "busy":
                return ack
            time.sleep(0.05)


def upload_process(
    index: int, count: int, address: str, blobs: list[bytes], seconds: float, barrier: Any, out: Any
) -> None:
    clients = [Client(address, f"a{index}-{i}") for i in range(count)]
    stop = threading.Event()
    threads = [threading.Thread(target=client.upload, args=(blobs, stop)) for client in clients]
    barrier.wait()
    for thread in threads:
        thread.start()
    time.sleep(seconds)
    stop.set()
    out.put([latency for client in clients for latency in client.latencies_s])
    for thread in threads:
        thread.join()
    for client in clients:
        client.session.close()


def split(clients: int) -> list[int]:
    processes = min(CLIENT_PROCESSES, clients)
    return [clients // processes + (i < clients % processes) for i in range(processes)]


def ingest(clients: int, blobs: list[bytes], seconds: float, train: bool) -> None:
    context = multiprocessing.get_context("spawn")
    address, parts = endpoint(), split(clients)
    barrier, out = context.Barrier(len(parts) + 1), context.Queue()
    me = psutil.Process()
    with tempfile.TemporaryDirectory() as folder, open_session(WireSettings(address), listen=True) as session:
        part = learner(session, Path(folder), train)
        stop = threading.Event()
        measured: dict[str, float] = {}

        def measure() -> None:
            barrier.wait()
            time.sleep(0.25 * seconds)
            before = (
                time.perf_counter(),
                part.replay.ring.transitions_total,
                part.td3.updates,
                sum(me.cpu_times()[:2]),
            )
            time.sleep(0.5 * seconds)
            after = (time.perf_counter(), part.replay.ring.transitions_total, part.td3.updates, sum(me.cpu_times()[:2]))
            elapsed_s, *gains = (b - a for a, b in zip(before, after, strict=True))
            measured.update(zip(("transitions", "updates", "cpu"), (gain / elapsed_s for gain in gains), strict=True))
            measured["mib"] = me.memory_info().rss / 2**20
            results.extend(out.get(timeout=120) for _ in parts)
            stop.set()

        results: list[list[float]] = []
        processes = [
            context.Process(target=upload_process, args=(i, n, address, blobs, seconds, barrier, out))
            for i, n in enumerate(parts)
        ]
        for process in processes:
            process.start()
        watcher = threading.Thread(target=measure)
        watcher.start()
        while not stop.is_set():
            if not part.step():
                time.sleep(0.005)
        for process in processes:
            process.join(60)
        watcher.join()
        part.close()
    latencies_ms = 1e3 * np.concatenate([np.array(r) for r in results if r])
    p50, p99 = np.percentile(latencies_ms, (50, 99))
    print(
        f"{clients:4d} clients: {measured['transitions']:8,.0f} transitions/s  ack p50 {p50:7.2f} ms  "
        f"p99 {p99:7.1f} ms  max {latencies_ms.max():6.0f} ms  updates/s {measured['updates']:5.1f}  "
        f"learner CPU {100 * measured['cpu']:3.0f} %  memory {measured['mib']:5.0f} MiB",
        flush=True,
    )


def weights_process(index: int, count: int, address: str, versions: int, barrier: Any, out: Any) -> None:
    sessions = [open_session(WireSettings(address, timeout_s=60.0), listen=False) for _ in range(count)]
    subscribers = [WeightsSubscriber(session, RUN) for session in sessions]
    for subscriber in subscribers:
        assert subscriber.wait((0, 0), timeout_s=60.0) is not None
    for version in range(2, versions + 2):
        barrier.wait()
        for subscriber in subscribers:
            assert subscriber.wait((1, version - 1), timeout_s=60.0) is not None
        out.put((version, time.monotonic()))  # one clock for all processes of a machine
        if index == 0 and version == versions + 1:
            out.put((0, float(sum(subscriber.counts["fetched"] for subscriber in subscribers))))
    for part in (*subscribers, *sessions):
        part.close()


def weights(clients: int, versions: int = 5) -> None:
    context = multiprocessing.get_context("spawn")
    address, parts = endpoint(), split(clients)
    barrier, out = context.Barrier(len(parts) + 1), context.Queue()
    with tempfile.TemporaryDirectory() as folder, open_session(WireSettings(address), listen=True) as session:
        part = learner(session, Path(folder), train=False)
        blob = part._policy().to_bytes(half=True)
        part.close()
        publisher = WeightsPublisher(session, RUN)
        publisher.publish(1, 1, blob)
        processes = [
            context.Process(target=weights_process, args=(i, n, address, versions, barrier, out))
            for i, n in enumerate(parts)
        ]
        for process in processes:
            process.start()
        took_s = []
        for version in range(2, versions + 2):
            barrier.wait(timeout=300)
            time.sleep(0.5)
            began = time.monotonic()
            publisher.publish(1, version, blob)
            arrived = [out.get(timeout=120) for _ in parts]
            took_s.append(max(at for number, at in arrived if number == version) - began)
        for process in processes:
            process.join(60)
        publisher.close()
    print(
        f"{clients:4d} clients: {len(blob) / 1e6:.1f} MB until the last one has it: median "
        f"{statistics.median(took_s):.2f} s, worst {max(took_s):.2f} s",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", default=["ingest", "train", "weights"], help="ingest, train, weights")
    parser.add_argument("--clients", type=int, nargs="+", help="default: 1 8 64 500")
    parser.add_argument("--seconds", type=float, default=8.0)
    arguments = parser.parse_args()
    blobs = [] if arguments.part == ["weights"] else record(4)
    if blobs:
        print(f"batches of {BATCH} recorded transitions, {len(blobs[0])} bytes")
    for part in arguments.part:
        print({"ingest": "storing only", "train": "storing and training", "weights": "broadcasting"}[part])
        for clients in arguments.clients or (1, 8, 64, 500):
            if part == "weights":
                weights(clients)
            else:
                ingest(clients, blobs, arguments.seconds, train=part == "train")


if __name__ == "__main__":
    main()
