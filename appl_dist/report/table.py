"""A table that reads the same in a terminal, in Markdown, LaTeX, HTML and CSV."""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from appl_dist.terminal import printable

Record = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A heading and how a record reads under it; the record's own values go to CSV.

    left: words, aligned left. Text in `*…*` is emphasised (bold) where the form can.
    """

    heading: str
    text: Callable[[Record], str]
    left: bool = False


@dataclass(frozen=True)
class Table:
    """name: of its file and LaTeX label. title, note: what it shows and how it was counted.

    caveats: sentences that every form carries; in CSV a column of its own, the same in every row.
    """

    name: str
    title: str
    note: str
    columns: tuple[Column, ...]
    records: tuple[Record, ...]
    caveats: tuple[str, ...] = ()

    @property
    def _below(self) -> str:
        """Note and caveats as one text."""
        return " ".join([self.note, *(["Caveats:", *self.caveats] if self.caveats else [])])

    def rich(self) -> RichTable:
        title, note = Text(printable(self.title)), Text(printable(self._below))
        view = RichTable(title=title, caption=note, box=box.SIMPLE_HEAD, caption_justify="left")
        for c in self.columns:
            view.add_column(Text(printable(c.heading)), justify="left" if c.left else "right")
        for i, record in enumerate(self.records):
            last = i + 1 < len(self.records) and self.records[i + 1].get("worlds") != record.get("worlds")
            view.add_row(*(Text(printable(_plain(c.text(record)))) for c in self.columns), end_section=last)
        return view

    def markdown(self) -> str:
        lines = [f"**{_md(self.title)}**", "", _row(_md(c.heading) for c in self.columns)]
        lines.append(_row("---" if c.left else "---:" for c in self.columns))
        for record in self.records:
            lines.append(_row(_marked(c.text(record), _md, "**", "**") for c in self.columns))
        return "\n".join([*lines, "", _md(self._below), ""])

    def latex(self) -> str:
        """A booktabs table."""
        align = "".join("l" if c.left else "r" for c in self.columns)
        head = " & ".join(_tex(c.heading) for c in self.columns)
        body = [" & ".join(_marked(c.text(r), _tex, r"\textbf{", "}") for c in self.columns) for r in self.records]
        return "\n".join(
            [
                r"\begin{table}\centering",
                rf"\caption{{{_tex(self.title)}. {_tex(self._below)}}}\label{{tab:{self.name}}}",
                rf"\begin{{tabular}}{{{align}}}\toprule",
                rf"{head} \\\midrule",
                *(rf"{row} \\" for row in body),
                r"\bottomrule\end{tabular}",
                r"\end{table}",
                "",
            ]
        )

    def html(self) -> str:
        """A figure that scrolls by itself where the page is narrower."""

        def cells(tag: str, texts: Iterable[str]) -> str:
            aligned = zip(self.columns, texts, strict=True)
            return "".join(
                f"<{tag}{' class=l' if c.left else ''}>{_marked(t, _html, '<b>', '</b>')}</{tag}>" for c, t in aligned
            )

        body = "\n".join(f"<tr>{cells('td', (c.text(r) for c in self.columns))}</tr>" for r in self.records)
        return (
            f"<figure class=table id=table-{self.name}><figcaption><b>{_html(self.title)}.</b> "
            f"{_html(self._below)}</figcaption>\n<div class=scroll><table><thead>"
            f"<tr>{cells('th', (c.heading for c in self.columns))}</tr></thead>\n<tbody>{body}</tbody></table></div>"
            "</figure>"
        )

    def csv(self) -> str:
        text = io.StringIO()
        caveats = {"caveats": " ".join(self.caveats)} if self.caveats else {}
        names = [*self.records[0], *caveats] if self.records else []
        writer = csv.DictWriter(text, names, lineterminator="\n")
        writer.writeheader()
        for record in self.records:
            writer.writerow({k: printable(v) if isinstance(v, str) else v for k, v in (record | caveats).items()})
        return text.getvalue()


_EMPHASIS = re.compile(r"\*(.*)\*", re.DOTALL)
_TEX = {c: "\\" + c for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "[": "{[}",  # at the start of a row it would be an option of the row before
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": "$-$",
    "≤": r"$\leq$",
    "ρ": r"$\rho$",
    "–": "--",
    "×": r"$\times$",
}


def _marked(text: str, escape: Callable[[str], str], before: str, after: str) -> str:
    """`text` escaped for the form; a text in `*…*` goes between `before` and `after` instead of the stars."""
    found = _EMPHASIS.fullmatch(text)
    return f"{before}{escape(found[1])}{after}" if found else escape(text)


def _plain(text: str) -> str:
    return _marked(text, str, "", "")


def _md(text: str) -> str:
    for old, new in (("\\", "\\\\"), ("|", "\\|"), ("*", "\\*"), ("`", "\\`"), ("](", "]\\("), ("<", "&lt;")):
        text = text.replace(old, new)
    return printable(text)


def _html(text: str) -> str:
    return html.escape(printable(text))


def _tex(text: str) -> str:
    return "".join(_TEX.get(c, c) for c in printable(text))


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
