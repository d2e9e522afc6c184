"""`appl-dist conformance FILE… [--arithmetic fast]`: replay recorded vectors of the real ROS code, count what is equal.

Kinds are told by content: trajectory scenes (tp.jsonl[.gz]), their grids (tp_grids.npz, needs the scenes
beside it), inflation.npz, navfn.npz, closed-loop episodes (sim.jsonl[.gz], with sim_full.npz beside it if
there). Exit status 0: everything equal; 1: something differs; 2: a file that cannot be used. With fast arithmetic the
commands of closed loops are compared from recorded poses, and status 0 means that at least 99 % of commands are equal.
"""

from __future__ import annotations

import gzip
import json
import typing
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from appl_dist.arguments import ArgumentParser
from appl_dist.errors import UserError
from appl_dist.planner import vector_episodes, vectors
from appl_dist.planner.planner_settings import Arithmetic
from appl_dist.planner.vectors import Record, Tally

KINDS = "tp.jsonl.gz, tp_grids.npz, inflation.npz, navfn.npz or sim.jsonl.gz"
LEAST_FAST = 0.99  # of the commands, with fast arithmetic
_BROKEN = (OSError, EOFError, ValueError, KeyError, IndexError, TypeError, zlib.error, zipfile.BadZipFile)


def main(arguments: list[str]) -> int:
    """Check every file and print its counts; the exit status."""
    parser = ArgumentParser(prog="appl-dist conformance", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--arithmetic", choices=typing.get_args(Arithmetic), default="exact")
    options = parser.parse_args(arguments)
    return max(_check(path, options.arithmetic) for path in options.files)


def _check(path: Path, arithmetic: Arithmetic) -> int:
    if not path.is_file():
        raise UserError(f"{path}: no such file; expected {KINDS}")
    try:
        tallies = list(_tallies(path, arithmetic))
    except _BROKEN as error:
        raise UserError(f"{path}: broken or not a vector file ({type(error).__name__}: {error})") from error
    if not any(t.total for t in tallies):
        raise UserError(f"{path}: holds nothing to compare")
    print(f"{path.name}")
    for t in tallies:
        unit = f" {t.unit}" if t.unit and t.difference else ""
        print(f"  {t.equal} of {t.total} {t.what} equal, largest difference {t.difference:.3g}{unit}")
    if arithmetic == "fast":
        return 0 if all(t.equal >= LEAST_FAST * t.total for t in tallies if t.what.startswith("commands")) else 1
    return 0 if all(t.equal == t.total for t in tallies) else 1


def _tallies(path: Path, arithmetic: Arithmetic) -> Iterator[Tally]:
    with path.open("rb") as file:
        magic = file.read(2)
    if magic == b"PK":
        with np.load(path, allow_pickle=False) as data:
            yield from _npz_tallies(path, data, arithmetic)
        return
    records = _records(path)
    first = next(records, None)
    if not isinstance(first, dict):
        raise UserError(f"{path}: not a vector file; expected {KINDS}")
    everything = _chain(first, records)
    scene = first.get("scene")
    if isinstance(scene, dict) and "lethal" in scene and "out_cells" in first:
        yield from vectors.trajectory_scenes(everything)
    elif isinstance(first.get("episode"), dict) and "cyl" in first["episode"] and "out" in first:
        if arithmetic == "fast":
            yield from vector_episodes.episode_commands(everything, arithmetic)
        else:
            yield from _episodes(path, everything)
    elif isinstance(scene, dict) and "dwa_params" in scene:
        raise UserError(f"{path}: scenes of dwa_local_planner, which is not a supported planner yet")
    else:
        raise UserError(f"{path}: unknown kind of vectors; expected {KINDS}")


def _npz_tallies(path: Path, data: Any, arithmetic: Arithmetic) -> Iterator[Tally]:
    names = set(data.files)
    if {"path_grid", "goal_grid", "id"} <= names:
        scenes = _beside(path, "tp_grids", "tp", ".jsonl.gz", ".jsonl")
        if scenes is None:
            raise UserError(f"{path}: wants the scenes it belongs to, tp.jsonl.gz, beside it")
        yield from vectors.wavefront_grids(data, {r["scene"]["id"]: r for r in _records(scenes)})
    elif {"lethal", "costmap", "inflation_radius", "inscribed_radius"} <= names:
        yield from vectors.inflated_maps(data)
    elif {"plan_xy", "plan_len", "lethal_flat", "start", "goal"} <= names:
        yield from vectors.global_plans(data, arithmetic)
    elif any(n.startswith("scan_") for n in names):
        episodes = _beside(path, "sim_full", "sim", ".jsonl.gz", ".jsonl")
        if episodes is None:
            raise UserError(f"{path}: wants the episodes it belongs to, sim.jsonl.gz, beside it")
        with_scans = (r for r in _records(episodes) if f"scan_{r['episode']['id']}" in names)
        if arithmetic == "fast":
            yield from vector_episodes.episode_commands(with_scans, arithmetic)
        else:
            yield from vector_episodes.episodes(with_scans, data)
    else:
        raise UserError(f"{path}: unknown kind of vectors; expected {KINDS}")


def _episodes(path: Path, records: Iterator[Record]) -> Iterator[Tally]:
    full = _beside(path, "sim", "sim_full", ".npz")
    if full is None:
        yield from vector_episodes.episodes(records, None)
        return
    with np.load(full, allow_pickle=False) as data:
        yield from vector_episodes.episodes(records, data)


def _records(path: Path) -> Iterator[Record]:
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    with gzip.open(path, "rt") if packed else path.open("rt") as lines:
        for number, line in enumerate(lines, 1):
            try:
                yield json.loads(line)
            except json.JSONDecodeError as error:
                raise UserError(f"{path}: line {number} is not JSON ({error.msg}); expected {KINDS}") from error


def _chain(first: Record, rest: Iterator[Record]) -> Iterator[Record]:
    yield first
    yield from rest


def _beside(path: Path, own: str, other: str, *endings: str) -> Path | None:
    """The file that goes with `path`: same folder, name with `own` replaced by `other`."""
    stem = path.name.removesuffix(".gz").removesuffix(".jsonl").removesuffix(".npz")
    for ending in endings:
        candidate = path.with_name(stem.replace(own, other, 1) + ending)
        if candidate != path and candidate.is_file():
            return candidate
    return None
