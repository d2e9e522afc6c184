"""The report of synthetic evaluations: what it brings together, refuses and shows; looked at in a real browser."""

from __future__ import annotations

import html
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from appl_dist.actor.protocol import APPL, PROTOCOLS, Protocol
from appl_dist.errors import UserError
from appl_dist.evaluate.folder import Course, Head, write_head
from appl_dist.evaluate.trial_log import TrialLog
from appl_dist.evaluate.trials import Method, Trial, trial_seed
from appl_dist.report.build import write_report
from appl_dist.report.data import gather
from tests.unit.evaluate.synthetic import make_trial

pytestmark = pytest.mark.timeout(900)  # two dozen figures, on a machine that may be busy
ROOT = Path(__file__).parents[3]
WORLDS = tuple(range(12))
SLOW = "slow & <fast>"  # a label that HTML, LaTeX and Markdown must escape


def write_evaluation(
    folder: Path,
    methods: dict[str, float],
    *,
    protocol: Protocol = APPL,
    seed: int = 0,
    config: str = "c",
    trials: int = 4,
    noise_s: float = 1.0,
) -> Path:
    """An evaluation in which each method takes its time, plus the world's, plus noise; world 11 never succeeds."""
    rng = np.random.default_rng(seed)
    courses = [Course(w, f"{w:08x}", w, 5.0, tuple(rng.normal(size=5))) for w in WORLDS]
    checked = tuple(Method(label, label) for label in methods)
    machine = {"processor": "a processor with a rather long name, 12th generation", "cores": 2, "numpy": "2"}
    session = {
        "begun": "2026-01-01T00:00:00+00:00",
        "trials": 1,
        "seconds": 1.0,
        "workers": 2,
        "episodes_per_s": 1.0,
        "x_real_time": 20.0,
        "machine": machine,
        "code": {"version": "0.1.0", "commit": "0" * 40, "changed": False},
    }
    groups = {"train": WORLDS[:8], "test": WORLDS[8:]}
    write_head(folder, Head(protocol, checked, groups, seed, trials, {"env": {"space": "dwa"}}, (session,)), courses)
    with TrialLog(folder / "trials.csv", Trial, protocol.name, config) as log:
        for w in WORLDS:
            for k in range(trials):
                for m in checked:
                    time_s = methods[m.label] + w + noise_s * float(rng.normal())
                    t = make_trial(m.label, w, k, 50.0 if w == 11 else time_s, success=w != 11)
                    changes = {"policy": m.fingerprint, "course": f"{w:08x}", "seed": trial_seed(seed, w, k)}
                    log.append(replace(t, protocol=protocol.name, **changes))
    return folder


def test_different_protocols_are_refused_in_a_sentence(tmp_path: Path) -> None:
    a = write_evaluation(tmp_path / "a", {"default": 20.0})
    b = write_evaluation(tmp_path / "b", {"learned": 10.0}, protocol=PROTOCOLS.get("ros_jackal"))
    with pytest.raises(UserError, match=r"cannot be compared.*'appl' and 'ros_jackal'.*success_y_m 10.0 and 11.0"):
        gather([a, b])
    longer = replace(PROTOCOLS.get("appl"), limit_s=60.0)
    c = write_evaluation(tmp_path / "c", {"learned": 10.0}, protocol=longer)
    with pytest.raises(UserError, match=r"limit_s 50.0 and 60.0"):
        gather([a, c])


def test_the_same_trials_in_two_folders_count_once_and_others_are_told_apart(tmp_path: Path) -> None:
    a = write_evaluation(tmp_path / "a", {"default": 20.0, "learned": 10.0})
    shutil.copytree(a, tmp_path / "copy")
    assert len(gather([a, tmp_path / "copy"]).origin) == len(gather([a]).origin) == 2 * 12 * 4
    b = write_evaluation(tmp_path / "b", {"default": 20.0}, seed=1)
    shutil.copy(a / "worlds.csv", b / "worlds.csv")
    both = gather([a, b])
    assert both.analysis.methods == ("default (a)", "learned", "default (b)")
    c = write_evaluation(tmp_path / "c", {"default": 20.0}, config="other")
    assert "default (c)" in gather([a, c]).analysis.methods


def test_folders_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    a = write_evaluation(tmp_path / "a", {"default": 20.0})
    other_worlds = write_evaluation(tmp_path / "b", {"learned": 20.0}, seed=1)
    with pytest.raises(UserError, match="not the same course"):
        gather([a, other_worlds])
    changed = write_evaluation(tmp_path / "c", {"default": 21.0})
    with pytest.raises(UserError, match="other code drove one of them"):
        gather([a, changed])


