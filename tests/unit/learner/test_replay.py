from __future__ import annotations

import dataclasses
import errno
import itertools
import multiprocessing
import os
import shutil
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appl_dist.errors import UserError
from appl_dist.learner import mapped_file
from appl_dist.learner.replay import Replay
from appl_dist.learner.row_layout import Batch
from appl_dist.spec import Rollout
from tests.paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE, SIZES
from tests.unit.learner.helpers import rollout, small_replay


def drawn(replay: Replay, size: int = 2000) -> Batch:
    return replay.sample(size, np.random.default_rng(0))


def table(batch: Batch) -> dict[int, tuple[float, float, int]]:
    """Step number -> n-step return, bootstrap discount, number of the state bootstrapped from."""
    return {
        int(s): (round(float(r), 5), round(float(d), 5), int(e))
        for s, r, d, e in zip(
            batch.observations[:, 2], batch.returns, batch.discounts, batch.next_observations[:, 2], strict=True
        )
    }


def test_n_step_targets_equal_the_hand_computed_table() -> None:
    replay = small_replay(n_step=3, gamma=0.5)
    replay.ring.insert(rollout(0, 4, terminal=True, rewards=[1, 2, 4, 8]), "a", 0)
    replay.ring.insert(rollout(10, 2, terminal=False, rewards=[16, 32]), "a", 1)
    assert table(drawn(replay)) == {
        0: (1 + 0.5 * 2 + 0.25 * 4, 0.125, 3),
        1: (2 + 0.5 * 4 + 0.25 * 8, 0.0, 4),  # reaches the terminal exactly
        2: (4 + 0.5 * 8, 0.0, 4),
        3: (8, 0.0, 4),
        10: (16 + 0.5 * 32, 0.25, 12),  # cut short: two steps, then the real last observation
        11: (32, 0.5, 12),
    }


def test_fault_02_n_step_discount_is_gamma_to_the_n() -> None:
    replay = small_replay(n_step=4, gamma=0.9)
    replay.ring.insert(rollout(0, 10), "a", 0)
    assert table(drawn(replay))[0][1] == pytest.approx(0.9**4, abs=1e-5)


def test_fault_03_windows_never_cross_the_write_pointer_or_join_episodes() -> None:
    # A ring of 18 rows under rollouts of different lengths: every start lands on every offset in time.
    replay = small_replay(capacity=16, n_step=3, gamma=1.0)
    rng = np.random.default_rng(1)
    first = 0
    for seq in range(200):
        n = int(rng.integers(1, 9))
        # Rewards 1: an n-step return counts its steps, and they must be the steps between the two states.
        replay.ring.insert(rollout(first, n, terminal=bool(seq % 2), rewards=np.ones(n)), "a", seq)
        batch = drawn(replay, 200)
        steps = batch.next_observations[:, 2] - batch.observations[:, 2]
        assert (steps == batch.returns).all()
        assert (steps >= 1).all()
        assert (steps <= 3).all()
        # Numbers jump by 100 between rollouts, so a joined window would show as a long step.
        assert len(np.unique(batch.observations[:, 2])) == len(replay.ring)
        first += n + 100


def test_fault_05_a_time_limit_bootstraps_and_a_terminal_does_not() -> None:
    replay = small_replay(gamma=0.9)
    replay.ring.insert(rollout(0, 1, terminal=False), "a", 0)
    replay.ring.insert(rollout(10, 1, terminal=True), "a", 1)
    found = table(drawn(replay))
    assert found[0] == (1.0, 0.9, 1)
    assert found[10] == (1.0, 0.0, 11)


def test_fault_06_an_action_outside_the_box_is_refused() -> None:
    replay = small_replay()
    good = rollout(0, 2)
    with pytest.raises(ValueError, match=r"actions: got 1\.01; allowed -1\.\.1"):
        replay.ring.insert(dataclasses.replace(good, actions=good.actions * 0 + np.float32(1.01)), "a", 0)
    assert len(replay.ring) == 0


