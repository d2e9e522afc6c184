"""Every fault of docs/reliability.md on real processes: after it, each transition is in replay exactly once.

python -m pytest tests/integration/test_faults.py -s        # prints the rows of the table
"""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.integration.cluster import Cluster
from tests.metrics_file import records

FREEZE_S, CUT_S = 15.0, 20.0


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    try:
        cluster.begin()
        yield cluster
    finally:
        cluster.close()


def settle(cluster: Cluster, fault: str, recovered_s: float) -> None:
    """The run goes on for a while, ends, and nothing is missing or doubled."""
    cluster.wait_for_more()
    ledger = cluster.finish()
    total = ledger.total()
    print(f"| {fault} | {total.sent} | {total.lost} | {total.duplicate} | {recovered_s:.1f} s |")
    assert ledger.agrees, ledger.sentence()
    assert total.sent > 0


def test_an_actor_killed_in_the_middle_of_an_upload(cluster: Cluster) -> None:
    cluster.start_actor("a0")
    cluster.wait_for_more()
    cluster.cable.pull()  # the upload is on its way, its answer will never come
    spool = cluster.root / "spools" / "a0"
    cluster.wait_for(lambda: list(spool.glob("*.rollout")), "an upload under way")
    cluster.kill("a0")
    cluster.cable.plug()
    cluster.start_actor("a0")
    settle(cluster, "actor killed -9 in an upload, restarted", cluster.wait_for_more())


def test_a_learner_killed_and_restarted_from_its_files(cluster: Cluster) -> None:
    cluster.start_actor("a0")
    cluster.start_actor("a1")
    cluster.wait_for_more(80)
    cluster.wait_for(lambda: list((cluster.run / "checkpoints").glob("*.safetensors")), "a checkpoint")
    cluster.kill("learner")
    stored = cluster.steps()
    cluster.start_learner()
    recovered_s = cluster.wait_for(lambda: cluster.steps() > stored, "new transitions")
    assert "resumed at" in cluster.log("learner")
    assert "the learner does not answer" in cluster.log("a0") + cluster.log("a1")
    assert json.loads((cluster.run / "epoch.json").read_text())["epoch"] == 2
    settle(cluster, "learner killed -9, restarted from its files", recovered_s)


def test_a_learner_killed_five_times_still_learns(cluster: Cluster) -> None:
    """The long version, with curves, is benchmarks/recovery.py."""
    cluster.start_actor("a0")
    cluster.wait_for(lambda: cluster.steps() > 80, "enough to learn from")
    for _ in range(5):
        cluster.wait_for_more(5)
        cluster.kill("learner")
        cluster.start_learner()
    recovered_s = cluster.wait_for_more()
    # Updates lost with a killed process are made again: in the end as many as the limiter allows for this much data.
    cluster.wait_for(
        lambda: updates_and_due(cluster.run)[0] >= 0.5 * updates_and_due(cluster.run)[1], "the updates due"
    )
    settle(cluster, "learner killed -9 five times", recovered_s)
    assert json.loads((cluster.run / "epoch.json").read_text())["epoch"] == 6
    made, due = updates_and_due(cluster.run)
    assert made <= due + 1100.0 * 64.0 / 256.0


def updates_and_due(run: Path) -> tuple[float, float]:
    """Updates made by the last report, and how many 64 samples per transition are in batches of 256."""
    last = next(record for record in reversed(records(run)) if "rate/updates" in record)  # others are of worlds
    return last["rate/updates"], 64.0 * (last["step"] - 60) / 256.0


def test_everything_killed_and_restarted(cluster: Cluster) -> None:
    for _ in range(2):
        cluster.start_actor("a0")
        cluster.start_actor("a1")
        cluster.wait_for_more(20)
        cluster.kill("learner", "a0", "a1")
        cluster.start_learner()
    cluster.start_actor("a0")
    cluster.start_actor("a1")
    settle(cluster, "everything killed -9 and restarted, twice", cluster.wait_for_more())


