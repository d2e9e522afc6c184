"""BARN worlds: upright cylinders and a reference path, read from the authors' files or the compact export.

Frames: the Gazebo world frame of BARN, metres, x right, y forward (a robot drives from (-2, 3) to (-2, 13)).
The field is a grid of 30 x 30 cells of 0.15 m; row r lies at x = -4.425 + 0.15 r, column c at
y = 5.175 + 0.15 c, and a filled cell is a cylinder of radius 0.075 m. Source: Perille et al., "Benchmarking
Metric Ground Navigation", SSRR 2020.
"""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError
from appl_dist.sim.difficulty import GRID, Grid, difficulty, fill_interior
from appl_dist.sim.sdf import parse_sdf

Floats = NDArray[np.float64]

CELL_M = 0.15
RADIUS_M = 0.075
FIELD_ORIGIN = np.array([-4.425, 5.175])  # x, y of cell (row 0, column 0)
# run.py and ros_jackal place the reference path this far from the real cylinders; kept for the optimal time.
OFFICIAL_SHIFT = np.array([-0.15, -0.10])
WORLDS_PER_SET = 25
SETS = 12  # 4 fill fractions x 3 numbers of smoothing passes
MAX_FILE_BYTES = 8 << 20


@dataclass(frozen=True)
class World:
    """One course: what stands in it, how one may pass, and how hard it is."""

    index: int
    name: str
    cylinders: Floats  # (n, 3) x, y, radius, m, world frame
    path: Floats  # (m, 2) x, y of the reference path, aligned with the cylinders
    path_official: Floats  # (m, 2) the same as the official scripts place it
    metrics: Floats  # (5,) closest obstacle, visibility, dispersion, characteristic dimension, tortuosity
    set_index: int  # 0..11: 3 * fill + smoothing

    @property
    def density(self) -> float:
        """Share of filled cells in the field, its two side walls left out."""
        return float(field_grid(self.cylinders)[1:-1].mean())


def course_of(world: World) -> str:
    """Fingerprint of a world's geometry: equal for equal courses, wherever they were loaded from."""
    digest = hashlib.sha256(world.cylinders.tobytes())
    digest.update(world.path_official.tobytes())
    return digest.hexdigest()[:8]


def path_frames(cells: NDArray[np.integer]) -> tuple[Floats, Floats]:
    """Aligned and official (m, 2) x, y of a path given as (m, 2) row, column."""
    aligned = np.round(FIELD_ORIGIN + CELL_M * cells.astype(np.float64), 6)
    return aligned, np.round(aligned + OFFICIAL_SHIFT, 6)


def path_cells(path: Floats) -> NDArray[np.int64]:
    """(m, 2) row, column of an aligned path."""
    return np.rint((path - FIELD_ORIGIN) / CELL_M).astype(np.int64)


def field_grid(cylinders: Floats) -> NDArray[np.bool_]:
    """(30, 30) occupancy of the field: the cells with a cylinder and the interior of solid blocks."""
    cells = np.rint((cylinders[:, :2] - FIELD_ORIGIN) / CELL_M).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < GRID)).all(axis=1)]
    grid = np.zeros((GRID, GRID), np.bool_)
    grid[cells[:, 0], cells[:, 1]] = True
    return fill_interior(grid)


def make_world(index: int, name: str, cylinders: Floats, cells: NDArray[np.integer], grid: Grid | None = None) -> World:
    """A world from its cylinders and the (m, 2) row, column of its path; metrics are computed.

    grid: (30, 30) occupancy where it is known, else it is read off the cylinders.
    """
    aligned, official = path_frames(cells)
    for array in (cylinders, aligned, official):
        array.setflags(write=False)
    metrics = difficulty(field_grid(cylinders) if grid is None else grid, cells.astype(np.int64))
    set_index = index // WORLDS_PER_SET % SETS
    return World(index, name, cylinders, aligned, official, metrics, set_index)


