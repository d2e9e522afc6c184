"""The import rules of docs/architecture.md, read from the source."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "appl_dist"
MODULES = sorted(PACKAGE.rglob("*.py"))


def imports(path: Path) -> set[str]:
    """Dotted names a module imports when it runs; imports only for type checking do not count."""
    tree = ast.parse(path.read_text())
    typing_only = {
        id(n)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for n in ast.walk(node)
    }
    found: set[str] = set()
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def users(name: str) -> set[str]:
    """Modules (relative, posix) that import `name` or anything below it."""
    return {
        m.relative_to(PACKAGE).as_posix()
        for m in MODULES
        if any(i == name or i.startswith(name + ".") for i in imports(m))
    }


@pytest.mark.parametrize(
    ("library", "allowed"),
    [
        ("torch", ("learner/",)),
        ("zenoh", ("wire/",)),
        ("pybullet", ("sim/bullet.py",)),
        ("hydra", ("__main__.py", "config", "launch/")),
        ("omegaconf", ("__main__.py", "config", "launch/")),
    ],
)
def test_a_library_stays_in_its_place(library: str, allowed: tuple[str, ...]) -> None:
    found = users(library)
    assert found, f"nothing imports {library}: the rule checks nothing"
    assert {m for m in found if not m.startswith(allowed)} == set()


@pytest.mark.parametrize(
    ("part", "never"),
    [
        ("sim", ("planner", "policy", "actor", "learner", "wire", "evaluate", "report", "launch", "config")),
        ("planner", ("sim", "policy", "actor", "learner", "wire", "evaluate", "report", "launch", "config")),
        ("policy", ("sim", "planner", "actor", "learner", "wire", "evaluate", "report", "launch", "config")),
        ("wire", ("sim", "planner", "actor.env", "learner", "evaluate", "report", "launch", "config")),
        ("learner", ("sim", "planner", "policy", "actor", "evaluate", "report", "launch", "config")),
        ("actor", ("learner", "evaluate", "report", "launch", "config")),
        ("evaluate", ("learner", "wire", "launch", "config", "report")),
        ("report", ("learner", "wire", "launch", "config")),
    ],
)
def test_dependencies_point_one_way(part: str, never: tuple[str, ...]) -> None:
    modules = [m for m in MODULES if m.relative_to(PACKAGE).parts[0] == part and m.name != "__init__.py"]
    assert modules
    wrong = {
        (m.relative_to(PACKAGE).as_posix(), i)
        for m in modules
        for i in imports(m)
        for n in never
        if i == f"appl_dist.{n}" or i.startswith(f"appl_dist.{n}.")
    }
    assert wrong == set()


def test_policies_need_numpy_the_c_core_and_layouts_alone() -> None:
    allowed = tuple(f"appl_dist.{m}" for m in ("policy", "policy_file", "spec", "errors", "registry", "_native"))
    modules = list((PACKAGE / "policy").glob("*.py"))
    assert len(modules) > 1
    ours = {i for m in modules for i in imports(m) if i.split(".")[0] == "appl_dist"}
    assert {i for i in ours if not any(i == a or i.startswith(a + ".") for a in allowed)} == set()
    others = {i.split(".")[0] for m in modules for i in imports(m)} - {"appl_dist", "numpy"}
    assert others <= sys.stdlib_module_names


@pytest.mark.parametrize("leaf", ["spec.py", "errors.py"])
def test_leaves_import_nothing_of_ours(leaf: str) -> None:
    assert not {i for i in imports(PACKAGE / leaf) if i.startswith("appl_dist")}


def test_an_actor_starts_without_torch_or_plotting() -> None:
    code = (
        "import sys, appl_dist.launch.roles, appl_dist.actor.collect, appl_dist.config;"
        "print([m for m in ('torch', 'matplotlib', 'scipy', 'tensorboard') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
