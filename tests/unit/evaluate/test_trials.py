"""Trials: seeds, parallel workers, the log that survives interruption."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from appl_dist.errors import UserError
from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.trials import (
    Method,
    Trial,
    decode_trace,
    encode_trace,
    make_jobs,
    run_trials,
    trial_seed,
)
from appl_dist.evaluate.workers import run_parallel
from tests.unit.evaluate.synthetic import ReadEnvironment, Synthetic

METHODS = (Method("default", "default"), Method("fast", "set:fast"))
ROOT = Path(__file__).parents[3]


def test_seed_is_shared_by_methods_and_differs_between_trials() -> None:
    jobs = make_jobs(METHODS, [3, 4], range(2), seed=1)
    seeds = {(j.method, j.world, j.trial): j.seed for j in jobs}
    assert len(jobs) == 8
    assert all(seeds["default", w, k] == seeds["fast", w, k] for w in (3, 4) for k in (0, 1))
    assert len(set(seeds.values())) == 4
    assert trial_seed(2, 3, 0) != trial_seed(1, 3, 0) < 2**53


def test_result_is_the_same_with_any_number_of_workers(tmp_path: Path) -> None:
    serial = run_trials(METHODS, range(5), 3, Synthetic(), workers=0, seed=7)
    parallel = run_trials(METHODS, range(5), 3, Synthetic(), workers=2, seed=7, folder=tmp_path)
    reread = run_trials(METHODS, range(5), 3, Synthetic(fault="death"), workers=2, seed=7, folder=tmp_path)
    assert serial == parallel == reread  # the third ran nothing: world 3 would have killed its worker
    assert run_trials(METHODS, range(5), 3, Synthetic(), workers=0, seed=8) != serial


def test_a_worker_that_dies_is_replaced_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Killed once, as for a lack of memory: one process of one, and every trial is there."""
    mark = tmp_path / "killed"
    found = run_trials(METHODS, range(5), 2, Synthetic(fault=f"killed once {mark}"), workers=1)
    assert mark.exists()
    assert found == run_trials(METHODS, range(5), 2, Synthetic(), workers=0)
    assert "evaluate-0 was killed by SIGKILL" in caplog.text


def test_more_trials_worlds_and_methods_keep_the_finished_ones(tmp_path: Path) -> None:
    seen: list[Trial] = []
    run_trials(METHODS[:1], [0, 1], 2, Synthetic(), workers=0, folder=tmp_path)
    more = run_trials(METHODS, [0, 1, 2], 3, Synthetic(), workers=0, folder=tmp_path, on_trial=seen.append)
    assert (len(more), len(seen)) == (18, 14)  # four were there
    lines = (tmp_path / "trials.csv").read_text().splitlines()
    assert len(lines) == 2 + 18
    assert more == run_trials(METHODS, [0, 1, 2], 3, Synthetic(), workers=0)