def load_worlds(path: str | Path) -> list[World]:
    """All worlds under `path`, by index.

    `path` is a folder with barn_worlds.npz and barn_paths.npz, or that barn_worlds.npz itself, or a folder or a
    tar archive with the authors' world_<i>.world and path_files/path_<i>.npy. Raises UserError naming the file
    and the line or key that cannot be.
    """
    path = Path(path)
    if path.is_dir():
        if (path / "barn_worlds.npz").is_file():
            return _load_compact(path / "barn_worlds.npz")
        return _load_sdf(path, _folder_files(path))
    if path.suffix == ".npz" and path.is_file():
        return _load_compact(path)
    if path.is_file():
        if not tarfile.is_tarfile(path):
            raise UserError(f"{path}: not a world file set; give a folder, a tar archive or barn_worlds.npz")
        return _load_sdf(path, _archive_files(path))
    raise UserError(f"{path}: no such file or folder; give a folder of .world files, a tar archive or barn_worlds.npz")


# The authors' SDF files


def _folder_files(folder: Path) -> Iterator[tuple[str, bytes]]:
    for file in sorted(folder.rglob("*")):
        if file.is_file() and file.suffix in (".world", ".npy"):
            yield str(file.relative_to(folder)), file.read_bytes()


def _archive_files(archive: Path) -> Iterator[tuple[str, bytes]]:
    """Members are read in memory and only their base names matter: an archive cannot name a place to write."""
    try:
        with tarfile.open(archive) as tar:
            for member in tar:
                if not member.isfile() or not member.name.endswith((".world", ".npy")):
                    continue
                if member.size > MAX_FILE_BYTES:
                    raise UserError(f"{archive}: {member.name} has {member.size} bytes; allowed {MAX_FILE_BYTES}")
                data = tar.extractfile(member)
                assert data is not None
                yield member.name, data.read()
    except (tarfile.TarError, EOFError, OSError) as error:
        raise UserError(f"{archive}: damaged archive ({error})") from error


def _load_sdf(source: Path, files: Iterator[tuple[str, bytes]]) -> list[World]:
    cylinders: dict[int, Floats] = {}
    cells: dict[int, NDArray[np.integer]] = {}
    for name, data in files:
        world = re.search(r"(?:^|/)world_(\d+)\.world$", name)
        route = re.search(r"(?:^|/)path_(\d+)\.npy$", name)
        if world:
            if int(world[1]) in cylinders:
                raise UserError(f"{source}: {name}: a second world {int(world[1])}; give each its own index")
            cylinders[int(world[1])] = parse_sdf(data, f"{source}: {name}")
        elif name.endswith(".world"):
            raise UserError(f"{source}: {name}: has no index; name it world_<i>.world, or remove it")
        elif route:
            cells[int(route[1])] = _read_path(data, f"{source}: {name}")
    if not cylinders:
        raise UserError(f"{source}: holds no world_<i>.world file")
    if missing := sorted(set(cylinders) - set(cells)):
        raise UserError(f"{source}: world_{missing[0]}.world has no path_files/path_{missing[0]}.npy")
    return [make_world(i, f"world_{i}", cylinders[i], cells[i]) for i in sorted(cylinders)]


def _read_path(data: bytes, where: str) -> NDArray[np.integer]:
    try:
        cells = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise UserError(f"{where}: not a numpy array ({error})") from error
    return _check_cells(cells, where)


def _check_cells(cells: NDArray[np.integer], where: str) -> NDArray[np.integer]:
    if cells.ndim != 2 or cells.shape[1] != 2 or len(cells) < 2 or not np.issubdtype(cells.dtype, np.integer):
        raise UserError(f"{where}: got {cells.dtype}{cells.shape}; expected at least two rows of integer row, column")
    if cells.min() < 0 or cells.max() >= GRID:
        raise UserError(
            f"{where}: holds the cell index {cells.min() if cells.min() < 0 else cells.max()}; allowed 0..29"
        )
    if (np.abs(np.diff(cells.astype(int), axis=0)).max(initial=0)) > 1:
        raise UserError(f"{where}: two path cells in a row are not neighbours")
    return cells


# The compact export


