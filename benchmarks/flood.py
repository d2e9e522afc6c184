"""Ack latency of an honest actor while one connection floods the learner, and what happened to the flood.

    python benchmarks/flood.py                  # every kind, 6 s each
    python benchmarks/flood.py uploads names    # some

The honest actor uploads an episode of 50 transitions every 20 ms, or as fast as it is answered. The flooder sends as
much as it can: junk uploads under one name, under 100,000 names, of 15 MB, progress reports, questions, or tokens that
come and go. Learner, actor and flooder are processes of this machine.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import threading
import time
from collections import Counter
from typing import Any

import numpy as np
import psutil
import zenoh
from wire_throughput import RUN, Discard, ask, endpoint, episode

from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import encode_rollout
from appl_dist.wire.control import ControlServer, fetch_status
from appl_dist.wire.liveness import Roster
from appl_dist.wire.session import open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.wire_settings import WireSettings

KINDS = ("nothing", "uploads", "names", "large", "progress", "questions", "tokens")
IN_FLIGHT = 256
LARGE_BYTES = 15_000_000


def learner(address: str, ready: Any) -> None:
    with open_session(WireSettings(address), listen=True) as session:
        server, roster = UploadServer(session, RUN, Discard()), Roster(session, RUN)
        control = ControlServer(
            session, RUN, "{}", status=lambda: {**server.counts, "progress": roster.counts["malformed"]}
        )
        ready.set()
        threading.Event().wait()
        control.close()


def flood(address: str, kind: str) -> None:
    session = open_session(WireSettings(address), listen=False)._session
    free = threading.Semaphore(4 if kind == "large" else IN_FLIGHT)
    payload = {"large": bytes(LARGE_BYTES), "questions": b""}.get(kind, bytes(200))
    for n in itertools.count():
        if kind == "progress":
            session.put(keys.progress(RUN, "actor", "bad"), b"junk", congestion_control=zenoh.CongestionControl.BLOCK)
        elif kind == "tokens":
            session.liveliness().declare_token(keys.claim(RUN, "bad", f"i{n}")).undeclare()
        else:
            free.acquire()
            name = f"bad{n % 100_000}" if kind == "names" else "bad"
            key = keys.status(RUN) if kind == "questions" else keys.upload(RUN, name)
            done = zenoh.handlers.Callback(lambda _: None, free.release)
            session.get(key, done, payload=payload, timeout=5.0)


def measure(kind: str, seconds: float) -> None:
    context = multiprocessing.get_context("spawn")
    address, ready = endpoint(), context.Event()
    processes = [context.Process(target=learner, args=(address, ready))]
    processes[0].start()
    assert ready.wait(30)
    blob, latencies_s, answers = encode_rollout(episode(1)), [], Counter[str]()
    session = open_session(WireSettings(address), listen=False)
    claim = session.announce(keys.claim(RUN, "good", session.identity))
    try:
        answer = ask(session, "good", 0, b"")
        assert answer is not None and answer.status == "welcome", answer
        if kind != "nothing":
            processes.append(context.Process(target=flood, args=(address, kind)))
            processes[1].start()
            time.sleep(2.0)
        before, cpu, began = fetch_status(session, RUN, 20.0), psutil.Process(processes[0].pid), time.monotonic()
        used_s = sum(cpu.cpu_times()[:2])
        while time.monotonic() < began + seconds:
            asked = time.perf_counter()
            answer = ask(session, "good", answers["stored"], blob)
            latencies_s.append(time.perf_counter() - asked)
            answers["none" if answer is None else answer.status] += 1
            time.sleep(0.02)
        took_s, used_s = time.monotonic() - began, sum(cpu.cpu_times()[:2]) - used_s
        after = fetch_status(session, RUN, 20.0)
    finally:
        for process in reversed(processes):
            process.kill()
            process.join()
        claim.close()
        session.close()
    p50, p99 = 1e3 * np.percentile(latencies_s, (50, 99))
    rates = {k: round((after[k] - before.get(k, 0)) / took_s) for k in after if isinstance(after[k], int) and after[k]}
    print(
        f"{kind:>9}: {dict(answers)}; ack p50 {p50:.1f} ms, p99 {p99:.1f} ms; learner "
        f"{100 * used_s / took_s:.0f} % CPU, a second: {rates}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", default=KINDS, help=", ".join(KINDS))
    parser.add_argument("--seconds", type=float, default=6.0)
    arguments = parser.parse_args()
    for kind in arguments.kind:
        measure(kind, arguments.seconds)


if __name__ == "__main__":
    main()
