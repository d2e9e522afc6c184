"""Jobs handed out to whoever asks, results taken in once: evaluations on many machines.

A worker's question carries the result of its last job; the answer is the next one. A job whose worker has gone, or that
that has been out for long while others idle, is handed out again; the first result counts, later ones are only counted.
A worker that says it failed gets no more jobs and is named; another does its job. The whole ends when `MAX_FAILURES`
workers failed at the same job, or when none is left that has not failed.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from appl_dist.errors import UserError
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Message, Query
from appl_dist.wire.codec import MAX_HEADER_BYTES, pack, unpack_map

MAX_RESULT_BYTES = 1 << 20
MAX_ANSWER_BYTES = 64 << 20
MAX_FAILURES = 3  # workers that fail at one job before the job is held to be the reason
ALONE_S = 10.0  # how long a server waits for another worker when all that it knows have failed
PATIENCE_S = 120.0  # a job that has been out for so long is given to an idle worker as well
ANSWER_S = 5.0
WAIT_S = 0.5

log = logging.getLogger(__name__)


class WorkServer:
    """Hands out `jobs` and yields (index, result) as they come in. Jobs and results are plain msgpack values.

    files: what workers may ask for by name, such as policies. check: raises ValueError for a result that cannot be
    (index, result). `counts`: handed, again (handed out once more), results, repeated, failed, malformed.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        jobs: Sequence[dict[str, Any]],
        files: dict[str, bytes],
        check: Callable[[int, dict[str, Any]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._jobs, self._files, self._check, self._clock = list(jobs), files, check, clock
        self._lock = threading.Lock()
        self._waiting = deque(range(len(self._jobs)))
        self._out: dict[int, tuple[str, float]] = {}  # job → who has it, since when
        self._done: set[int] = set()
        self._present: set[str] = set()
        self._failed: dict[str, str] = {}  # worker that gets no more jobs → reason
        self._failed_s = 0.0  # when the last of them failed
        self._failures: dict[int, set[str]] = {}  # job → names of workers that failed at it
        self._results: queue.SimpleQueue[tuple[int, dict[str, Any]] | str] = queue.SimpleQueue()
        self._handles = [
            bus.serve(keys.work(run_id, keys.ANY), self._serve),
            bus.watch(keys.alive(run_id, "actor", keys.ANY, keys.ANY), self._seen),
        ]

    def results(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Every job's result, once, in order of arrival. UserError: no worker can do a job, with the reason."""
        for _ in self._jobs:
            while True:
                try:
                    found = self._results.get(timeout=WAIT_S)  # a wait that Ctrl-C can end
                    break
                except queue.Empty:
                    self._check_alone()
            if isinstance(found, str):
                raise UserError(found)
            yield found

    def close(self) -> None:
        for handle in reversed(self._handles):
            handle.close()

    def _check_alone(self) -> None:
        """UserError if every worker has failed and no other has come for a while."""
        with self._lock:
            hopeful = self._present - self._failed.keys()
            if self._failed and not hopeful and self._clock() - self._failed_s > ALONE_S:
                raise UserError(f"no worker is left: {'; '.join(self._failed.values())!s:.4000}")

    def _serve(self, query: Query) -> None:
        worker = query.key.rpartition("/")[2]
        try:
            if query.size > MAX_RESULT_BYTES:
                raise ValueError(f"{query.size} bytes; allowed up to {MAX_RESULT_BYTES}")
            asked = unpack_map(query.payload, MAX_RESULT_BYTES)
            if asked.get("wire") != WIRE_VERSION:
                raise ValueError(f"wire version {asked.get('wire')!r:.40}; expected {WIRE_VERSION}")
            answer = self._answer(worker, asked)
        except ValueError as error:
            with self._lock:
                self.counts["malformed"] += 1
            log.warning("ignoring what %s sent: %s", worker, error)
            answer = {"error": str(error)[:500]}
        query.reply(pack({"wire": WIRE_VERSION, **answer}))

    def _answer(self, worker: str, asked: dict[str, Any]) -> dict[str, Any]:
        if "file" in asked:
            name = asked["file"]
            if name not in self._files:
                raise ValueError(f"no file {name!r:.80}")
            return {"file": self._files[name]}
        asker = f"{worker}/{asked.get('incarnation')!s:.80}"
        if "failed" in asked:
            self._exclude(asker, f"{worker}: {asked['failed']!s:.2000}")
            return {"over": True}
        if "result" in asked:
            self._take(asked.get("job"), asked["result"])
        return self._next(asker)

    def _exclude(self, worker: str, reason: str) -> None:
        """No more jobs for a worker that failed; those it had go to others, or end the whole."""
        name = worker.partition("/")[0]
        with self._lock:
            self.counts["failed"] += 1
            self._present.add(worker)
            self._failed[worker] = reason
            self._failed_s = self._clock()
            had = self._take_back(worker)
            for job in had:
                self._failures.setdefault(job, set()).add(name)
            given_up = any(len(self._failures[job]) >= MAX_FAILURES for job in had)
        log.warning("%s failed and gets no more jobs; others do its job: %s", name, reason)
        if given_up:
            self._results.put(f"{MAX_FAILURES} workers failed at the same job; the last: {reason}")

    def _take_back(self, worker: str) -> list[int]:
        had = [job for job, (who, _) in self._out.items() if who == worker]
        for job in had:
            del self._out[job]
            self._waiting.appendleft(job)
            self.counts["again"] += 1
        return had

    def _take(self, job: object, result: object) -> None:
        if not isinstance(job, int) or not 0 <= job < len(self._jobs) or not isinstance(result, dict):
            raise ValueError(f"a result of job {job!r:.40}; expected 0..{len(self._jobs) - 1}")
        self._check(job, result)
        with self._lock:
            self._out.pop(job, None)
            if job in self._done:
                self.counts["repeated"] += 1
                return
            self._done.add(job)
            self.counts["results"] += 1
        self._results.put((job, result))

    def _next(self, worker: str) -> dict[str, Any]:
        with self._lock:
            if worker in self._failed:
                return {"over": True}
            self._present.add(worker)
            now_s = self._clock()
            for job, (who, _) in self._out.items():
                if who == worker:  # it asks, so it does not have it: our answer was lost
                    return {"job": job, "what": self._jobs[job]}
            while self._waiting:
                job = self._waiting.popleft()
                if job not in self._done:
                    break
            else:
                late = [j for j, (_, since_s) in self._out.items() if now_s - since_s > PATIENCE_S]
                if not late:
                    return {"over": True} if len(self._done) == len(self._jobs) else {"wait_s": WAIT_S}
                job = min(late, key=lambda j: self._out[j][1])
                self.counts["again"] += 1
            self.counts["handed"] += 1
            self._out[job] = (worker, now_s)
            return {"job": job, "what": self._jobs[job]}

    def _seen(self, key: str, present: bool) -> None:
        *_, name, incarnation = key.split("/")
        worker = f"{name}/{incarnation}"
        with self._lock:
            if present:
                self._present.add(worker)
                return
            self._present.discard(worker)
            lost = self._take_back(worker)
        if lost:
            log.warning("%s has gone; its job is handed out again", name)


@dataclass(frozen=True)
class Work:
    """A job and its number."""

    job: int
    what: dict[str, Any]


class WorkClient:
    """A worker's side. `stop` ends every wait."""

    def __init__(self, bus: Bus, run_id: str, worker: str, stop: Callable[[], bool], away_s: float = 120.0) -> None:
        self._bus, self._stop, self._away_s = bus, stop, away_s
        self._key = keys.work(run_id, worker)

    def file(self, name: str) -> bytes:
        """The content of a file of the server. UserError: none of that name, or no answer."""
        content = (self._ask({"file": name}) or {}).get("file")
        if not isinstance(content, bytes):
            raise UserError(f"evaluation: {name} did not arrive")
        return content

    def next(self, done: tuple[Work, dict[str, Any]] | None = None) -> Work | None:
        """Hand in a result and get the next job; None when there are no more, or `stop`.

        UserError: nobody has answered for `away_s`.
        """
        question: dict[str, Any] = {} if done is None else {"job": done[0].job, "result": done[1]}
        while True:
            answer = self._ask(question)
            if answer is None or answer.get("over"):
                return None
            if isinstance(answer.get("job"), int) and isinstance(answer.get("what"), dict):
                return Work(answer["job"], answer["what"])
            question = {}
            self._pause(WAIT_S)

    def fail(self, why: str) -> None:
        """Tell the server that this worker cannot do what is asked: it gets no more jobs."""
        self._ask({"failed": why})

    def _ask(self, question: dict[str, Any]) -> dict[str, Any] | None:
        payload = pack({"wire": WIRE_VERSION, "incarnation": self._bus.identity, **question})
        deadline = time.monotonic() + self._away_s
        while not self._stop():
            found = self._bus.get(self._key, payload, timeout_s=ANSWER_S)
            if found is not None:
                return self._read(found)
            if time.monotonic() > deadline:
                raise UserError(f"evaluation: nobody has answered for {self._away_s:.0f} s")
            self._pause(0.2)
        return None

    def _read(self, found: Message) -> dict[str, Any]:
        if found.size > MAX_ANSWER_BYTES + MAX_HEADER_BYTES:
            raise UserError(f"evaluation: an answer of {found.size} bytes; allowed up to {MAX_ANSWER_BYTES}")
        try:
            answer = unpack_map(found.payload, MAX_ANSWER_BYTES + MAX_HEADER_BYTES)
        except ValueError as error:
            raise UserError(f"evaluation: an answer that cannot be read: {error}") from None
        if "error" in answer:
            raise UserError(f"evaluation: refused: {answer['error']!s:.500}")
        return answer

    def _pause(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self._stop():
            time.sleep(0.05)