def test_fault_10_each_observation_is_stored_once_and_compactly() -> None:
    with Replay(None, 5_000_000, 1, 0.99, **SIZES) as replay:  # untouched memory costs nothing
        assert replay.ring.layout.dtype.itemsize == 796
        # 40 transitions an episode: 41 rows for 40 transitions.
        assert 5_000_000 * 41 / 40 * replay.ring.layout.dtype.itemsize < 4.2e9


def test_values_come_back_scan_within_its_error_the_rest_exact() -> None:
    rng = np.random.default_rng(0)
    for dtype, levels in (("uint8", 255), ("uint16", 65535)):
        replay = Replay(None, 100, 1, 0.9, **SIZES, scan_dtype=dtype)
        obs = rng.uniform(-1, 1, (3, OBSERVATION_SIZE)).astype(np.float32)
        obs[0, 0], obs[0, 1], obs[0, 720] = -1.0, 1.0, 0.123
        replay.ring.insert(
            Rollout(obs, np.zeros((2, 8), np.float32), np.zeros(2, np.float32), True, {}, LIDAR_BEAMS), "a", 0
        )
        batch = replay.sample(50, rng)
        row = batch.observations[np.argmax(batch.observations[:, 720] == np.float32(0.123))]
        assert replay.ring.layout.scan_error == 1 / levels
        np.testing.assert_allclose(row[:720], obs[0, :720], atol=replay.ring.layout.scan_error + 1e-6)
        np.testing.assert_array_equal(row[720:], obs[0, 720:])
        assert (row[0], row[1]) == (-1.0, 1.0)


def test_sampling_is_uniform_over_transitions() -> None:
    replay = small_replay()
    for seq, n in enumerate((1, 2, 7)):
        replay.ring.insert(rollout(10 * seq, n), "a", seq)
    count = 50_000
    _, found = np.unique(drawn(replay, count).observations[:, 2], return_counts=True)
    assert len(found) == 10
    assert np.abs(found / count - 0.1).max() < 5 * np.sqrt(0.1 * 0.9 / count)


def test_repeats_are_dropped_and_gaps_refused() -> None:
    replay = small_replay()
    assert replay.ring.expected_seq("a") == 0
    assert replay.ring.insert(rollout(0, 2), "a", 0)
    assert not replay.ring.insert(rollout(0, 2), "a", 0)
    assert replay.ring.insert(rollout(0, 3), "b", 0)
    with pytest.raises(ValueError, match="'a': got rollout 5; expected 1"):
        replay.ring.insert(rollout(0, 2), "a", 5)
    assert (len(replay.ring), replay.ring.transitions_total, replay.ring.rollouts_total) == (5, 5, 2)
    assert (replay.ring.expected_seq("a"), replay.ring.expected_seq("b")) == (1, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"observations": np.zeros((3, 4), np.float32)}, "observations: got shape"),
        ({"actions": np.zeros((2, 9), np.float32)}, "actions: got shape"),
        ({"rewards": np.array([0, np.nan], np.float32)}, "rewards: holds a value that is not finite"),
        ({"observations": np.full((3, 5), 2, np.float32)}, r"scan: got 2; allowed -1\.\.1"),
        ({"rewards": np.zeros(0, np.float32)}, r"got 0 transitions; allowed 1\.\."),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(change: dict[str, Any], message: str) -> None:
    replay = small_replay()
    with pytest.raises(ValueError, match=message):
        replay.ring.insert(dataclasses.replace(rollout(0, 2), **change), "a", 0)
    assert len(replay.ring) == replay.ring.expected_seq("a") == 0


def test_an_empty_replay_cannot_be_sampled() -> None:
    with pytest.raises(IndexError, match="empty"):
        small_replay().sample(1, np.random.default_rng(0))