def test_trials_of_another_machine_are_compared_with_a_caveat(tmp_path: Path) -> None:
    a = write_evaluation(tmp_path / "a", {"default": 20.0})
    b = write_evaluation(tmp_path / "b", {"default": 21.0})
    head = json.loads((b / "evaluation.json").read_text())
    head["sessions"][0]["machine"]["processor"] = "another processor"
    (b / "evaluation.json").write_text(json.dumps(head))
    data = gather([a, b])
    assert {e.folder for e, _ in data.origin.values()} == {a}
    assert any("2 kinds of machine" in c for c in data.caveats)
    assert any("44 trials of the same seed came out differently" in c for c in data.caveats)


def test_caveats_stand_in_every_form_of_every_table(tmp_path: Path) -> None:
    """40 trials against 2, one of a learned policy on its training worlds, not finished."""
    a = write_evaluation(tmp_path / "a", {"default": 20.0}, trials=40)
    b = write_evaluation(tmp_path / "b", {"x[/y] & |": 15.0}, trials=2)
    shutil.copy(a / "worlds.csv", b / "worlds.csv")
    head = json.loads((b / "evaluation.json").read_text())
    head |= {"trials_per_world": 3}
    head["methods"][0]["spec"] = "runs/a/policy.safetensors"
    (b / "evaluation.json").write_text(json.dumps(head))
    report = write_report([a, b], tmp_path / "out", pictures=False)
    expected = ["unequal (2 to 40 a world", "12 of 36 trials are missing", "one training run each", "training worlds"]
    out = Console(file=io.StringIO(), width=100)
    for table in report.tables:
        out.print(table.rich())
        csv_text = (tmp_path / "out" / "tables" / f"{table.name}.csv").read_text()
        for text in (table.markdown(), table.latex(), table.html(), csv_text):
            assert all(e in text for e in expected), table.name
    shown = " ".join(out.file.getvalue().split())  # type: ignore[attr-defined]
    assert all(shown.count(e) == len(report.tables) for e in expected)
    record = next(r for t in report.tables if t.name == "mean" for r in t.records if r["method"] != "default")
    low, mean, high = (record[f"improvement_over_default_{k}"] for k in ("low_s", "s", "high_s"))
    assert low <= mean <= high


