"""What names of people's own do to a table: nothing, in any of its forms."""

from __future__ import annotations

import csv
import html.parser
import io
import re

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from appl_dist.report.table import Column, Table
from appl_dist.terminal import printable

NASTY = st.one_of(
    st.sampled_from(
        ["x[/y]", "[bold]", "<script>alert(1)</script>", "a|b", "50 % & more", "_x_", "{0}", "a\nb", "\x1b[2J", "[1] x",
         "$x^2$", "`code`", "[text](http://x)", "**", "*", "\\", "\\textbf{x}", "'\"", "=1+1"],
    ),
    st.text(max_size=30),
)  # fmt: skip


def table(name: str) -> Table:
    columns = (Column(name, lambda r: r["method"], left=True), Column("time", lambda r: f"*{r['method']}*"))
    return Table("t", f"Of {name}", f"note {name}", columns, ({"method": name},))


@given(NASTY)
def test_a_name_reads_as_it_is_in_a_terminal(name: str) -> None:
    out = io.StringIO()
    Console(file=out, width=2000, force_terminal=True, color_system=None).print(table(name).rich())
    text = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())  # rich's own styles
    assert "\x1b" not in text
    if name.isprintable() and name.strip() and len(name.split()) == 1:
        assert name in text


@given(NASTY)
def test_markdown_keeps_its_columns_and_holds_no_html(name: str) -> None:
    lines = table(name).markdown().splitlines()
    rows = [line for line in lines if line.startswith("| ")]
    assert len(rows) == 3
    for row in rows:
        bars = re.findall(r"(?<!\\)(?:\\\\)*\|", row)
        assert len(bars) == 3, row
    assert "<" not in "".join(lines)


@given(NASTY)
def test_latex_has_balanced_braces_and_no_bare_specials(name: str) -> None:
    text = table(name).latex()
    bare = re.sub(r"\\[&%$#_{}]", "", text)
    assert bare.count("{") == bare.count("}")
    body = bare.split(r"\midrule")[1].split(r"\bottomrule")[0]
    assert "%" not in body and "#" not in body and "_" not in body
    assert body.count("&") == 1
    assert not any(line.startswith("[") for line in body.splitlines())


class Tags(html.parser.HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.seen.add(tag)


@given(NASTY)
def test_html_holds_only_the_tables_own_tags(name: str) -> None:
    tags = Tags()
    tags.feed(table(name).html())
    assert tags.seen <= {"figure", "figcaption", "b", "div", "table", "thead", "tbody", "tr", "th", "td"}


@given(NASTY)
def test_csv_gives_the_name_back(name: str) -> None:
    (row,) = csv.DictReader(io.StringIO(table(name).csv(), newline=""))
    assert row["method"] == printable(name)