def test_reopened_it_samples_what_it_would_have_sampled(tmp_path: Path) -> None:
    stays = small_replay(capacity=40, n_step=3)
    for seq in range(30):  # wraps more than twice
        with small_replay(tmp_path, capacity=40, n_step=3) as reopened:
            n = 1 + seq % 7
            for replay in (stays, reopened):
                replay.ring.insert(rollout(100 * seq, n, bool(seq % 2)), f"actor {seq % 3}", seq // 3)
            assert len(stays.ring) == len(reopened.ring)
            assert stays.ring.transitions_total == reopened.ring.transitions_total
            for a, b in zip(vars(drawn(stays, 50)).values(), vars(drawn(reopened, 50)).values(), strict=True):
                np.testing.assert_array_equal(a, b)


def test_the_ring_forgets_transitions_but_no_actor(tmp_path: Path) -> None:
    with small_replay(tmp_path, capacity=20) as replay:
        replay.ring.insert(rollout(0, 5), "early", 0)
        for seq in range(20):
            replay.ring.insert(rollout(0, 5), "late", seq)
    with small_replay(tmp_path, capacity=20) as replay:
        assert replay.ring.expected_seq("early") == 1
        assert replay.ring.expected_seq("late") == 20
        assert (len(replay.ring), replay.ring.transitions_total) == (15, 105)


def test_a_folder_of_another_shape_is_refused_in_a_sentence(tmp_path: Path) -> None:
    small_replay(tmp_path, capacity=100).close()
    with pytest.raises(UserError, match="capacity is 100 there, this run has 50; continue with the settings"):
        small_replay(tmp_path, capacity=50)
    (tmp_path / "meta.json").write_text("{")
    with pytest.raises(UserError, match=r"meta\.json cannot be read"):
        small_replay(tmp_path, capacity=100)


def test_a_cut_file_is_refused(tmp_path: Path) -> None:
    small_replay(tmp_path).close()
    os.truncate(tmp_path / "rows.bin", 100)
    with pytest.raises(UserError, match=r"rows\.bin: has 100 bytes, expected"):
        small_replay(tmp_path)


def test_one_learner_at_a_time(tmp_path: Path) -> None:
    with small_replay(tmp_path), pytest.raises(UserError, match="another learner is using it"):
        small_replay(tmp_path)
    small_replay(tmp_path).close()


def test_capacity_costs_no_disk_before_use(tmp_path: Path) -> None:
    with Replay(tmp_path, 5_000_000, 1, 0.99, **SIZES):
        assert sum(f.stat().st_size for f in tmp_path.iterdir()) > 4e9
        assert sum(f.stat().st_blocks * 512 for f in tmp_path.iterdir()) < 10e6


def test_a_full_disk_is_a_sentence_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapped_file, "CHUNK_BYTES", 4096)
    replay = small_replay(tmp_path, capacity=1000)
    replay.ring.insert(rollout(0, 20), "a", 0)
    more = rollout(100, 200, rewards=np.ones(200))

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "posix_fallocate", full)
        with pytest.raises(UserError, match=r"rows\.bin: cannot claim .* No space left on device"):
            replay.ring.insert(more, "a", 1)
        assert (len(replay.ring), replay.ring.expected_seq("a")) == (20, 1)
        assert len(table(drawn(replay))) == 20
    assert replay.ring.insert(more, "a", 1)


def _insert_until_killed(folder: str, acknowledged: Any) -> None:
    replay = small_replay(folder, capacity=60)
    for seq in range(10**9):
        n = 1 + seq % 13
        replay.ring.insert(rollout(100 * seq, n, rewards=np.full(n, seq)), "a", seq)
        acknowledged.value = seq


