"""`appl-dist worlds`: check a set of worlds, generate one, describe it, draw a world."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appl_dist.arguments import ArgumentParser
from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.sim.difficulty import NAMES, Grid, c_space
from appl_dist.sim.generate import generate_world, generate_worlds
from appl_dist.sim.worlds import FIELD_ORIGIN, RADIUS_M, SETS, World, field_grid, load_worlds, path_cells


def worlds_main(argv: list[str]) -> int:
    """Run one sub-command; returns the exit status. Raises UserError for what the user can mend."""
    parser = ArgumentParser(prog="appl-dist worlds", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    check = verbs.add_parser("check", help="read every world of a set and say what was found")
    check.add_argument("path", type=Path, help="folder, tar archive or barn_worlds.npz")
    make = verbs.add_parser("generate", help="write barn_worlds.npz and barn_paths.npz of generated worlds")
    make.add_argument("path", type=Path, help="folder to write into; made if it does not exist")
    make.add_argument("--count", type=int, default=300)
    make.add_argument("--seed", type=int, default=0)
    convert = verbs.add_parser("convert", help="write the compact files of .world files: read in 10 ms, not 7 s")
    convert.add_argument("path", type=Path, help="folder or tar archive of world_<i>.world and path_files")
    convert.add_argument("out", type=Path, help="folder to write into")
    for verb in (make, convert):
        verb.add_argument("--force", action="store_true", help="replace the worlds that the folder holds")
    stats = verbs.add_parser("stats", help="cylinders, density and difficulty of each of the twelve sets")
    stats.add_argument("path", type=Path)
    draw = verbs.add_parser("draw", help="draw one world")
    draw.add_argument("path", help='folder, archive or npz; "" draws a generated world')
    draw.add_argument("--index", type=int, default=0)
    draw.add_argument("--seed", type=int, default=0, help="of a generated world")
    draw.add_argument("--out", type=Path, required=True, help="PNG file")
    args = parser.parse_args(argv)
    if args.verb == "check":
        _check(args.path)
    elif args.verb == "generate":
        if args.count < 1 or args.seed < 0:
            raise UserError(f"--count and --seed: got {args.count} and {args.seed}; at least 1 and 0")
        _refuse_to_replace(args.path, args.force)
        save_worlds(generate_worlds(args.count, args.seed), args.path)
        _say(f"{args.count} worlds of seed {args.seed} in {args.path}")
    elif args.verb == "convert":
        _refuse_to_replace(args.out, args.force)
        worlds = load_worlds(args.path)
        if [w.index for w in worlds] != list(range(len(worlds))):
            raise UserError(f"{args.path}: the compact format needs worlds 0, 1, … without a gap")
        save_worlds(worlds, args.out)
        _say(f"{len(worlds)} worlds in {args.out}")
    elif args.verb == "stats":
        _say(statistics_table(load_worlds(args.path)))
    else:
        if args.out.exists() and args.out.suffix.lower() != ".png":
            raise UserError(f"--out: {args.out} exists and is no PNG file; choose another name")
        draw_world(_pick(args.path, args.index, args.seed), args.out)
        _say(f"{args.out}")
    return 0


def _refuse_to_replace(folder: Path, force: bool) -> None:
    """UserError if `folder` holds worlds already, in either format."""
    if force or not folder.is_dir():
        return
    held = next((file for pattern in ("barn_*.npz", "world_*.world") for file in folder.glob(pattern)), None)
    if held is not None:
        raise UserError(f"{held} exists; choose another folder, or replace these worlds with --force")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


def _pick(path: str, index: int, seed: int) -> World:
    if not path:
        if index < 0 or seed < 0:
            raise UserError(f"--index and --seed: got {index} and {seed}; both must be at least 0")
        return generate_world(index, seed)
    worlds = {w.index: w for w in load_worlds(path)}
    if index not in worlds:
        raise UserError(f"--index: got {index}; {path} has {len(worlds)} worlds, {min(worlds)}..{max(worlds)}")
    return worlds[index]


def _check(path: Path) -> None:
    worlds = load_worlds(path)
    counts = [len(w.cylinders) for w in worlds]
    blocked = sum(_path_is_blocked(w) for w in worlds)
    _say(
        f"{path}: {len(worlds)} worlds, {min(counts)} to {max(counts)} cylinders (mean {np.mean(counts):.1f}), "
        f"{blocked} with a blocked reference path"
    )
    if blocked:
        raise UserError(f"{path}: {blocked} reference path(s) pass nearer than 0.375 m to an obstacle")


def _path_is_blocked(world: World) -> bool:
    cells = path_cells(world.path)
    return bool(c_space(field_grid(world.cylinders))[cells[:, 0], cells[:, 1]].any())


def statistics_table(worlds: list[World]) -> str:
    """Text table: mean and standard deviation over the worlds of each set, and over all."""
    columns = ("cylinders", "density", *NAMES)
    rows = np.array([(len(w.cylinders), w.density, *w.metrics) for w in worlds])  # (n, 7)
    sets = np.array([w.set_index for w in worlds])
    lines = ["set   n  " + "  ".join(f"{name:>18}" for name in columns)]
    for k in [*range(SETS), -1]:
        chosen = rows if k < 0 else rows[sets == k]
        if len(chosen):
            cells = [f"{m:9.3f} +- {s:5.3f}" for m, s in zip(chosen.mean(0), chosen.std(0), strict=True)]
            lines.append(f"{'all' if k < 0 else k:>3} {len(chosen):>3}  " + "  ".join(f"{c:>18}" for c in cells))
    return "\n".join(lines)


def save_worlds(worlds: list[World], folder: Path) -> None:
    """Write worlds with index 0, 1, … in the compact format, both files atomically."""
    if [w.index for w in worlds] != list(range(len(worlds))):
        raise ValueError("worlds: indices must be 0, 1, …")
    folder.mkdir(parents=True, exist_ok=True)
    grids = np.array([field_grid(w.cylinders) for w in worlds])
    cells = [path_cells(w.path).astype(np.int8) for w in worlds]
    _write_npz(
        folder / "barn_worlds.npz",
        centers=np.concatenate([w.cylinders[:, :2] for w in worlds]).astype(np.float32),
        offsets=_offsets([len(w.cylinders) for w in worlds]),
        radius=_one_or_all(np.concatenate([w.cylinders[:, 2] for w in worlds])),
        height=np.float32(1.0),
        grid=np.packbits(grids, axis=2),
        cspace=np.packbits(c_space(grids), axis=2),
        metrics=np.array([w.metrics for w in worlds], np.float32),
    )
    _write_npz(
        folder / "barn_paths.npz",
        cells=np.concatenate(cells),
        offsets=_offsets([len(c) for c in cells]),
        xy_official=np.concatenate([w.path_official for w in worlds]).astype(np.float32),
        xy_aligned=np.concatenate([w.path for w in worlds]).astype(np.float32),
    )


def _one_or_all(radii: NDArray[np.float64]) -> NDArray[np.float32]:
    """The radius of all cylinders, () where they have the same, else (n,)."""
    found = radii.astype(np.float32)
    return np.asarray(found[0]) if (found == found[0]).all() else found


def _offsets(counts: list[int]) -> NDArray[np.int32]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _write_npz(file: Path, **arrays: NDArray | np.floating) -> None:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    write_atomic(file, stream.getvalue())


def draw_world(world: World, out: Path) -> None:
    """PNG of a course: obstacles, where the robot's centre cannot be, and the reference path."""
    try:
        os.environ["MPLBACKEND"] = "agg"  # what a notebook has set there may not be importable here
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import PatchCollection
        from matplotlib.figure import Figure
        from matplotlib.patches import Circle
    except ImportError as error:
        raise UserError("draw needs matplotlib: pip install 'appl-dist[evaluate]'") from error
    figure = Figure(figsize=(4.2, 8.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    closed: Grid = c_space(field_grid(world.cylinders))
    low, high = FIELD_ORIGIN - RADIUS_M, FIELD_ORIGIN + RADIUS_M + 29 * 2 * RADIUS_M
    extent = (low[0], high[0], low[1], high[1])
    axes.imshow(closed.T, origin="lower", extent=extent, cmap="Greys", alpha=0.25, interpolation="nearest")
    axes.add_collection(PatchCollection([Circle((x, y), r) for x, y, r in world.cylinders], color="0.25"))
    axes.plot(*world.path.T, color="tab:green", lw=1.5, label="reference path")
    axes.plot(-2.0, 3.0, "o", color="tab:blue", label="start")
    axes.plot(-2.0, 13.0, "*", color="tab:red", ms=10, label="goal")
    axes.set(xlim=(-5, 0.5), ylim=(-0.3, 13.6), aspect="equal", xlabel="x (m)", ylabel="y (m)", title=world.name)
    axes.legend(loc="upper right", fontsize=7)
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=120)
    write_atomic(out, png.getvalue())
