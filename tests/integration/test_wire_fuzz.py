"""Whatever is thrown at the learner's door while a good actor works: it goes on, and the good data is whole.

APPL_FUZZ_MESSAGES sets how many messages (docs/reliability.md quotes 100,000); default 10,000.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from appl_dist.launch.ledger import audit
from appl_dist.learner.ingest import Ingest
from appl_dist.learner.replay import Replay
from appl_dist.wire.control import ControlServer
from appl_dist.wire.liveness import Roster
from appl_dist.wire.session import open_session
from appl_dist.wire.upload import UploadServer
from appl_dist.wire.wire_settings import WireSettings
from tests.paper_sizes import SIZES
from tests.unit.wire.support import free_endpoint, wait_until

MESSAGES = int(os.environ.get("APPL_FUZZ_MESSAGES", "10000"))
FUZZERS = 2


def start(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_nothing_received_can_hurt(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    settings = WireSettings(free_endpoint(), lease_s=10.0, timeout_s=30.0)
    with (
        open_session(settings, listen=True) as session,
        Replay(tmp_path / "replay", 50_000, 1, 0.99, **SIZES) as replay,
    ):
        server = UploadServer(session, "run1", Ingest(replay.ring, None, "run1"), epoch=1, grace_s=10.0)
        roster = Roster(session, "run1")
        control = ControlServer(session, "run1", "{}", epoch=1)
        good = start("tests.unit.wire.child", "sender", settings.endpoint, tmp_path, "a0", 10**6)
        began_at = time.monotonic()
        fuzzers = [
            start("tests.unit.wire.fuzz", settings.endpoint, MESSAGES // FUZZERS, seed) for seed in range(FUZZERS)
        ]
        outputs = [fuzzer.communicate(timeout=1000) for fuzzer in fuzzers]
        took_s = time.monotonic() - began_at
        stored_meanwhile = replay.ring.rollouts_total
        goes_on = wait_until(lambda: replay.ring.rollouts_total > stored_meanwhile or good.poll() is not None, 60.0)
        assert goes_on and good.poll() is None, good.communicate()  # the good actor goes on afterwards
        control.set_state("stop")
        out = good.communicate(timeout=60)
        assert good.returncode == 0, out
        refused, counts = server.refused(1000), dict(server.counts)
        ledger = audit(replay, [tmp_path / "a0"])
        for part in (control, roster, server):
            part.close()
    sent: Counter[str] = Counter()
    for out, errors in outputs:
        assert errors == ""
        sent.update(json.loads(out))
    print(f"{MESSAGES} messages in {took_s:.0f} s beside {stored_meanwhile} good rollouts: {dict(sent)}; {counts}")
    total = ledger.total()
    print(f"| {MESSAGES} messages | {total.sent} | {total.lost} | {total.duplicate} | {took_s:.0f} s |")
    assert sum(sent.values()) == MESSAGES
    assert ledger.agrees, ledger.sentence()
    assert set(ledger.accounts) == {"a0"}
    assert stored_meanwhile > 0
    judged = counts["refused"] + counts["hello"]
    assert judged >= MESSAGES - sent["oversized"]
    assert counts.get("failed", 0) == 0
    named = {sender for sender in refused if sender.startswith("run1/bad-")}
    assert len(named) == 64
    assert sum(refused.values()) == counts["refused"]
    assert any(sender.startswith("run2/bad-") for sender in refused)
    assert roster.counts["malformed"] > 0
    assert len([record for record in caplog.records if record.levelno >= logging.WARNING]) < 60