def test_results_are_kept_where_figures_cannot_be_drawn(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    a = write_evaluation(tmp_path / "a", {"default": 20.0})
    blocked = tmp_path / "out" / "figures"
    blocked.parent.mkdir()
    blocked.write_text("a file where figures would go")
    write_report([a], tmp_path / "out")
    assert "no figures" in caplog.text and str(tmp_path / "out") in caplog.text
    assert "Mean traversal time" in (tmp_path / "out" / "report.html").read_text()


def test_a_backend_of_another_program_does_not_stop_figures(tmp_path: Path) -> None:
    code = "from appl_dist.report.style import new_figure; new_figure(1.0)"
    for backend in ("module://matplotlib_inline.backend_inline", "nonsense"):
        subprocess.run([sys.executable, "-c", code], env={**os.environ, "MPLBACKEND": backend}, check=True)


class Page(HTMLParser):
    """Tags that stay open, and every address the page names."""

    VOID = ("meta", "link", "img", "br", "hr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.images = 0

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.images += tag == "img"
        self.addresses += [v or "" for k, v in attributes if k in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    (folder / "metrics.jsonl").write_text(
        "".join(json.dumps({"step": 10 * i, "episode/time_s": 30.0, "episode/success": 0.9}) + "\n" for i in range(9))
    )
    methods = {"default": 20.0, "fixed": 15.0, "learned": 10.0, SLOW: 25.0}
    write_report([write_evaluation(folder / "evaluation", methods)], folder / "out")
    return folder / "out"


def test_a_report_is_whole_and_needs_no_network(report: Path) -> None:
    text = (report / "report.html").read_text()
    page = Page()
    page.feed(text)
    assert page.open == []
    assert page.images >= 7
    assert all(a.startswith(("data:", "#")) for a in page.addresses)
    assert "<script" not in text
    for words in ("learned is 10", html.escape(SLOW), "Sessions", "a processor with", "appl-dist replay", "0000000000"):
        assert words in text
    names = {p.relative_to(report).as_posix() for p in report.rglob("*") if p.is_file()}
    figures = (
        "difference_learned_default",
        "difference_learned_fixed",
        "times",
        "times_by_world",
        "profiles",
        "learning",
    )
    assert {f"figures/{n}.{kind}" for n in (*figures, "learning") for kind in ("pdf", "png")} <= names
    tables = ("mean", "wins", "matrix_train", "matrix_test", "thirds", "sets", "difficulty", "driving")
    assert {f"tables/{n}.csv" for n in tables} <= names
    assert not [n for n in names if n.endswith(".tmp")]


def test_latex_tables_are_balanced_and_escaped(report: Path) -> None:
    text = (report / "tables.tex").read_text()
    assert r"slow \& <fast>" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") >= 8
    assert not re.search(r"(?<!\\)%", text)
    for table in text.split(r"\begin{table}")[1:]:
        columns = len(re.search(r"\\begin{tabular}{([lr]+)}", table)[1])  # type: ignore[index]
        rows = [line for line in table.splitlines() if line.endswith(r"\\")]
        assert rows
        assert all(len(re.findall(r"(?<!\\)&", row)) == columns - 1 for row in rows)


def test_the_report_of_a_challenge_has_scores(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", {"default": 20.0}, protocol=PROTOCOLS.get("challenge"), noise_s=0.0)
    found = {t.name: t for t in write_report([folder], tmp_path / "out").tables}
    rows = {r["clip"]: r for r in found["score"].records}
    # OT 5 s; world w takes 20 + w s: 5 / (20 + w), clipped at 10 and 40 or 20 and 40 s; world 11 fails.
    expected = sum(5.0 / (20.0 + w) for w in range(11)) / 12
    assert rows["since 2024"]["score"] == pytest.approx(expected)
    assert rows["before 2024"]["score"] == pytest.approx(expected)
    assert (rows["since 2024"]["best"], rows["before 2024"]["best"]) == (0.5, 0.25)
    fast = write_evaluation(tmp_path / "b", {"default": 1.0}, protocol=PROTOCOLS.get("challenge"), noise_s=0.0)
    rows = {r["clip"]: r for r in {t.name: t for t in write_report([fast], tmp_path / "out").tables}["score"].records}
    # 1 + w s: the clips hold times at 10 s and 20 s
    assert rows["before 2024"]["score"] == pytest.approx(11 * 0.25 / 12)
    assert rows["since 2024"]["score"] == pytest.approx((10 * 0.5 + 5.0 / 11.0) / 12)


def test_a_full_disk_leaves_the_old_report(report: Path, tmp_path: Path) -> None:
    evaluation = report.parent / "evaluation"
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("the old one")
    script = f"""
import resource, signal, sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from appl_dist.errors import UserError
from appl_dist.report.build import write_report
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
try:
    write_report([Path({str(evaluation)!r})], Path({str(tmp_path / "out")!r}))
except UserError as error:
    print(error)
"""
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=Path.cwd()
    ).stdout
    assert "cannot be written: File too large" in told
    assert (tmp_path / "out" / "report.html").read_text() == "the old one"
    assert not list((tmp_path / "out").rglob("*.tmp"))


@pytest.fixture
def chromium() -> Callable[..., str]:
    name = next((n for n in ("chromium", "chromium-browser", "google-chrome") if shutil.which(n)), None)
    if name is None:
        pytest.skip("no chromium on this machine")

    def run(*arguments: str) -> str:
        flags = ("--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--hide-scrollbars")
        command = [name, *flags, "--virtual-time-budget=20000", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout

    return run


MEASURE = """<!doctype html><body style="margin:0">
<iframe id=f src="{address}" style="border:0;width:{width}px;height:3000px"></iframe>
<script>f.onload = () => {{
  const d = f.contentDocument, w = d.documentElement.clientWidth;
  const over = [...d.querySelectorAll('body *')].filter(e => !e.closest('.scroll, pre')
    && e.getBoundingClientRect().right > w + 0.5).map(e => e.tagName + ' ' + e.textContent.slice(0, 60));
  const broken = [...d.images].filter(i => !i.complete || i.naturalWidth === 0).length;
  document.title = JSON.stringify({{client: w, scroll: d.documentElement.scrollWidth, over, broken,
    images: d.images.length}});
}}</script>"""


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_overflows_in_a_browser(report: Path, tmp_path: Path, chromium: Callable[..., str], width: int) -> None:
    wrapper = tmp_path / "wrapper.html"
    wrapper.write_text(MEASURE.format(address=(report / "report.html").as_uri(), width=width))
    dom = chromium("--window-size=1400,3000", "--dump-dom", wrapper.as_uri())
    found = json.loads(html.unescape(re.search(r"<title>(.*?)</title>", dom)[1]))  # type: ignore[index]
    assert found["scroll"] <= found["client"] <= width
    assert found["over"] == []
    assert found["images"] >= 7
    assert found["broken"] == 0


def test_protocol_of_a_head_is_kept_whole(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", {"default": 20.0}, protocol=PROTOCOLS.get("challenge"))
    plain = json.loads((folder / "evaluation.json").read_text())
    assert Protocol(**plain["protocol"]) == PROTOCOLS.get("challenge")
    assert asdict(PROTOCOLS.get("challenge")) == plain["protocol"]
