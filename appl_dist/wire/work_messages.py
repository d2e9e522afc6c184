"""What evaluator and worker say to each other, as typed, bounded values; see `work`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any, TypeVar

from appl_dist.spec import WIRE_VERSION
from appl_dist.terminal import printable
from appl_dist.wire.codec import pack, unpack_map
from appl_dist.wire.key_expressions import check_name
from appl_dist.wire.typed import Length, Range, decode

MAX_JOBS = 10**7
MAX_REASON = 2000  # characters


@dataclass(frozen=True)
class Question:
    """A worker asks for its next job; or, of these one: for a file by name, hands in a result, or says why it failed.

    incarnation: names the asking process. result: of number `job`, for the evaluator's own check.
    """

    incarnation: str
    file: str | None = None
    failed: Annotated[str, Length(MAX_REASON)] | None = None
    job: Annotated[int, Range(0, MAX_JOBS)] | None = None
    result: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        check_name("incarnation", self.incarnation)
        if (self.job is None) != (self.result is None):
            raise ValueError("job, result: expected both or neither")
        if sum(value is not None for value in (self.file, self.failed, self.job)) > 1:
            raise ValueError("file, failed, job: expected one of them at most")


@dataclass(frozen=True)
class Answer:
    """The evaluator's: a job and its number, a file's content, that all is over, a refusal's reason, or "ask again"."""

    file: bytes | None = None
    job: Annotated[int, Range(0, MAX_JOBS)] | None = None
    what: dict[str, Any] | None = None
    over: bool = False
    error: Annotated[str, Length(MAX_REASON)] | None = None

    def __post_init__(self) -> None:
        if (self.job is None) != (self.what is None):
            raise ValueError("job, what: expected both or neither")


Said = TypeVar("Said", Question, Answer)


def encode(message: Question | Answer) -> bytes:
    return pack({"wire": WIRE_VERSION, **asdict(message)})


def decode_message(kind: type[Said], data: bytes, limit: int) -> Said:
    """The message in `data`, at most `limit` bytes long; ValueError names what is wrong with it."""
    values = unpack_map(data, limit)
    if values.pop("wire", None) != WIRE_VERSION:
        raise ValueError(f"wire version: expected {WIRE_VERSION}; run the same appl-dist version everywhere")
    return decode(kind, values)


def reason(text: str) -> str:
    """`text` as one printable line; of a long one the end, where a traceback names its error."""
    return printable(text.strip())[-MAX_REASON:]
