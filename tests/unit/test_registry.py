from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from appl_dist.errors import UserError
from appl_dist.registry import Registry


def test_a_name_gives_its_entry_and_an_unknown_one_lists_the_known() -> None:
    colours = Registry("colour", {"red": 1})
    colours.register("sea-green", 2)
    assert colours.get("sea-green") == 2
    assert colours.names() == ["red", "sea-green"]
    with pytest.raises(UserError, match=r"^colour: got 'blue'; allowed red, sea-green$"):
        colours.get("blue")


@pytest.mark.parametrize(
    ("name", "reason"), [("red", "taken"), ("", "letters"), ("a:b", "letters"), ("a/b", "letters")]
)
def test_a_name_is_taken_once_and_is_a_plain_word(name: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Registry("colour", {"red": 1}).register(name, 2)


def plugin(folder: Path, source: str) -> str:
    """An installed package whose entry point is imported; what a fresh process makes of the policy `mine:0.7`."""
    (folder / "mine.py").write_text(source)
    info = folder / "mine-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[appl_dist]\nmine = mine\n")
    code = f"""import sys; sys.path.insert(0, {str(folder)!r})
from appl_dist.errors import UserError
from appl_dist.planner.dwa import DWA
from appl_dist.policy.load import load_policy
from appl_dist.policy.observation import layout_of
try:
    print(load_policy("mine:0.7", DWA, layout_of("paper", 720, DWA)).values[0])
except UserError as error:
    print(error)"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_the_snippets_of_the_documentation_run() -> None:
    """Every kind of thing that the page registers is chosen by a configuration and drives."""
    page = (Path(__file__).parents[2] / "docs" / "extending.md").read_text()
    check = """
from appl_dist.config import load
from appl_dist.launch.environment import environment_arguments, worlds_of
from appl_dist.actor.env import NavigationEnv
from appl_dist.policy.load import load_policy
s = load(["world.count=1", "world.train=all", "world.test=all", "evaluation.training_worlds=true", "planner=straight",
          "env.space=straight", "robot=loaded", "observation=short", "reward=sparse", "protocol=patient"])
env = NavigationEnv(worlds_of(s, "all"), protocol=s.protocol, **environment_arguments(s))
first, _ = env.reset(seed=0)
layout = env.observation_builder.layout
second, reward, *_, info = env.step(env.space.to_action([1.0]))
print(layout.name, first.shape == (layout.size,), len(env.space), reward, s.protocol.limit_s)
print(round(float(env.loop.trajectory[-1, 4]), 1), info["distance_m"] > 1.0, float(second[:720].max()))
print(load_policy("fast:1.5", PLANNERS.get("dwa").space("dwa"), layout).values[0])
"""
    code = "".join(block.split("```")[0] for block in page.split("```python")[1:]) + check
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert out.stdout.splitlines() == ["short True 1 -1.0 100.0", "1.0 True 1.0", "1.5"], out.stderr


def test_an_installed_package_adds_a_policy(tmp_path: Path) -> None:
    source = """from appl_dist.policy.fixed import given_set
from appl_dist.policy.load import POLICIES
POLICIES.register("mine", lambda text, space: given_set(f"max_vel_x={text}", space))
"""
    assert plugin(tmp_path, source) == "0.7"


def test_a_broken_package_is_named(tmp_path: Path) -> None:
    assert plugin(tmp_path, "1 / 0") == "entry point mine = mine: cannot be loaded: division by zero"
