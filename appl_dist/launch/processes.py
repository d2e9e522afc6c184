"""Child processes of a run on this machine: started, watched, restarted, and never left behind."""

from __future__ import annotations

import ctypes
import logging
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from appl_dist.errors import PARENT_VARIABLE, PASSING, UserError

log = logging.getLogger(__name__)

LASTING_DEATHS = 3  # deaths in a row with the same last words that end a run
MAX_BACKOFF_S = 30.0
HEALTHY_S = 20.0  # a child that lived this long starts again at once
PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Ask the kernel to end this process when the one that launched it dies, even by SIGKILL. Linux only."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is None or sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != int(parent):  # it died before we asked
        os.kill(os.getpid(), signal.SIGTERM)


@dataclass
class Child:
    """One supervised process. `log_file` takes what it prints."""

    name: str
    arguments: list[str]
    log_file: Path
    stop_signal: int = signal.SIGTERM  # what asks it to end for good
    process: subprocess.Popen[bytes] | None = None
    restarts: int = 0
    started_at: float = 0.0
    retry_at: float = 0.0
    deaths: list[str] = field(default_factory=list)  # last words of those that died young, in a row
    backoff_s: float = field(default=1.0)

    def start(self) -> None:
        with self.log_file.open("ab") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "appl_dist", *self.arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
                start_new_session=True,  # Ctrl-C reaches the launcher, which ends the children in order
            )
        self.started_at = time.monotonic()

    def returncode(self) -> int | None:
        return None if self.process is None else self.process.poll()

    def last_words(self) -> str:
        """The last line the process printed."""
        lines = self.log_file.read_text(errors="replace").strip().splitlines() if self.log_file.exists() else []
        return lines[-1] if lines else "no output"

    def supervise(self) -> None:
        """Restart the process if it died, with a back-off that doubles while it keeps dying young.

        UserError: it died young LASTING_DEATHS times in the same way, so that another start would only repeat it.
        """
        now = time.monotonic()
        if self.retry_at:
            if now >= self.retry_at:
                self.retry_at = 0.0
                self.restarts += 1
                self.start()
            return
        code = self.returncode()
        if code is None or code == 0:
            return
        self._note_death(code, young=now - self.started_at <= HEALTHY_S)
        self.backoff_s = 1.0 if now - self.started_at > HEALTHY_S else min(2.0 * self.backoff_s, MAX_BACKOFF_S)
        self.retry_at = now + self.backoff_s
        log.warning("%s died with status %s; starts again in %.0f s", self.name, code, self.backoff_s)

    def _note_death(self, code: int, young: bool) -> None:
        """Tell a lasting fault from a passing one. What others did to the process (kill, cluster) says nothing."""
        if not young or code == PASSING or code in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT):
            self.deaths.clear()
            return
        words = f"status {code}: {self.last_words()}"
        if self.deaths and _without_numbers(words) != _without_numbers(self.deaths[-1]):
            self.deaths.clear()
        self.deaths.append(words)
        if len(self.deaths) >= LASTING_DEATHS:
            raise UserError(
                f"{self.name} ended {len(self.deaths)} times in the same way, with {words}; see {self.log_file}"
            )

    def signal(self, number: int) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(number)

    def wait(self, timeout_s: float) -> bool:
        """Whether the process has ended within the time."""
        if self.process is None:
            return True
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True


def _without_numbers(text: str) -> str:
    """`text` as far as two deaths of one cause have it in common: no times, process numbers or addresses."""
    return re.sub(r"\d+", "", text)


def stop_all(children: list[Child], timeout_s: float) -> None:
    """Ask all to end, then SIGKILL to those that still live after `timeout_s`."""
    for child in children:
        child.retry_at = 0.0
        child.signal(child.stop_signal)
    deadline = time.monotonic() + timeout_s
    for child in children:
        if not child.wait(max(0.0, deadline - time.monotonic())):
            log.warning("%s did not stop within %.0f s; killed", child.name, timeout_s)
            child.signal(signal.SIGKILL)
            child.wait(5.0)
