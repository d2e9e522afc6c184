"""Worker processes: jobs in, results out in order of completion, no process left behind.

Workers are spawned (never forked: simulator and wire threads do not survive a fork), ignore Ctrl-C,
which is the parent's to handle, and leave when their parent is gone, however it died. Each has a pipe
of its own, so a worker that dies (short of memory, a fault in native code) is noticed at once; another process takes
its place and its job. A job at which two workers died ends the whole.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from appl_dist.errors import UserError

log = logging.getLogger(__name__)

MAX_DEATHS = 2  # workers that die in one job before the job is held to be the reason


class Crew(Protocol):
    """Workers of another kind than processes of this machine: yields the result of every job, as `run_parallel` does.

    Its length is how many workers there were.
    """

    def __call__(
        self, jobs: Sequence[Any], make_runner: Callable[[], Callable[[Any], Any]], /
    ) -> Generator[Any, None, None]: ...
    def __len__(self) -> int: ...


# One thread a worker: matrices here are small and the cores are taken by other workers.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_parallel(
    jobs: Sequence[Any], make_runner: Callable[[], Callable[[Any], Any]], workers: int
) -> Generator[Any, None, None]:
    """Yield `runner(job)` for every job in order of completion, on `workers` processes (0: in this one).

    Close the generator (`contextlib.closing`) to be sure that workers end when the caller stops early.
    Raises UserError if a runner raised one, RuntimeError with the worker's traceback for another exception, and
    RuntimeError with the job for one at which MAX_DEATHS workers died.
    """
    if workers < 0:
        raise UserError(f"workers: got {workers}; allowed 0 (in this process) or more")
    if workers == 0 or not jobs:
        runner = make_runner() if jobs else None
        for job in jobs:
            assert runner is not None
            yield runner(job)
        return
    crew: dict[Connection, Any] = {}
    try:
        for number in range(min(workers, len(jobs))):
            _start(crew, make_runner, number)
        yield from _share_out(jobs, crew, make_runner)
    finally:
        for connection, process in crew.items():
            connection.close()
            process.terminate()
        for process in crew.values():
            process.join()


def _share_out(
    jobs: Sequence[Any], crew: dict[Connection, Any], make_runner: Callable[[], Callable[[Any], Any]]
) -> Iterator[Any]:
    waiting = deque(jobs)
    busy: dict[Connection, Any] = {}
    deaths: Counter[Any] = Counter()  # by job
    started = len(crew)
    for connection in crew:
        _send_next(connection, waiting, busy)
    while busy:
        for ready in wait(list(busy)):
            assert isinstance(ready, Connection)
            job = busy.pop(ready)
            try:
                kind, content = ready.recv()
            except (EOFError, ConnectionResetError):
                dead = crew.pop(ready)
                dead.join()
                ready.close()
                deaths[job] += 1
                if deaths[job] >= MAX_DEATHS:
                    raise RuntimeError(
                        f"{MAX_DEATHS} workers died in {job}; {dead.name} {_how(dead.exitcode)}"
                    ) from None
                log.warning(
                    "%s %s in %s; another process takes its place and its job", dead.name, _how(dead.exitcode), job
                )
                waiting.appendleft(job)
                _send_next(_start(crew, make_runner, started), waiting, busy)
                started += 1
                continue
            if kind == "user error":
                raise UserError(content)
            if kind == "fault":
                raise RuntimeError(f"{job} failed in a worker:\n{content}")
            _send_next(ready, waiting, busy)
            yield content


def _how(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f"died with exit code {exit_code}"
    name = signal.Signals(-exit_code).name if -exit_code in set(signal.Signals) else str(-exit_code)
    return f"was killed by {name}" + (" (often a lack of memory)" if name == "SIGKILL" else "")


def _send_next(connection: Connection, waiting: deque[Any], busy: dict[Connection, Any]) -> None:
    if waiting:
        job = busy[connection] = waiting.popleft()
        # If the worker has died, reading from it says so, with the exit code.
        with suppress(BrokenPipeError, ConnectionResetError):
            connection.send(job)


def _start(crew: dict[Connection, Any], make_runner: Callable[[], Any], number: int) -> Connection:
    """Start a worker, add it to `crew` and return the pipe to it."""
    context = multiprocessing.get_context("spawn")
    with _one_thread(), _interrupt_blocked():
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, make_runner), name=f"evaluate-{number}", daemon=True)
        process.start()
        theirs.close()
    crew[ours] = process
    return ours


@contextmanager
def _one_thread() -> Iterator[None]:
    """BLAS reads these when numpy is imported, which in a spawned child is before any code of ours."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    """A blocked signal stays blocked in a spawned child: Ctrl-C while it imports prints no traceback."""
    resource_tracker.ensure_running()  # starting it later would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(connection: Connection, make_runner: Callable[[], Callable[[Any], Any]]) -> None:
    """The worker's life: build one runner, then answer jobs until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    runner = None
    while True:
        try:
            job = connection.recv()
        except (EOFError, ConnectionResetError):
            return
        answer: tuple[str, Any]
        try:
            if runner is None:
                runner = make_runner()
            answer = ("result", runner(job))
        except UserError as error:
            answer = ("user error", str(error))
        except Exception:
            answer = ("fault", traceback.format_exc())
        try:
            connection.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            return


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
