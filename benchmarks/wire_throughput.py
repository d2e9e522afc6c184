"""What the wire carries on this machine: acked uploads, policy broadcast, and a large fleet joining.

    python benchmarks/wire_throughput.py uploads     # rollouts/s and ack latency, 1 and 4 uploading processes
    python benchmarks/wire_throughput.py weights     # a 3.6 MB policy to 8 processes
    python benchmarks/wire_throughput.py fleet       # 500 actors join at once, each uploads an episode every 5 s
    python benchmarks/wire_throughput.py codec       # microseconds to encode and decode an episode

Everything is between real processes over loopback; the receiving side decodes and checks each rollout.
"""

from __future__ import annotations

import argparse
import multiprocessing
import socket
import statistics
import time
from multiprocessing.queues import Queue
from typing import Any

import numpy as np
from paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE

from appl_dist.spec import Rollout
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import (
    Ack,
    UploadHeader,
    decode_header,
    decode_rollout,
    encode_header,
    encode_rollout,
)
from appl_dist.wire.liveness import Presence, Roster
from appl_dist.wire.run_status import Progress
from appl_dist.wire.session import Session, open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.weights import WeightsPublisher, WeightsSubscriber
from appl_dist.wire.wire_settings import WireSettings

RUN = "bench"
TRANSITIONS = 50
POLICY_BYTES = 3_600_000


def episode(seed: int) -> Rollout:
    rng = np.random.default_rng(seed)
    return Rollout(
        rng.uniform(-1, 1, (TRANSITIONS + 1, OBSERVATION_SIZE)).astype(np.float32),
        rng.uniform(-1, 1, (TRANSITIONS, 8)).astype(np.float32),
        rng.normal(size=TRANSITIONS).astype(np.float32),
        True,
        {"world": 7, "success": True},
        LIDAR_BEAMS,
    )


