"""What a terminal or a log file gets: text whose control characters, markup and letters can do no harm."""

from __future__ import annotations

import io
import logging
import os
import sys


def printable(text: str) -> str:
    """`text` on one line: whatever is not printable as an escape, as in "a\\nb"."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class OneLine(logging.Formatter):
    """A record's message may quote what a stranger sent: it stays on its line and cannot move the cursor."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = printable(record.message)
        return super().formatMessage(record)


def prepare_streams() -> None:
    """Make standard streams that can be written to, whatever the process inherited.

    A closed one is opened on nothing, before a file of ours takes its number; letters that the terminal's encoding
    lacks are written as escapes.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def discard_output() -> None:
    """Send what is still buffered for the standard streams to nowhere: the interpreter flushes them when it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def start_logging(role: str) -> None:
    """Log this process's messages to standard error, ours from INFO on."""
    handler = logging.StreamHandler()
    handler.setFormatter(OneLine(f"%(asctime)s {role} %(levelname)s %(message)s", datefmt="%H:%M:%S"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.getLogger("appl_dist").setLevel(logging.INFO)