def test_long_silences(tmp_path: Path) -> None:
    """Learner frozen, actor frozen, network cut: three runs at a time, since each is mostly waiting."""
    faults: dict[str, tuple[float, Callable[[Cluster], None], Callable[[Cluster], None]]] = {
        f"learner frozen {FREEZE_S:.0f} s": (
            FREEZE_S,
            lambda c: c.signal("learner", signal.SIGSTOP),
            lambda c: c.signal("learner", signal.SIGCONT),
        ),
        f"actor frozen {FREEZE_S:.0f} s": (
            FREEZE_S,
            lambda c: c.signal("a0", signal.SIGSTOP),
            lambda c: c.signal("a0", signal.SIGCONT),
        ),
        f"network cut {CUT_S:.0f} s": (CUT_S, lambda c: c.cable.pull(), lambda c: c.cable.plug()),
    }
    clusters = {fault: Cluster(tmp_path / str(i)) for i, fault in enumerate(faults)}
    try:
        for cluster in clusters.values():
            cluster.begin()
            cluster.start_actor("a0")
        for cluster in clusters.values():
            cluster.wait_for(lambda c=cluster: c.steps() > 20, "the first transitions")  # type: ignore[misc]
        began = time.monotonic()
        for fault, (_, begin, _) in faults.items():
            begin(clusters[fault])
        for fault, (lasts_s, _, end) in sorted(faults.items(), key=lambda item: item[1][0]):
            time.sleep(max(began + lasts_s - time.monotonic(), 0.0))  # what is tested is exactly this silence
            end(clusters[fault])
        recovered_s = {fault: cluster.wait_for_more() for fault, cluster in clusters.items()}
        for fault, cluster in clusters.items():
            settle(cluster, fault, recovered_s[fault])
        assert "the learner does not answer" in clusters[f"network cut {CUT_S:.0f} s"].log("a0")
    finally:
        for cluster in clusters.values():
            cluster.close()


def test_a_second_actor_of_the_same_id_is_refused_and_the_first_goes_on(cluster: Cluster) -> None:
    cluster.start_actor("a0")
    cluster.wait_for_more()
    cluster.start_actor("a0", spool="elsewhere", name="second")
    status, said = cluster.wait("second")
    assert status == 2
    assert "actor id a0 is in use by another live process" in said
    settle(cluster, "two actors of one id", 0.0)


def test_an_actor_of_another_version_and_one_of_another_run_are_refused(cluster: Cluster) -> None:
    cluster.start_actor("old", code="from appl_dist import spec; spec.WIRE_VERSION += 1")
    status, said = cluster.wait("old")
    assert status == 2
    assert "run the same appl-dist version everywhere" in said
    cluster.start_actor("a0")
    cluster.wait_for_more()
    cluster.kill("learner")
    cluster.start_learner("other")  # at the same address
    status, said = cluster.wait("a0")
    assert status == 2
    assert re.search(r"run: got run-\w+; the learner here is of run other-\w+", said), said
    cluster.start_actor("a0")
    status, said = cluster.wait("a0")
    assert status == 2
    assert re.search(r"belongs to run-\w+/a0, not to other-\w+/a0", said), said
    cluster.start_actor("a1", spool="fresh")
    cluster.wait_for_more()
    cluster.signal("learner", signal.SIGINT)
    cluster.wait("learner")
    assert cluster.wait("a1")[0] == 0


def test_a_full_spool_holds_the_actor_back_and_drains_in_order(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, "actor.spool_rollouts=3")
    try:
        cluster.begin()
        cluster.start_actor("a0")
        cluster.wait_for_more()
        cluster.kill("learner")
        cluster.wait_for(lambda: "is full (3 rollouts" in cluster.log("a0"), "a full spool")
        assert len(list((tmp_path / "spools" / "a0").glob("*.rollout"))) == 3
        cluster.start_learner()
        recovered_s = cluster.wait_for_more()
        cluster.wait_for(lambda: stale_share(cluster.run) > 0.0, "the stale share")
        settle(cluster, "learner away until the spool was full", recovered_s)
    finally:
        cluster.close()


def stale_share(run: Path) -> float:
    return max(record.get("policy/stale_share", 0.0) for record in records(run))


@pytest.mark.parametrize("security", ["lan", "tls"])
def test_secrets_are_in_no_log_process_list_or_run_folder(tmp_path: Path, security: str, monkeypatch) -> None:
    from appl_dist.launch.make_keys import make_keys

    keys = tmp_path / "keys"
    make_keys(keys, [], [])
    secrets = [line.split(":")[1] for line in (keys / "learner" / "users").read_text().split()]
    secrets += [line for file in keys.rglob("key.pem") for line in file.read_text().splitlines() if "-----" not in line]
    assert len(secrets) >= 9
    monkeypatch.setenv("RUST_LOG", "debug")  # zenoh's own log is the talkative one
    wire = (f"wire={security}", f"wire.keys={keys}")
    cluster = Cluster(tmp_path / "c", *wire, actor=wire, tls=security == "tls")
    try:
        cluster.begin()
        cluster.start_actor("actor-7")
        cluster.wait_for_more()
        seen = "".join(
            Path(f"/proc/{process.pid}/{what}").read_text()
            for process in cluster.processes.values()
            for what in ("cmdline", "environ")
        )
        assert str(keys) in seen
        settle(cluster, f"none (wire={security})", 0.0)
    finally:
        cluster.close()
    everything = seen.encode() + b"".join(p.read_bytes() for p in (tmp_path / "c").rglob("*") if p.is_file())
    assert len(everything) > 100_000
    assert [secret for secret in secrets if secret.encode() in everything] == []
