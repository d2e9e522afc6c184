"""One self-contained HTML page: what was run, tables, figures, failures with replays. No network, no script."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from appl_dist.evaluate.analysis import Analysis
from appl_dist.report.data import ReportData
from appl_dist.report.pictures import Film, Replays, failed_trials, origin_of
from appl_dist.report.table import Table

FAILURES_LISTED = 100
STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1080px; padding: 0 16px 64px; background: #fff; color: #1a1a1a;
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 32px 0 8px; }
h2 { font-size: 1.25rem; margin: 48px 0 8px; padding-top: 8px; border-top: 1px solid #ddd; }
nav a { margin-right: 16px; }
a { color: #0060a0; }
figure { margin: 24px 0; }
figure img { display: block; width: 100%; height: auto; }
figure.film img { max-width: 500px; }
figcaption { color: #444; font-size: .9rem; margin-bottom: 6px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
th, td { padding: 4px 12px 4px 0; text-align: right; vertical-align: top; white-space: nowrap;
  border-bottom: 1px solid #eee; }
th { border-bottom: 1px solid #888; font-weight: 600; }
.l { text-align: left; }
td.w { white-space: normal; min-width: 16em; }
code, pre { font: .82rem/1.45 ui-monospace, "Liberation Mono", monospace; }
pre { overflow-x: auto; background: #f6f6f6; padding: 12px; overflow-wrap: normal; }
.verdict li { margin: 4px 0; }
"""


@dataclass(frozen=True)
class Shown:
    """A figure as the page has it."""

    name: str
    caption: str
    png: bytes


