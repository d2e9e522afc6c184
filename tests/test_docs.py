"""The Markdown pages: the tree of docs/architecture.md names what exists, lines are short, links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "appl_dist"
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "benchmarks/README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]
MAX_COLUMNS = 120


def tree() -> dict[str, list[str]]:
    """Package ("" for the root) to the modules that docs/architecture.md lists in it."""
    text = (ROOT / "docs/architecture.md").read_text().partition("## Tree")[2].split("```")[1]
    lines = text.partition("appl_dist/\n")[2].partition("\nconf/")[0].splitlines()
    found: dict[str, list[str]] = {}
    package = ""
    for line in lines:
        entry = re.match(r"  (\w+)/", line)
        package = entry[1] if entry else package
        found.setdefault(package, []).extend(re.findall(r"\w+\.py\b", line))
    return found


def test_the_tree_names_every_package_and_only_modules_that_exist() -> None:
    listed = tree()
    packages = {path.parent.relative_to(PACKAGE).as_posix() for path in PACKAGE.glob("*/__init__.py")}
    assert packages
    assert packages <= set(listed)
    files = [PACKAGE / package / module for package, modules in listed.items() for module in modules]
    assert [file for file in files if not file.is_file()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_lines_are_short_outside_tables(page: Path) -> None:
    lines = page.read_text().splitlines()
    assert [n for n, line in enumerate(lines, 1) if len(line) > MAX_COLUMNS and not line.startswith("|")] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_between_pages_lead_to_files_and_headings(page: Path) -> None:
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", page.read_text()):
        file = page.parent / target if target else page
        assert file.exists(), target
        headings = re.findall(r"^#+ (.*)", file.read_text(), re.MULTILINE) if anchor else []
        slugs = {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}
        assert not anchor or anchor in slugs, f"{target}#{anchor}"


def test_benchmark_commands_name_scripts_that_exist() -> None:
    text = (ROOT / "benchmarks/README.md").read_text()
    scripts = re.findall(r"python (benchmarks/\w+\.py)", text)
    modules = re.findall(r"python -m (benchmarks\.\w+)", text)
    assert scripts
    assert modules
    assert [s for s in {*scripts, *(m.replace(".", "/") + ".py" for m in modules)} if not (ROOT / s).is_file()] == []
