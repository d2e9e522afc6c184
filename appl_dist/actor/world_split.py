"""The worlds of a run: real or generated, and which of them train and which test."""

from __future__ import annotations

import json
from pathlib import Path

from appl_dist.errors import UserError
from appl_dist.sim.generator import generate_worlds
from appl_dist.sim.worlds import World, load_worlds

SPLIT_FILE = "applr_split.json"
TEST_EVERY = 6  # without a split file worlds 0, 6, 12, … test and the others train: 50 and 250 of 300


def select_worlds(path: str, count: int, seed: int, split: str) -> list[World]:
    """Worlds of `split` from `path`, or of `count` generated ones where `path` is "".

    split: "train", "test", "all", or indices and Python-like ranges: "0,6,12", "0:50", "0:300:6". Raises UserError.
    """
    worlds = {w.index: w for w in (load_worlds(path) if path else generate_worlds(count, seed))}
    if split == "all":
        return list(worlds.values())
    if split in ("train", "test"):
        indices = _published_split(Path(path), split) if path else None
        if indices is None:
            indices = [i for i in worlds if (i % TEST_EVERY == 0) == (split == "test")]
    else:
        indices = _parse(split)
    missing = [i for i in indices if i not in worlds]
    if missing:
        raise UserError(
            f"worlds {split!r}: got index {missing[0]}; {path or 'the generated set'} has {len(worlds)} worlds, "
            f"{min(worlds)}..{max(worlds)}"
        )
    if not indices:
        raise UserError(f"worlds {split!r}: selects no world of {len(worlds)}")
    return [worlds[i] for i in indices]


def split_groups(path: str, indices: list[int]) -> dict[str, list[int]]:
    """World indices by the split they belong to, as the papers' tables report them; empty splits are left out."""
    test = set((_published_split(Path(path), "test") if path else None) or [i for i in indices if i % TEST_EVERY == 0])
    groups = {"train": [i for i in indices if i not in test], "test": [i for i in indices if i in test]}
    return {name: chosen for name, chosen in groups.items() if chosen}


def _published_split(path: Path, split: str) -> list[int] | None:
    file = (path if path.is_dir() else path.parent) / SPLIT_FILE
    if not file.is_file():
        return None
    try:
        found = json.loads(file.read_text("utf-8"))["heldout" if split == "test" else split]
        return [int(i) for i in found]
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file}: expected lists 'train' and 'heldout' of world indices; {error}") from None


def _parse(split: str) -> list[int]:
    indices: list[int] = []
    for part in split.split(","):
        try:
            numbers = [int(n) for n in part.split(":")]
        except ValueError:
            numbers = []
        if len(numbers) == 1:
            indices += numbers
        elif len(numbers) in (2, 3) and all(n >= 0 for n in numbers[:2]) and numbers[-1] > 0:
            indices += range(*numbers)
        else:
            raise UserError(
                f"worlds {split!r}: got {part!r}; expected train, test, all, an index, or start:stop[:step]"
            )
    return list(dict.fromkeys(indices))
