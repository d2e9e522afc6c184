"""Children that die: a lasting fault ends with its reason, a passing one is tried again."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from appl_dist.errors import PASSING, UserError
from appl_dist.launch import processes
from appl_dist.launch.processes import Child


class Script(Child):
    """A child that runs Python text instead of a role."""

    def start(self) -> None:
        self.process = processes.subprocess.Popen(
            [processes.sys.executable, "-c", self.arguments[0]],
            stdout=self.log_file.open("ab"),
            stderr=processes.subprocess.STDOUT,
        )
        self.started_at = time.monotonic()


def supervise_until(child: Child, restarts: int) -> None:
    """Let it die and start again without waiting for the back-off."""
    child.start()
    while child.restarts < restarts:
        assert child.process is not None
        child.process.wait()
        child.supervise()
        child.retry_at = min(child.retry_at, time.monotonic() - 1.0) if child.retry_at else 0.0
        child.supervise()
    assert child.process is not None
    child.process.wait()


def test_the_same_death_three_times_ends_the_run_with_its_reason(tmp_path: Path) -> None:
    child = Script("actor-0", ["import os; print('no room', os.getpid(), flush=True); os._exit(1)"], tmp_path / "log")
    with pytest.raises(UserError, match=r"actor-0 ended 3 times in the same way, with status 1: no room \d+; see "):
        supervise_until(child, 10)
    assert child.restarts == 2


def test_a_crash_without_words_is_lasting_too(tmp_path: Path) -> None:
    child = Script("actor-0", ["import os; os.kill(os.getpid(), 11)"], tmp_path / "log")
    with pytest.raises(UserError, match="status -11"):
        supervise_until(child, 10)


@pytest.mark.parametrize(
    "text",
    [f"import os; os._exit({PASSING})", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"],
)
def test_what_may_pass_is_tried_for_ever(tmp_path: Path, text: str) -> None:
    child = Script("actor-0", [text], tmp_path / "log")
    supervise_until(child, 7)
    assert child.restarts == 7


def test_deaths_of_different_kinds_are_not_one_fault(tmp_path: Path) -> None:
    text = "import pathlib, os; p = pathlib.Path('n'); n = len(p.read_text()) if p.exists() else 0;"
    text = text.replace("'n'", repr(str(tmp_path / "n")))
    text += "p.write_text('x' * (n + 1)); print('abcdefgh'[n], flush=True); os._exit(1)"
    child = Script("actor-0", [text], tmp_path / "log")
    supervise_until(child, 6)
    assert child.restarts == 6


def test_no_child_is_left(tmp_path: Path) -> None:
    child = Script("a", ["import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"], tmp_path / "log")
    child.start()
    processes.stop_all([child], 0.2)
    assert child.returncode() in (-signal.SIGKILL, -signal.SIGTERM)
