"""The worlds of a run: real or generated, and which of them train and which test."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from appl_dist.errors import UserError
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.worlds import World, load_worlds

SPLIT_FILE = "applr_split.json"
# APPLR's 50 test worlds of BARN's 300 (Xu et al., ICRA 2021; the authors' `condor_config.worlds`). The others train.
APPLR_TEST = (
    0, 8, 17, 19, 27, 32, 41, 47, 48, 57, 64, 69, 76, 78, 88, 93, 100, 104, 112, 118, 123, 129, 133, 138, 144, 150, 159,
    163, 168, 175, 184, 189, 193, 201, 208, 214, 218, 226, 229, 237, 240, 246, 256, 258, 265, 270, 277, 284, 290, 294,
)  # fmt: skip
BARN_DIGEST = "caa5d70e849c6331"  # of BARN's 300 worlds, see `_set_digest`
TEST_EVERY = 6  # of generated worlds, and of sets of another size: 0, 6, 12, … test and the others train


def select_worlds(path: str, count: int, seed: int, split: str) -> list[World]:
    """Worlds of `split` from `path`, or of `count` generated ones where `path` is "".

    split: "train", "test", "all", or indices and Python-like ranges: "0,6,12", "0:50", "0:300:6". Raises UserError.
    """
    worlds = {w.index: w for w in all_worlds(path, count, seed)}
    if split == "all":
        return list(worlds.values())
    if split in ("train", "test"):
        test = test_indices(path, list(worlds.values()))
        indices = [i for i in worlds if (i in test) == (split == "test")]
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


@functools.lru_cache(maxsize=2)
def all_worlds(path: str, count: int, seed: int) -> tuple[World, ...]:
    """Every world under `path`, or `count` generated ones where it is "": read once by a process."""
    return tuple(load_worlds(path) if path else generate_worlds(count, seed))


def test_indices(path: str, worlds: Sequence[World]) -> set[int]:
    """Which worlds of a whole set are its test worlds.

    Those that a split file beside the worlds names; of BARN's 300, recognised by what stands in them, APPLR's 50; else
    every TEST_EVERYth.
    """
    named = _split_file(Path(path)) if path else None
    if named is not None:
        return named
    if path and _set_digest(worlds) == BARN_DIGEST:
        return set(APPLR_TEST)
    return {w.index for w in worlds if w.index % TEST_EVERY == 0}


def _set_digest(worlds: Sequence[World]) -> str:
    """A digest of indices and cylinders, rounded to 0.1 mm: the same for every format that BARN comes in."""
    digest = hashlib.sha256()
    for world in worlds:
        rounded = np.round(world.cylinders[np.lexsort(world.cylinders.T)] * 1e4).astype("<i8")
        digest.update(f"{world.index}:".encode() + rounded.tobytes())
    return digest.hexdigest()[:16]


def split_groups(path: str, everything: Sequence[World], indices: Sequence[int]) -> dict[str, list[int]]:
    """Indices by the split they belong to, as the papers' tables report them; empty splits are left out.

    everything: the whole set.
    """
    test = test_indices(path, everything)
    groups = {"train": [i for i in indices if i not in test], "test": [i for i in indices if i in test]}
    return {name: chosen for name, chosen in groups.items() if chosen}


def _split_file(path: Path) -> set[int] | None:
    """The test worlds that SPLIT_FILE beside the worlds names, None without one."""
    file = (path if path.is_dir() else path.parent) / SPLIT_FILE
    if not file.is_file():
        return None
    try:
        return {int(i) for i in json.loads(file.read_text("utf-8"))["heldout"]}
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file}: expected a list 'heldout' of world indices; {error}") from None


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
