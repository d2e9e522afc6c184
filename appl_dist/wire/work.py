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
from typing import Any, Generic, TypeVar

from appl_dist.errors import UserError
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.bus import Bus, Message, Query
from appl_dist.wire.codec import MAX_HEADER_BYTES
from appl_dist.wire.wire_settings import MAX_CONNECTIONS
from appl_dist.wire.work_messages import Answer, Question, decode_message, encode, reason

MAX_RESULT_BYTES = 1 << 20
MAX_ANSWER_BYTES = 64 << 20
MAX_FAILURES = 3  # workers that fail at one job before the job is held to be the reason
ALONE_S = 10.0  # how long a server waits for another worker when all that it knows have failed
PATIENCE_S = 120.0  # a job that has been out for so long is given to an idle worker as well
ANSWER_S = 5.0
WAIT_S = 0.5
_LOGGED_SENDERS = 20

log = logging.getLogger(__name__)

Result = TypeVar("Result")


class WorkServer(Generic[Result]):
    """Hands out `jobs`, plain msgpack values, and yields (index, result) in order of arrival.

    files: what workers may ask for by name, such as policies. read: makes a result of (index, received map); raises
    ValueError if that cannot be one. `counts`: handed, again (handed out once more), results, repeated, failed,
    malformed.
    """

    def __init__(
        self,
        bus: Bus,
        run_id: str,
        jobs: Sequence[dict[str, Any]],
        files: dict[str, bytes],
        read: Callable[[int, dict[str, Any]], Result],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._jobs, self._files, self._read, self._clock = list(jobs), files, read, clock
        self._lock = threading.Lock()
        self._waiting = deque(range(len(self._jobs)))
        self._out: dict[int, tuple[str, float]] = {}  # job → who has it, since when
        self._done: set[int] = set()
        self._present: set[str] = set()
        self._failed: dict[str, str] = {}  # worker that gets no more jobs → reason
        self._failed_s = 0.0  # when the last of them failed
        self._failures: dict[int, set[str]] = {}  # job → names of workers that failed at it
        self._logged: set[str] = set()
        self._results: queue.SimpleQueue[tuple[int, Result] | str] = queue.SimpleQueue()
        self._handles = [
            bus.serve(keys.work(run_id, keys.ANY), self._serve),
            bus.watch(keys.alive(run_id, "actor", keys.ANY, keys.ANY), self._seen),
        ]

    def results(self) -> Iterator[tuple[int, Result]]:
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
            keys.check_name("worker", worker)
            if query.size > MAX_RESULT_BYTES:
                raise ValueError(f"{query.size} bytes; allowed up to {MAX_RESULT_BYTES}")
            answer = self._answer(worker, decode_message(Question, query.payload, MAX_RESULT_BYTES))
        except ValueError as error:
            self._note(worker, str(error))
            answer = Answer(error=reason(str(error)))
        query.reply(encode(answer))

    def _note(self, worker: str, why: str) -> None:
        """Count what cannot be accepted; log the first of each of the first senders."""
        with self._lock:
            self.counts["malformed"] += 1
            if worker in self._logged or len(self._logged) >= _LOGGED_SENDERS:
                return
            self._logged.add(worker)
        log.warning("refusing what %s sent: %s", worker, why)

    def _answer(self, worker: str, asked: Question) -> Answer:
        if asked.file is not None:
            if asked.file not in self._files:
                raise ValueError(f"no file {asked.file!r:.80}")
            return Answer(file=self._files[asked.file])
        asker = f"{worker}/{asked.incarnation}"
        with self._lock:
            if len({asker, *self._present, *self._failed}) > MAX_CONNECTIONS:
                raise ValueError(f"more than {MAX_CONNECTIONS} workers")
        if asked.failed is not None:
            self._exclude(asker, f"{worker}: {asked.failed}")
            return Answer(over=True)
        if asked.job is not None and asked.result is not None:
            self._take(asked.job, asked.result)
        return self._next(asker)

    def _exclude(self, worker: str, why: str) -> None:
        """No more jobs for a worker that failed; those it had go to others, or end the whole."""
        name = worker.partition("/")[0]
        with self._lock:
            self.counts["failed"] += 1
            self._present.add(worker)
            self._failed[worker] = why
            self._failed_s = self._clock()
            had = self._take_back(worker)
            for job in had:
                self._failures.setdefault(job, set()).add(name)
            given_up = any(len(self._failures[job]) >= MAX_FAILURES for job in had)
        log.warning("%s failed and gets no more jobs; others do its job: %s", name, why)
        if given_up:
            self._results.put(f"{MAX_FAILURES} workers failed at the same job; the last: {why}")

    def _take_back(self, worker: str) -> list[int]:
        had = [job for job, (who, _) in self._out.items() if who == worker]
        for job in had:
            del self._out[job]
            self._waiting.appendleft(job)
            self.counts["again"] += 1
        return had

    def _take(self, job: int, received: dict[str, Any]) -> None:
        if job >= len(self._jobs):
            raise ValueError(f"job: got {job}; allowed 0..{len(self._jobs) - 1}")
        result = self._read(job, received)
        with self._lock:
            self._out.pop(job, None)
            if job in self._done:
                self.counts["repeated"] += 1
                return
            self._done.add(job)
            self.counts["results"] += 1
        self._results.put((job, result))

    def _next(self, worker: str) -> Answer:
        with self._lock:
            if worker in self._failed:
                return Answer(over=True)
            self._present.add(worker)
            now_s = self._clock()
            for job, (who, _) in self._out.items():
                if who == worker:  # it asks, so it does not have it: our answer was lost
                    return Answer(job=job, what=self._jobs[job])
            while self._waiting:
                job = self._waiting.popleft()
                if job not in self._done:
                    break
            else:
                late = [j for j, (_, since_s) in self._out.items() if now_s - since_s > PATIENCE_S]
                if not late:
                    return Answer(over=len(self._done) == len(self._jobs))
                job = min(late, key=lambda j: self._out[j][1])
                self.counts["again"] += 1
            self.counts["handed"] += 1
            self._out[job] = (worker, now_s)
            return Answer(job=job, what=self._jobs[job])

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
        answer = self._ask(Question(self._bus.identity, file=name))
        if answer is None or answer.file is None:
            raise UserError(f"evaluation: {name} did not arrive")
        return answer.file

    def next(self, done: tuple[Work, dict[str, Any]] | None = None) -> Work | None:
        """Hand in a result and get the next job; None when there are no more, or `stop`.

        UserError: nobody has answered for `away_s`.
        """
        question = plain = Question(self._bus.identity)
        if done is not None:
            question = Question(self._bus.identity, job=done[0].job, result=done[1])
        while True:
            answer = self._ask(question)
            if answer is None or answer.over:
                return None
            if answer.job is not None and answer.what is not None:
                return Work(answer.job, answer.what)
            question = plain
            self._pause(WAIT_S)

    def fail(self, why: str) -> None:
        """Tell the server that this worker cannot do what is asked: it gets no more jobs."""
        self._ask(Question(self._bus.identity, failed=reason(why)))

    def _ask(self, question: Question) -> Answer | None:
        payload = encode(question)
        deadline = time.monotonic() + self._away_s
        while not self._stop():
            found = self._bus.get(self._key, payload, timeout_s=ANSWER_S)
            if found is not None:
                return self._read(found)
            if time.monotonic() > deadline:
                raise UserError(f"evaluation: nobody has answered for {self._away_s:.0f} s")
            self._pause(0.2)
        return None

    def _read(self, found: Message) -> Answer:
        if found.size > MAX_ANSWER_BYTES + MAX_HEADER_BYTES:
            raise UserError(f"evaluation: an answer of {found.size} bytes; allowed up to {MAX_ANSWER_BYTES}")
        try:
            answer = decode_message(Answer, found.payload, MAX_ANSWER_BYTES + MAX_HEADER_BYTES)
        except ValueError as error:
            raise UserError(f"evaluation: an answer that cannot be read: {error}") from None
        if answer.error is not None:
            raise UserError(f"evaluation: refused: {answer.error}")
        return answer

    def _pause(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self._stop():
            time.sleep(0.05)