def render(data: ReportData, tables: Sequence[Table], shown: Sequence[Shown], replays: Replays) -> str:
    """The page. `shown`: pictures of all trials, then those of `replays`."""
    of_replays = {p.name for p in replays.pictures}
    parts = [
        f"<h1>{_text(data.title)}</h1>",
        f"<p>Protocol <b>{_text(data.protocol.name)}</b>, {len(data.analysis.worlds)} worlds, "
        f"{len(data.origin):,} trials.</p>",
        '<nav><a href="#run">What was run</a> <a href="#tables">Tables</a> <a href="#figures">Figures</a> '
        '<a href="#replays">Trials</a> <a href="#failures">Failures</a></nav>',
        f"<ul class=verdict>{''.join(f'<li>{_text(v)}</li>' for v in verdicts(data.analysis))}</ul>",
        *([f"<p><b>Caveats.</b> {_text(' '.join(data.caveats))}</p>"] if data.caveats else []),
        '<h2 id="run">What was run</h2>',
        *_what_was_run(data),
        '<h2 id="tables">Tables</h2>',
        *(t.html() for t in tables),
        '<h2 id="figures">Figures</h2>',
        *(_image(s) for s in shown if s.name not in of_replays),
        '<h2 id="replays">Single trials</h2>',
        f"<p>{_text(_replayed(replays))}</p>",
        *(_image(s) for s in shown if s.name in of_replays and s.name != "failures"),
        '<h2 id="failures">Failures</h2>',
        *_failures(data),
        *(_image(s) for s in shown if s.name == "failures"),
        *(_film(f) for f in replays.films),
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>{_text(data.title)}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def verdicts(analysis: Analysis) -> list[str]:
    """The main comparison of every group in a sentence each."""
    found = []
    base = (*analysis.baselines, analysis.methods[0])[0]
    for g in analysis.groups:
        for m in analysis.methods:
            if m == base:
                continue
            c, s, b = g.comparisons[m, base], g.summaries[m], g.summaries[base]
            word = "faster" if c.improvement_s >= 0.0 else "slower"
            sign = 1.0 if c.improvement_s >= 0.0 else -1.0
            interval = sorted((sign * c.improvement_low_s, sign * c.improvement_high_s))
            bounds = f", 95 % interval {interval[0]:.1f} to {interval[1]:.1f} s" if len(g.worlds) > 1 else ""
            found.append(
                f"{g.name}, {len(g.worlds)} worlds: {m} is {abs(c.improvement_s):.1f} s "
                f"({abs(c.improvement_percent):.0f} %) {word} than {base}{bounds}; "
                f"significantly better in {c.better} worlds and worse in {c.worse} "
                f"({c.better_fdr} and {c.worse_fdr} at a false discovery rate of 5 %); success {100 * s.success:.1f} % "
                f"against {100 * b.success:.1f} %."
            )
    if not found:
        g = analysis.groups[0]
        s = g.summaries[base]
        found.append(f"{base}: mean traversal time {s.mean_time_s:.1f} s, success {100 * s.success:.1f} %.")
    return found


def _what_was_run(data: ReportData) -> Iterable[str]:
    rules = asdict(data.protocol)
    yield _table(
        "Methods",
        ("method", "policy", "fingerprint", "evaluation"),
        [
            (m.label, m.spec, m.fingerprint, str(s.evaluation.folder))
            for s in data.sources
            for m in s.evaluation.head.methods
        ],
        words=4,
    )
    done = [
        (
            str(s.evaluation.folder),
            ", ".join(f"{name} {len(g)}" for name, g in s.evaluation.head.groups.items()),
            str(s.evaluation.head.trials_per_world),
            str(s.evaluation.head.seed),
            f"{len(s.evaluation.trials):,} of {max(s.evaluation.head.trials_asked, len(s.evaluation.trials)):,}",
        )
        for s in data.sources
    ]
    yield _table("Evaluations", ("folder", "worlds", "trials a world", "seed", "trials finished"), done, words=2)
    sessions = [
        (
            str(v.get("begun", "")),
            f"{v['trials']:,}",
            f"{v['seconds']:.0f}",
            str(v["workers"]),
            f"{v['episodes_per_s']:.2f}",
            f"{v['x_real_time']:.0f}",
            _machine(v["machine"]),
            _code(v["code"]),
        )
        for s in data.sources
        for v in s.evaluation.head.sessions
    ]
    headings = ("begun", "trials", "seconds", "processes", "episodes/s", "× real time", "machine", "version")
    if sessions:
        yield _table("Sessions", headings, sessions, words=0, last_words=2)
    yield f"<details><summary>Rules of the protocol</summary><pre>{_text(json.dumps(rules, indent=1))}</pre></details>"
    for s in data.sources:
        settings = json.dumps(s.evaluation.head.settings, indent=1)
        yield (
            f"<details><summary>Configuration of {_text(str(s.evaluation.folder))}</summary>"
            f"<pre>{_text(settings)}</pre></details>"
        )


def _machine(machine: Mapping[str, Any]) -> str:
    return f"{machine.get('processor', '')}, {machine.get('cores', '?')} cores, numpy {machine.get('numpy', '')}"


def _code(code: Mapping[str, Any]) -> str:
    changed = " with changes" if code.get("changed") else ""
    return f"{code.get('version', '')} {str(code.get('commit') or '')[:10]}{changed}".strip()


def _failures(data: ReportData) -> Iterable[str]:
    failed = failed_trials(data)
    if not failed:
        yield "<p>Every trial reached the goal.</p>"
        return
    rows = []
    for t in failed[:FAILURES_LISTED]:
        evaluation, name = origin_of(data, t)
        rows.append(
            (
                f"{t.method}/{t.world}/{t.trial}",
                t.outcome,
                f"{t.time_s:.1f}",
                f"{t.distance_m:.2f}",
                str(t.collisions),
                f"{t.min_clearance_m:.3f}",
                f"appl-dist replay {evaluation.folder} '{name}' --film film.gif",
            )
        )
    more = "" if len(rows) == len(failed) else f" The first {len(rows)} are listed; trials.csv has all."
    yield f"<p>{len(failed):,} trials did not reach the goal.{more} Each can be driven again by its command.</p>"
    headings = ("trial", "outcome", "time, s", "distance, m", "collisions", "least clearance, m", "replay")
    table = _table("Failures", headings, rows, words=2, last_words=1)
    yield f"<details><summary>List of failures</summary>{table}</details>"


def _replayed(replays: Replays) -> str:
    if replays.missing:
        return f"No trial was driven again for this page: {replays.missing}."
    if not replays.count:
        return "No trial was driven again for this page."
    if replays.differences:
        return (
            f"{replays.count} trials were driven again for this page; {len(replays.differences)} of them differ from "
            f"their rows, so code or machine are not those of then: {'; '.join(replays.differences[:3])}."
        )
    return f"{replays.count} trials were driven again for this page, each bit-equal to its row."


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], words: int, last_words: int = 0) -> str:
    """A plain table; the first `words` and the last `last_words` columns hold words."""
    classes = [" class=l" if i < words or i >= len(headings) - last_words else "" for i in range(len(headings))]
    head = "".join(f"<th{c}>{_text(h)}</th>" for c, h in zip(classes, headings, strict=True))
    body = "\n".join(
        "<tr>" + "".join(f"<td{c}>{_text(v)}</td>" for c, v in zip(classes, row, strict=True)) + "</tr>" for row in rows
    )
    return (
        f"<figure class=table><figcaption><b>{_text(title)}</b></figcaption><div class=scroll>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></figure>"
    )


def _image(shown: Shown) -> str:
    data = base64.b64encode(shown.png).decode()
    return (
        f"<figure id={_text(shown.name)}><figcaption>{_text(shown.caption)}</figcaption>"
        f'<img alt="{_text(shown.caption)}" src="data:image/png;base64,{data}"></figure>'
    )


def _film(film: Film) -> str:
    data = base64.b64encode(film.gif).decode()
    return (
        f"<figure class=film id={_text(film.name)}><figcaption>{_text(film.caption)}</figcaption>"
        f'<img alt="{_text(film.caption)}" src="data:image/gif;base64,{data}"></figure>'
    )


def _text(text: str) -> str:
    return html.escape(text)
