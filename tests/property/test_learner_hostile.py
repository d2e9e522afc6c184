"""A whole learner, its status and its view, while well-formed messages of wrong content arrive."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from appl_dist.launch import view
from appl_dist.learner.learner import Learner
from appl_dist.spec import WIRE_VERSION
from appl_dist.wire import key_expressions as keys
from appl_dist.wire.codec import Ack, UploadHeader, decode_header, encode_header, encode_rollout, pack
from appl_dist.wire.control import fetch_run_status
from appl_dist.wire.memory import MemoryHub, MemorySession
from appl_dist.wire.run_status import EpisodeInfo, Progress
from tests.unit.learner.test_learner import SETTINGS, run_info
from tests.unit.learner.test_learner import rollout as good_rollout

TEXTS = st.sampled_from(["x", "[/x]", "[bold red]", "a\nb", "\x1b[2J", "", "é" * 300, "{0}", "%s", "a/b", "**"])
NUMBERS = st.one_of(
    st.integers(-(2**63), 2**63), st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([2**53, -1, 1e308])
)
PLAIN = st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS, st.binary(max_size=4))
VALUES = st.recursive(PLAIN, lambda inside: st.lists(inside, max_size=3) | st.dictionaries(TEXTS, inside, max_size=3))


def changed(fields: tuple[str, ...]) -> st.SearchStrategy[dict[str, Any]]:
    """Some of `fields`, and perhaps one that is unknown, with values of any kind."""
    return st.dictionaries(st.sampled_from([*fields, "more"]), VALUES, min_size=1, max_size=4)


PROGRESS = tuple(Progress.__dataclass_fields__)
INFO = tuple(EpisodeInfo.__dataclass_fields__)


class Harness:
    """A learner that keeps training, and a hostile session on the same bus."""

    def __init__(self, folder: Path) -> None:
        self.hub = MemoryHub()
        self.learner = Learner(self.hub.connect(), run_info(folder), SETTINGS)
        self.stranger: MemorySession = self.hub.connect()
        self.sent = 0

    def upload(self, actor: str, info: dict[str, Any], hello: bool = False) -> Ack | None:
        """Upload a rollout with this info, after the hello that every new actor says."""
        expected = self.learner.ingest.expected_seq(actor) if keys.is_name(actor) else 0
        blob = encode_rollout(replace(good_rollout(self.sent, 0, True), info=info))
        header = UploadHeader("run", "a" if not keys.is_name(actor) else actor, "i", self.learner.epoch, expected, 10)
        if hello:
            header, blob = replace(header, count=0, hello=True), b""
        answer = self.stranger.get(keys.upload("run", actor), blob, encode_header(header), timeout_s=5.0)
        return None if answer is None else decode_header(Ack, answer.payload)

    def still_works(self) -> None:
        """The learner steps, writes its telemetry, answers, and its answer can be drawn."""
        assert self.learner.step()
        self.learner.telemetry.write(self.learner.version)
        self.learner.telemetry.write_worlds()
        status = fetch_run_status(self.stranger, "run")
        out = io.StringIO()
        Console(file=out, width=120, force_terminal=False).print(view.render(status, ["[/note]"]))
        assert "\x1b" not in out.getvalue() and "policy version" in out.getvalue()
        assert "\n" not in view.line(status)


@pytest.fixture(scope="module")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Harness]:
    folder = tmp_path_factory.mktemp("learner")
    found = Harness(folder)
    found.stranger.announce(keys.alive("run", "actor", "a", "i"))
    assert found.upload("a", good_rollout(0, 0, True).info, hello=True) is not None
    for seed in range(3):
        found.learner.ingest.store(
            UploadHeader("run", "good", "g", found.learner.epoch, seed, 10), good_rollout(seed, 0, True)
        )
    yield found
    found.learner.end()
    found.learner.close()
    for line in (folder / "metrics.jsonl").read_text().splitlines():
        json.loads(line)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(report=changed(PROGRESS), info=changed(INFO), noise=VALUES, name=TEXTS)
def test_wrong_content_changes_nothing_that_anyone_sees(
    harness: Harness, report: dict[str, Any], info: dict[str, Any], noise: Any, name: str
) -> None:
    stranger = harness.stranger
    try:
        hostile = pack({"wire": WIRE_VERSION, "incarnation": "i", "progress": {**asdict(Progress()), **report}})
        anything = pack({"wire": WIRE_VERSION, "incarnation": "i", "progress": noise})
    except ValueError:  # an integer that msgpack cannot carry never arrives
        hostile = anything = b""
    for data in (hostile, anything):
        stranger.put(keys.progress("run", "actor", "a"), data)
    stranger.put(f"appl/run/progress/actor/{name}", hostile)
    stranger.announce(f"appl/run/alive/actor/{name}/i").close()
    for key in (keys.status("run"), keys.state("run"), keys.weights("run"), keys.RUN):
        stranger.get(key, anything, hostile, timeout_s=1.0)
    harness.sent += 1
    good = good_rollout(harness.sent, 0, True).info
    for actor in ("a", name):
        try:
            harness.upload(actor, {**good, **info})
        except ValueError:
            continue  # our own side would not send it
    harness.still_works()
