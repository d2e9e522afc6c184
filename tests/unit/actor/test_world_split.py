"""Which worlds train and which test, wherever the files lie."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from appl_dist.actor.world_split import APPLR_TEST, all_worlds, select_worlds, split_groups
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.worlds_command import save_worlds
from tests.shared_data import shared


@pytest.fixture(scope="module")
def barn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real worlds, without the split file beside them."""
    folder = tmp_path_factory.mktemp("barn")
    for name in ("barn_worlds.npz", "barn_paths.npz"):
        shutil.copy(shared("barn", name), folder)
    return folder


def test_of_barns_300_worlds_applrs_50_test_without_any_file(barn: Path) -> None:
    assert [w.index for w in select_worlds(str(barn), 0, 0, "test")] == list(APPLR_TEST)
    train = [w.index for w in select_worlds(str(barn), 0, 0, "train")]
    assert sorted({*train, *APPLR_TEST}) == list(range(300)) and len(train) == 250
    everything = all_worlds(str(barn), 0, 0)
    assert split_groups(str(barn), everything, [0, 1, 6, 8]) == {"train": [1, 6], "test": [0, 8]}


def test_saved_worlds_have_the_split_they_were_generated_with(tmp_path: Path) -> None:
    save_worlds(generate_worlds(14, 0), tmp_path / "set")
    for split in ("train", "test"):
        saved = [w.index for w in select_worlds(str(tmp_path / "set"), 0, 0, split)]
        assert saved == [w.index for w in select_worlds("", 14, 0, split)]


def test_the_shipped_split_is_the_published_one() -> None:
    published = json.loads(shared("barn", "applr_split.json").read_text())
    assert sorted(published["heldout"]) == list(APPLR_TEST)


def test_generated_worlds_have_a_split_of_their_own() -> None:
    assert [w.index for w in select_worlds("", 14, 0, "test")] == [0, 6, 12]


def test_a_split_file_beside_the_worlds_counts(barn: Path) -> None:
    (barn / "applr_split.json").write_text('{"heldout": [2, 3]}')
    try:
        assert [w.index for w in select_worlds(str(barn), 0, 0, "test")] == [2, 3]
    finally:
        (barn / "applr_split.json").unlink()
