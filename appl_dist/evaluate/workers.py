"""Worker processes: jobs in, results out in order of completion, no process left behind.

Workers are spawned (never forked: simulator and wire threads do not survive a fork), ignore Ctrl-C,
which is the parent's to handle, and leave when their parent is gone, however it died. Each has a pipe
of its own, so a worker that dies is noticed at once instead of hanging the evaluation.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from appl_dist.errors import UserError

log = logging.getLogger(__name__)


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
    Raises UserError if a runner raised one, otherwise RuntimeError with the worker's traceback.
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
        _start(crew, make_runner, min(workers, len(jobs)))
        yield from _share_out(jobs, crew)
    finally:
        for connection, process in crew.items():
            connection.close()
            process.terminate()
        for process in crew.values():
            process.join()


def _share_out(jobs: Sequence[Any], crew: dict[Connection, Any]) -> Iterator[Any]:
    waiting = iter(jobs)
    busy: dict[Connection, Any] = {}
    for connection in crew:
        _send_next(connection, waiting, busy)
    while busy:
        for ready in wait(list(busy)):
            assert isinstance(ready, Connection)
            job = busy.pop(ready)
            try:
                kind, content = ready.recv()
            except (EOFError, ConnectionResetError):
                crew[ready].join()
                raise RuntimeError(f"a worker died with exit code {crew[ready].exitcode} in {job}") from None
            if kind == "user error":
                raise UserError(content)
            if kind == "fault":
                raise RuntimeError(f"{job} failed in a worker:\n{content}")
            _send_next(ready, waiting, busy)
            yield content


def _send_next(connection: Connection, waiting: Iterator[Any], busy: dict[Connection, Any]) -> None:
    for job in waiting:
        busy[connection] = job
        # If the worker has died, reading from it says so, with the exit code.
        with suppress(BrokenPipeError, ConnectionResetError):
            connection.send(job)
        return


def _start(crew: dict[Connection, Any], make_runner: Callable[[], Any], workers: int) -> None:
    context = multiprocessing.get_context("spawn")
    with _one_thread(), _interrupt_blocked():
        for number in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, make_runner), name=f"evaluate-{number}", daemon=True)
            process.start()
            theirs.close()
            crew[ours] = process


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
