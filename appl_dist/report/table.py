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
    """name: of its file and LaTeX label. title, note: what it shows and how it was counted."""

    name: str
    title: str
    note: str
    columns: tuple[Column, ...]
    records: tuple[Record, ...]

    def rich(self) -> RichTable:
        view = RichTable(title=self.title, caption=self.note, box=box.SIMPLE_HEAD, caption_justify="left")
        for c in self.columns:
            view.add_column(c.heading, justify="left" if c.left else "right")
        for i, record in enumerate(self.records):
            last = i + 1 < len(self.records) and self.records[i + 1].get("worlds") != record.get("worlds")
            view.add_row(*(_plain(c.text(record)) for c in self.columns), end_section=last)
        return view

    def markdown(self) -> str:
        lines = [f"**{self.title}**", "", _row(c.heading for c in self.columns)]
        lines.append(_row("---" if c.left else "---:" for c in self.columns))
        for record in self.records:
            lines.append(_row(_bold(c.text(record).replace("|", "\\|"), "**", "**") for c in self.columns))
        return "\n".join([*lines, "", self.note, ""])

    def latex(self) -> str:
        """A booktabs table."""
        align = "".join("l" if c.left else "r" for c in self.columns)
        head = " & ".join(_tex(c.heading) for c in self.columns)
        body = [" & ".join(_bold(_tex(c.text(r)), r"\textbf{", "}") for c in self.columns) for r in self.records]
        return "\n".join(
            [
                r"\begin{table}\centering",
                rf"\caption{{{_tex(self.title)}. {_tex(self.note)}}}\label{{tab:{self.name}}}",
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
                f"<{tag}{' class=l' if c.left else ''}>{_bold(html.escape(t), '<b>', '</b>')}</{tag}>"
                for c, t in aligned
            )

        body = "\n".join(f"<tr>{cells('td', (c.text(r) for c in self.columns))}</tr>" for r in self.records)
        return (
            f"<figure class=table id=table-{self.name}><figcaption><b>{html.escape(self.title)}.</b> "
            f"{html.escape(self.note)}</figcaption>\n<div class=scroll><table><thead>"
            f"<tr>{cells('th', (c.heading for c in self.columns))}</tr></thead>\n<tbody>{body}</tbody></table></div>"
            "</figure>"
        )

    def csv(self) -> str:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(self.records[0]) if self.records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.records)
        return text.getvalue()


_EMPHASIS = re.compile(r"^\*(.*)\*$")
_TEX = {c: "\\" + c for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": "$-$",
    "≤": r"$\leq$",
    "ρ": r"$\rho$",
    "–": "--",
    "×": r"$\times$",
}


def _bold(text: str, before: str, after: str) -> str:
    return _EMPHASIS.sub(lambda m: f"{before}{m[1]}{after}", text)


def _plain(text: str) -> str:
    return _bold(text, "", "")


def _tex(text: str) -> str:
    return "".join(_TEX.get(c, c) for c in text)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
