"""`appl-dist worlds` from the outside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appl_dist.errors import UserError
from appl_dist.sim.generate import generate_world
from appl_dist.sim.worlds import load_worlds
from appl_dist.sim.worlds_command import save_worlds, worlds_main
from tests.unit.sim.test_worlds import world_folder


def test_generate_check_stats_draw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "made"
    assert worlds_main(["generate", str(folder), "--count", "30", "--seed", "2"]) == 0
    assert sorted(p.name for p in folder.iterdir()) == ["barn_paths.npz", "barn_worlds.npz"]
    assert worlds_main(["check", str(folder)]) == 0
    assert "30 worlds" in capsys.readouterr().out
    assert worlds_main(["stats", str(folder)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in table[1:]] == [["0", "25"], ["1", "5"], ["all", "30"]]
    out = tmp_path / "w.png"
    assert worlds_main(["draw", str(folder), "--index", "29", "--out", str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")


def test_what_the_user_gets_wrong_is_a_sentence(tmp_path: Path) -> None:
    for argv, reason in (
        (["generate", str(tmp_path), "--count", "0"], "--count and --seed: got 0"),
        (["draw", "", "--index", "-1", "--out", "x.png"], "--index and --seed: got -1"),
        (["check", str(tmp_path / "none")], "no such file"),
        (["check", str(world_folder(tmp_path / "w", ((17, 12), (16, 12))))], "1 reference path"),
        (["convert", str(tmp_path / "w"), str(tmp_path / "out")], "without a gap"),
    ):
        with pytest.raises(UserError, match=reason):
            worlds_main(argv)


def test_an_unknown_verb_is_named() -> None:
    with pytest.raises(UserError, match=r"'paint'.*choose from 'check'"):
        worlds_main(["paint"])


def test_worlds_that_are_there_are_not_replaced_unless_forced(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    worlds_main(["generate", str(folder), "--count", "3"])
    before = {file: file.read_bytes() for file in folder.iterdir()}
    for arguments in (["generate", str(folder), "--count", "2"], ["convert", str(folder), str(folder)]):
        with pytest.raises(UserError, match=r"exists; choose another folder, or replace these worlds with --force"):
            worlds_main(arguments)
    assert {file: file.read_bytes() for file in folder.iterdir()} == before
    worlds_main(["generate", str(folder), "--count", "2", "--force"])
    assert len(load_worlds(folder)) == 2


def test_the_compact_format_keeps_every_radius(tmp_path: Path) -> None:
    world = generate_world(0, 0)
    cylinders = world.cylinders.copy()
    cylinders[:3, 2] = 0.2, 0.05, 0.123
    save_worlds([replace(world, cylinders=cylinders)], tmp_path / "a")
    (found,) = load_worlds(tmp_path / "a")
    assert found.cylinders == pytest.approx(cylinders, abs=1e-6)
    cylinders[:, 2] = 0.2
    save_worlds([replace(world, cylinders=cylinders)], tmp_path / "b")
    assert set(load_worlds(tmp_path / "b")[0].cylinders[:, 2]) == {0.2}
