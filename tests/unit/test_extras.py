"""What is imported is declared: third-party imports are in the dependencies and extras a part is installed with."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

from appl_dist.config import load
from appl_dist.errors import UserError
from appl_dist.launch.evaluation import evaluate
from appl_dist.launch.local import train

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULES = {"eclipse-zenoh": "zenoh", "hydra-core": "hydra", "pillow": "PIL"}  # where it is not the package's name
WITH = {"hydra-core": {"omegaconf"}}  # modules of packages that a dependency brings


def modules(requirements: list[str]) -> set[str]:
    names = [re.split(r"[\[<>=!~;]", r)[0].strip().lower() for r in requirements]
    return {MODULES.get(n, n) for n in names}.union(*(WITH.get(n, set()) for n in names))


BASE = modules(PROJECT["dependencies"])
EXTRAS = {name: modules(requirements) for name, requirements in PROJECT["optional-dependencies"].items()}


def imported(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {a.name.partition(".")[0] for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return found - sys.stdlib_module_names - {"appl_dist"}


def test_train_and_evaluate_say_at_the_start_that_the_statistics_are_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    monkeypatch.chdir(tmp_path)
    for command in (train, evaluate):
        with pytest.raises(UserError, match="need scipy, which is not installed"):
            command(load([]))
    assert not list(tmp_path.iterdir())


# `train` ends with an evaluation, so the statistics must be there with the learner's extra as well.
PARTS = {
    "learner": (BASE | EXTRAS["learner"], "learner/**/*.py"),
    "evaluate, with the learner's extra": (BASE | EXTRAS["learner"], "evaluate/**/*.py"),
    "evaluate": (BASE | EXTRAS["evaluate"], "evaluate/**/*.py"),
    "report": (BASE | EXTRAS["evaluate"], "report/**/*.py"),
    "worlds show": (BASE | EXTRAS["evaluate"], "sim/worlds_command.py"),
}


@pytest.mark.parametrize("part", PARTS)
def test_extras_cover_the_imports(part: str) -> None:
    allowed, files = PARTS[part]
    found = list((ROOT / "appl_dist").glob(files))
    assert found
    for file in found:
        assert imported(file) <= allowed, file


def test_everything_else_needs_the_dependencies_alone() -> None:
    optional = {f for _, files in PARTS.values() for f in (ROOT / "appl_dist").glob(files)}
    for file in sorted(set((ROOT / "appl_dist").rglob("*.py")) - optional):
        assert imported(file) <= BASE, file