@pytest.mark.parametrize("wait_s", [0.05, 0.1, 0.2])
def test_after_kill_9_the_acknowledged_is_there_and_nothing_half_written(tmp_path: Path, wait_s: float) -> None:
    context = multiprocessing.get_context("spawn")
    acknowledged = context.Value("q", -1, lock=False)  # a killed child would take the lock with it
    process = context.Process(target=_insert_until_killed, args=(str(tmp_path), acknowledged))
    process.start()
    assert process.pid is not None
    while acknowledged.value < 30:
        process.join(0.01)
        assert process.is_alive()
    process.join(wait_s)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with small_replay(tmp_path, capacity=60) as replay:
        stored = replay.ring.expected_seq("a")
        assert stored in (acknowledged.value + 1, acknowledged.value + 2)
        assert replay.ring.transitions_total == sum(1 + s % 13 for s in range(stored))
        batch = drawn(replay)
        # Every row belongs to the rollout its number says, and its reward agrees.
        np.testing.assert_array_equal(batch.observations[:, 2] // 100, batch.returns)
        assert batch.returns.max() == stored - 1
        assert replay.ring.insert(rollout(0, 3), "a", stored)


class PowerCuts:
    """Tries a power cut before and after every wait for the disk.

    A file's stores since it was last synced may or may not have reached the disk: each mixture of files as they were
    synced and as they are now must reopen, with every rollout acknowledged so far and nothing that was not given.
    """

    def __init__(self, folder: Path, elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.elsewhere, self.cuts = folder, elsewhere, 0
        self.synced = self.now()
        self.acknowledged = self.given = 0
        really = mapped_file.MappedArray.sync

        def sync(array: mapped_file.MappedArray) -> None:
            assert array.path is not None
            self.check()
            really(array)
            self.synced[array.path.name] = array.path.read_bytes()
            self.check()

        monkeypatch.setattr(mapped_file.MappedArray, "sync", sync)

    def now(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in sorted(self.folder.glob("*.bin"))}

    def check(self) -> None:
        now = self.now()
        versions = [[now[name], self.synced[name]] for name in now]
        for contents in itertools.product(*versions):
            for name, data in zip(now, contents, strict=True):
                (self.elsewhere / name).write_bytes(data)
            with small_replay(self.elsewhere, capacity=16) as found:
                assert self.acknowledged <= found.ring.expected_seq("a") <= self.given
                assert found.ring.expected_seq("gone") == 1  # also once the ring has overwritten its only rollout
                for stored in found.ring.rollouts():
                    if stored.actor == "gone":
                        continue
                    n = 1 + stored.seq % 5
                    assert np.array_equal(stored.other[:, 0], np.arange(10 * stored.seq, 10 * stored.seq + n + 1))
                    assert len(stored.actions) == n
            self.cuts += 1


def test_with_sync_a_power_cut_at_any_time_costs_nothing_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    with small_replay(tmp_path / "run", capacity=16, sync=True) as replay:
        shutil.copy(tmp_path / "run" / "meta.json", tmp_path / "elsewhere")
        replay.ring.insert(rollout(0, 1), "gone", 0)
        cuts = PowerCuts(tmp_path / "run", tmp_path / "elsewhere", monkeypatch)
        for seq in range(8):  # more than once around the ring
            cuts.given = seq + 1
            assert replay.ring.insert(rollout(10 * seq, 1 + seq % 5), "a", seq)
            cuts.acknowledged = seq + 1
            cuts.check()
    assert cuts.cuts > 200


def test_one_thread_inserts_while_another_samples() -> None:
    replay = small_replay(capacity=50, n_step=3, gamma=1.0)
    replay.ring.insert(rollout(0, 5, rewards=np.ones(5)), "a", 0)
    done = threading.Event()

    def insert() -> None:
        for seq in range(1, 2000):
            n = 1 + seq % 9
            replay.ring.insert(rollout(100 * seq, n, rewards=np.ones(n)), "a", seq)
        done.set()

    thread = threading.Thread(target=insert)
    thread.start()
    rng = np.random.default_rng(0)
    while not done.is_set():
        batch = replay.sample(64, rng)
        assert (batch.next_observations[:, 2] - batch.observations[:, 2] == batch.returns).all()
    thread.join()