class Discard:
    """Counts each actor's rollouts and forgets them."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def store(self, header: UploadHeader, rollout: Rollout) -> Ack:
        self.counts[header.actor] = header.seq + 1
        return Ack("stored", header.seq + 1)

    def expected_seq(self, actor_id: str) -> int:
        return self.counts.get(actor_id, 0)


def ask(session: Session, actor: str, seq: int, blob: bytes) -> Ack | None:
    count = TRANSITIONS if blob else 0
    header = UploadHeader(RUN, actor, session.identity, 0, seq, count, hello=not blob)
    answer = session.get(keys.upload(RUN, actor), blob, encode_header(header), timeout_s=10.0)
    return None if answer is None else decode_header(Ack, answer.payload)


def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def start(target: Any, count: int, *arguments: Any) -> tuple[list[Any], Queue[Any]]:
    context = multiprocessing.get_context("spawn")
    results: Queue[Any] = context.Queue()
    processes = [context.Process(target=target, args=(i, results, *arguments)) for i in range(count)]
    for process in processes:
        process.start()
    return processes, results


def upload_process(index: int, results: Queue[Any], address: str, duration_s: float) -> None:
    blob = encode_rollout(episode(index))
    with open_session(WireSettings(address), listen=False) as session:
        claim = session.announce(keys.claim(RUN, f"a{index}", session.identity))
        ask(session, f"a{index}", 0, b"")
        latencies_s, end = [], time.perf_counter() + duration_s
        while (began := time.perf_counter()) < end:
            ack = ask(session, f"a{index}", len(latencies_s), blob)
            assert ack is not None, "no answer"
            assert ack.status == "stored", ack
            latencies_s.append(time.perf_counter() - began)
        claim.close()
    results.put(latencies_s)


def uploads() -> None:
    size = len(encode_rollout(episode(0)))
    for count in (1, 4):
        address, duration_s = endpoint(), 4.0
        with open_session(WireSettings(address), listen=True) as session:
            server = UploadServer(session, RUN, Discard())
            processes, results = start(upload_process, count, address, duration_s)
            latencies_ms = 1e3 * np.concatenate([results.get(timeout=60) for _ in processes])
            server.close()
        p50, p99 = np.percentile(latencies_ms, (50, 99))
        rate = len(latencies_ms) / duration_s
        print(
            f"{count} uploading: {rate:.0f} rollouts/s of {size} bytes ({rate * size / 1e6:.0f} MB/s, "
            f"{rate * TRANSITIONS:.0f} transitions/s); ack p50 {p50:.2f} ms, p99 {p99:.2f} ms, "
            f"max {latencies_ms.max():.1f} ms"
        )


def weights_process(index: int, results: Queue[Any], address: str, versions: int) -> None:
    with open_session(WireSettings(address), listen=False) as session:
        subscriber = WeightsSubscriber(session, RUN)
        began = time.monotonic()
        newest = subscriber.wait(timeout_s=30.0)
        assert newest is not None
        results.put(("joined", index, time.monotonic() - began))
        while newest is not None and newest[1] < versions:
            newest = subscriber.wait(newest[:2], timeout_s=30.0)
            assert newest is not None
            results.put((newest[1], index, time.monotonic()))  # one clock for all processes of a machine
        subscriber.close()


def weights() -> None:
    address, count, versions = endpoint(), 8, 30
    with open_session(WireSettings(address), listen=True) as session:
        publisher = WeightsPublisher(session, RUN)
        publisher.publish(0, 0, bytes(POLICY_BYTES))
        processes, results = start(weights_process, count, address, versions)
        joined_ms = [1e3 * results.get(timeout=60)[2] for _ in processes]
        slowest_ms = []
        for version in range(1, versions + 1):
            blob = bytes([version]) * POLICY_BYTES
            began = time.monotonic()
            publisher.publish(0, version, blob)
            arrived = [results.get(timeout=60) for _ in processes]
            assert {number for number, _, _ in arrived} == {version}
            slowest_ms.append(1e3 * (max(at for _, _, at in arrived) - began))
        publisher.close()
        for process in processes:
            process.join()
    print(
        f"{POLICY_BYTES / 1e6:.1f} MB to {count} processes, until the last has it: "
        f"p50 {statistics.median(slowest_ms):.1f} ms, max {max(slowest_ms):.1f} ms; "
        f"joining late: p50 {statistics.median(joined_ms):.1f} ms, max {max(joined_ms):.1f} ms"
    )


def fleet_process(index: int, results: Queue[Any], address: str, count: int, duration_s: float) -> None:
    blob = encode_rollout(episode(index))
    settings = WireSettings(address, timeout_s=60.0)
    began = time.perf_counter()
    actors = []
    for i in range(count):
        name, session = f"a{index}-{i}", open_session(settings, listen=False)
        claim = session.announce(keys.claim(RUN, name, session.identity))
        actors.append((name, session, claim, Presence(session, RUN, "actor", name)))
    welcomed = sum(ask(session, name, 0, b"") is not None for name, session, *_ in actors)
    joined_s = time.perf_counter() - began
    latencies_s, failed, began = [], 0, time.perf_counter()
    for turn in range(round(duration_s * count / 5.0)):
        time.sleep(max(0.0, began + turn * 5.0 / count - time.perf_counter()))
        name, session, _, presence = actors[turn % count]
        presence.beat(Progress(transitions=turn))
        asked = time.perf_counter()
        ack = ask(session, name, turn // count, blob)
        latencies_s.append(time.perf_counter() - asked)
        failed += ack is None or ack.status != "stored"
    for _, session, *_ in actors:
        session.close()
    results.put((welcomed, joined_s, latencies_s, failed))


def fleet() -> None:
    address, processes_count, each, duration_s = endpoint(), 5, 100, 15.0
    with open_session(WireSettings(address), listen=True) as session:
        roster = Roster(session, RUN)
        server = UploadServer(session, RUN, Discard())
        processes, results = start(fleet_process, processes_count, address, each, duration_s)
        most = 0
        while any(process.is_alive() for process in processes) and results.empty():
            most = max(most, sum(member.alive for member in roster.members()))
            time.sleep(0.1)
        rows = [results.get(timeout=120) for _ in processes]
        roster.close()
        server.close()
    latencies_ms = 1e3 * np.concatenate([row[2] for row in rows])
    p50, p99 = np.percentile(latencies_ms, (50, 99))
    print(
        f"{processes_count * each} actors: {sum(row[0] for row in rows)} welcomed within "
        f"{max(row[1] for row in rows):.1f} s, {most} on the roster; {len(latencies_ms)} uploads, "
        f"{sum(row[3] for row in rows)} not stored at once; ack p50 {p50:.2f} ms, p99 {p99:.2f} ms"
    )


def codec() -> None:
    rollout = episode(0)
    blob = encode_rollout(rollout)
    for name, run in (
        ("encode", lambda: encode_rollout(rollout)),
        ("decode", lambda: decode_rollout(blob)),
    ):
        times_us = []
        for _ in range(500):
            began = time.perf_counter()
            run()
            times_us.append(1e6 * (time.perf_counter() - began))
        print(f"{name}: {statistics.median(times_us):.0f} us for {TRANSITIONS} transitions, {len(blob)} bytes")


def main() -> None:
    parts = {"codec": codec, "uploads": uploads, "weights": weights, "fleet": fleet}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", metavar="PART", help="any of " + ", ".join(parts) + " (default: all)")
    for part in parser.parse_args().part or list(parts):
        parts[part]()


if __name__ == "__main__":
    main()
