"""The network cut of test_faults.py with a real interface that goes down, where this machine allows it (root)."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.cluster import Cluster

CUT_S = 20.0
HERE, THERE = "10.213.77.1", "10.213.77.2"


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@pytest.fixture
def namespace() -> Iterator[str]:
    """A network namespace, joined to this one by a pair of interfaces NAME (there) and NAME-h (here)."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and the ip command")
    name = f"appl{os.getpid() % 10**6}"
    try:
        ip("netns", "add", name)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"cannot make network namespaces here: {error.stderr.decode().strip()}")
    try:
        ip("link", "add", f"{name}-h", "type", "veth", "peer", "name", name, "netns", name)
        ip("addr", "add", f"{HERE}/30", "dev", f"{name}-h")
        ip("link", "set", f"{name}-h", "up")
        ip("-n", name, "addr", "add", f"{THERE}/30", "dev", name)
        ip("-n", name, "link", "set", name, "up")
        ip("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        ip("netns", "del", name)


def test_a_network_interface_down_for_longer_than_the_lease(namespace: str, tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, host=HERE, prefix=("ip", "netns", "exec", namespace))
    try:
        cluster.begin()
        cluster.start_actor("a0")
        cluster.wait_for_more(20)
        ip("-n", namespace, "link", "set", namespace, "down")
        time.sleep(CUT_S)  # what is tested is exactly this silence
        before = cluster.steps()
        ip("-n", namespace, "link", "set", namespace, "up")
        recovered_s = cluster.wait_for(lambda: cluster.steps() > before, "new transitions")
        ledger = cluster.finish()
        total = ledger.total()
        print(
            f"| interface down {CUT_S:.0f} s | {total.sent} | {total.lost} | {total.duplicate} | {recovered_s:.1f} s |"
        )
        assert "the learner does not answer" in cluster.log("a0")
        assert ledger.agrees, ledger.sentence()
    finally:
        cluster.close()