def test_a_row_cut_short_is_run_again(tmp_path: Path) -> None:
    whole = run_trials(METHODS, [0, 1], 2, Synthetic(), workers=0, folder=tmp_path)
    path = tmp_path / "trials.csv"
    data = path.read_bytes()
    path.write_bytes(data[:-9])
    again = run_trials(METHODS, [0, 1], 2, Synthetic(), workers=0, folder=tmp_path)
    assert again == whole
    assert path.read_bytes() == data
    path.write_bytes(data[:40])  # cut in the header
    assert run_trials(METHODS, [0, 1], 2, Synthetic(), workers=0, folder=tmp_path) == whole


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace("config a", "config b"), "other settings"),
        (lambda t: t.replace("protocol appl", "protocol challenge"), "different protocols do not compare"),
        (lambda t: t.replace("trials 2", "trials 1"), "is of format 1, this version reads 2"),
        (lambda t: t + t.splitlines(keepends=True)[2], "a second time"),
        (lambda t: "time,world\n1,2\n", "is not a trial log"),
        (lambda t: t.replace("outcome", "end"), "other columns"),
        (lambda t: t.replace("goal", "gaol", 1), "line 3 is no trial"),
    ],
)
def test_a_foreign_file_is_refused_and_left_alone(tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    run_trials(METHODS, [0, 1], 2, Synthetic(), workers=0, folder=tmp_path, protocol="appl", config_hash="a")
    path = tmp_path / "trials.csv"
    path.write_text(change(path.read_text()))
    before = path.read_bytes()
    with pytest.raises(UserError, match=words):
        run_trials(METHODS, [0, 1], 2, Synthetic(), workers=0, folder=tmp_path, protocol="appl", config_hash="a")
    assert path.read_bytes() == before


def test_another_policy_under_the_same_label_is_refused(tmp_path: Path) -> None:
    run_trials(METHODS, [0], 1, Synthetic(), workers=0, folder=tmp_path)
    with pytest.raises(UserError, match="another label"):
        run_trials([Method("fast", "set:other")], [0], 1, Synthetic(), workers=0, folder=tmp_path)
    with pytest.raises(UserError, match="other seeds"):
        run_trials(METHODS, [0], 1, Synthetic(), workers=0, folder=tmp_path, seed=5)


def test_a_second_evaluation_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    with TrialLog(tmp_path / "trials.csv", Trial, "appl", ""), pytest.raises(UserError, match="another evaluation"):
        TrialLog(tmp_path / "trials.csv", Trial, "appl", "")


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("user error", UserError, "^policy: got nonsense$"),
        ("exception", RuntimeError, "ZeroDivisionError: in world 3"),
        ("death", RuntimeError, "2 workers died in .*exit code 7"),
    ],
)
def test_a_fault_in_a_worker_is_told_and_finished_trials_stay(
    tmp_path: Path, fault: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        run_trials(METHODS, range(6), 2, Synthetic(fault=fault), workers=2, folder=tmp_path)
    assert not psutil.Process().children(recursive=True) or _only_tracker()
    kept = run_trials(METHODS, range(3), 1, Synthetic(), workers=0, folder=tmp_path)
    assert kept == run_trials(METHODS, range(3), 1, Synthetic(), workers=0)


def _only_tracker() -> bool:
    commands = [" ".join(c.cmdline()) for c in psutil.Process().children(recursive=True)]
    return all("resource_tracker" in c for c in commands)


def test_full_disk_leaves_whole_rows_and_a_sentence(tmp_path: Path) -> None:
    script = f"""
        import resource, signal
        from appl_dist.errors import UserError
        import signal
        from appl_dist.evaluate.trials import Method, run_trials
        from tests.unit.evaluate.synthetic import Synthetic
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
        try:
            run_trials([Method("a", "a")], range(50), 1, Synthetic(), workers=0, folder={str(tmp_path)!r})
        except UserError as error:
            print(error)
    """
    told = _python(script)
    assert "File too large" in told
    assert "make room" in told
    data = (tmp_path / "trials.csv").read_bytes()
    assert data.endswith(b"\n")
    assert 1800 < len(data) <= 2000
    kept = run_trials([Method("a", "a")], range(50), 1, Synthetic(), workers=0, folder=tmp_path)
    assert kept == run_trials([Method("a", "a")], range(50), 1, Synthetic(), workers=0)
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 2000


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_an_interrupted_evaluation(tmp_path: Path, how: signal.Signals) -> None:
    script = f"""
        import signal
        from appl_dist.evaluate.trials import Method, run_trials
        from tests.unit.evaluate.synthetic import Synthetic
        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where a shell runs us in the background
            methods = [Method("default", "default"), Method("fast", "set:fast")]
            run_trials(methods, range(2000), 1, Synthetic(delay_s=0.02), workers=2, folder={str(tmp_path)!r})
    """
    file = tmp_path / "run.py"
    file.write_text(textwrap.dedent(script))
    run = subprocess.Popen([sys.executable, file], env=_environment(), stderr=subprocess.PIPE, text=True)
    log = tmp_path / "trials.csv"
    _wait_for(lambda: log.exists() and log.read_bytes().count(b"\n") > 6)
    children = psutil.Process(run.pid).children(recursive=True)
    assert len(children) >= 2
    run.send_signal(how)
    told = run.communicate(timeout=60)[1]
    _wait_for(lambda: not any(c.is_running() and c.status() != psutil.STATUS_ZOMBIE for c in children))
    assert told.count("KeyboardInterrupt") == (1 if how == signal.SIGINT else 0)
    rows = log.read_bytes().count(b"\n") - 2
    kept = run_trials(METHODS, range(5), 1, Synthetic(), workers=0, folder=tmp_path)
    assert kept == run_trials(METHODS, range(5), 1, Synthetic(), workers=0)
    assert log.read_bytes().count(b"\n") - 2 >= rows - 1


def test_workers_get_one_thread_each_and_no_heavy_library() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    told = dict(run_parallel(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"], ReadEnvironment(), 2))
    assert told == {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    assert os.environ.get("OMP_NUM_THREADS") == before
    loaded = _python(
        "import sys; import appl_dist.evaluate.runner; "
        "print([m for m in ('torch', 'scipy', 'matplotlib', 'zenoh', 'rich') if m in sys.modules])"
    )
    assert loaded.strip() == "[]"


def test_a_trial_checks_itself() -> None:
    good = run_trials(METHODS[:1], [0], 1, Synthetic(), workers=0)[0]
    with pytest.raises(ValueError, match="outcome: got 'arrived'"):
        replace(good, outcome="arrived")
    with pytest.raises(ValueError, match="time_s: got nan"):
        replace(good, time_s=float("nan"))


@given(arrays(np.float64, st.tuples(st.integers(1, 6), st.just(8)), elements=st.floats(allow_nan=False, width=64)))
def test_a_parameter_trace_reads_back_bit_for_bit(values: np.ndarray) -> None:
    values = np.where(np.isinf(values), 0.0, values) + 0.0
    assert decode_trace(encode_trace(values)).tobytes() == values.tobytes()
    assert encode_trace(values[:1].repeat(3, axis=0)).endswith(";;")


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT)}


def _python(script: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        env=_environment(),
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def _wait_for(condition) -> None:  # type: ignore[no-untyped-def]
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "nothing happened within a minute"
        time.sleep(0.02)