def _load_compact(worlds_file: Path) -> list[World]:
    paths_file = worlds_file.with_name("barn_paths.npz")
    if not paths_file.is_file():
        raise UserError(f"{paths_file}: missing; the reference paths must lie beside {worlds_file.name}")
    kinds = {"centers": ("f", 2), "offsets": ("i", 1), "metrics": ("f", 2)}
    data = _read_npz(worlds_file, kinds)
    routes = _read_npz(paths_file, {"cells": ("i", 2), "offsets": ("i", 1)})
    count = len(data["offsets"]) - 1
    _check_offsets(data["offsets"], len(data["centers"]), worlds_file)
    _check_offsets(routes["offsets"], len(routes["cells"]), paths_file)
    if len(routes["offsets"]) != count + 1:
        raise UserError(f"{paths_file}: offsets: {len(routes['offsets']) - 1} paths for {count} worlds")
    if data["centers"].shape[1:] != (2,) or data["metrics"].shape != (count, 5):
        raise UserError(f"{worlds_file}: centers must be (n, 2) and metrics ({count}, 5)")
    radii = _radii(worlds_file, len(data["centers"]))
    # float32 in the file; the SDF files give six decimals.
    centers = np.round(data["centers"].astype(np.float64), 6)
    cylinders = np.column_stack([centers, radii])
    cylinders.setflags(write=False)
    cells = _check_all_cells(routes["cells"], routes["offsets"], paths_file)
    aligned, official = path_frames(cells)
    aligned.setflags(write=False)
    official.setflags(write=False)
    metrics = data["metrics"].astype(np.float64)
    worlds = []
    for i in range(count):
        c = slice(*data["offsets"][i : i + 2])
        p = slice(*routes["offsets"][i : i + 2])
        set_index = i // WORLDS_PER_SET % SETS
        worlds.append(World(i, f"world_{i}", cylinders[c], aligned[p], official[p], metrics[i], set_index))
    return worlds


def _radii(file: Path, count: int) -> Floats:
    """(count,) radii, m: one for all, or one for each cylinder."""
    try:
        with np.load(file, allow_pickle=False) as archive:
            axes = 1 if "radius" in archive.files and archive["radius"].ndim == 1 else 0
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise UserError(f"{file}: not a readable npz file ({error})") from error
    radii = np.round(_read_npz(file, {"radius": ("f", axes)})["radius"].astype(np.float64), 6)
    if axes and len(radii) != count:
        raise UserError(f"{file}: radius: got {len(radii)} for {count} cylinders; expected one for all or one for each")
    if not ((radii > 0.0) & (radii <= 10.0)).all():
        raise UserError(f"{file}: radius: got {radii.min():g}..{radii.max():g} m; allowed above 0 up to 10")
    found: Floats = np.broadcast_to(radii, count)
    return found


def _read_npz(file: Path, wanted: dict[str, tuple[str, int]]) -> dict[str, NDArray]:
    found = {}
    try:
        with np.load(file, allow_pickle=False) as archive:
            for key, (kind, ndim) in wanted.items():
                if key not in archive.files:
                    raise UserError(f"{file}: key {key} is missing")
                array = archive[key]
                if array.dtype.kind != kind or array.ndim != ndim or not np.isfinite(array).all():
                    raise UserError(f"{file}: {key}: got {array.dtype}{array.shape}; expected {ndim} finite axes")
                found[key] = array
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise UserError(f"{file}: not a readable npz file ({error})") from error
    return found


def _check_offsets(offsets: NDArray, total: int, file: Path) -> None:
    if len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != total or (np.diff(offsets) <= 0).any():
        raise UserError(f"{file}: offsets: must rise from 0 to {total}, got {offsets[:2]}..{offsets[-1:]}")


def _check_all_cells(cells: NDArray, offsets: NDArray, file: Path) -> NDArray:
    if cells.shape[1:] != (2,) or cells.min() < 0 or cells.max() >= GRID:
        raise UserError(f"{file}: cells: must be (n, 2) with values 0..{GRID - 1}")
    jumps = np.abs(np.diff(cells.astype(np.int64), axis=0)).max(axis=1) > 1
    jumps[offsets[1:-1] - 1] = False  # from one world's path to the next
    if jumps.any():
        row = int(np.argmax(jumps))
        raise UserError(f"{file}: cells: rows {row} and {row + 1} are not neighbours")
    return cells
