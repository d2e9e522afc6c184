"""Do generated worlds look like BARN's? Density and the five difficulty measures, side by side.

    python benchmarks/world_statistics.py [folder of barn_worlds.npz, archive or .world files] [--seeds 3]

Prints mean and standard deviation over the real and the generated worlds with the p-value of a two-sample
Kolmogorov-Smirnov test, and how many real paths the re-implemented path search reproduces cell for cell.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from appl_dist.sim.difficulty import NAMES, c_space
from appl_dist.sim.generate import find_path, generate_worlds, world_cylinders
from appl_dist.sim.worlds import World, field_grid, load_worlds, path_cells

REAL = Path(__file__).resolve().parents[2] / "shared" / "barn"
COLUMNS = ("cylinders", "density", "path cells", *NAMES)


def measures(worlds: list[World]) -> NDArray[np.float64]:
    """(n, 8) in the order of COLUMNS."""
    return np.array([(len(w.cylinders), w.density, len(w.path), *w.metrics) for w in worlds])


def reproduced(worlds: list[World]) -> tuple[int, int]:
    """How many worlds' paths, and how many worlds' cylinders, our generator makes from their own grids."""
    paths = cylinders = 0
    for world in worlds:
        grid, cells = field_grid(world.cylinders), path_cells(world.path)
        found = find_path(c_space(grid), tuple(cells[0]), tuple(cells[-1]))
        paths += found is not None and np.array_equal(found, cells)
        ours, theirs = ({tuple(c) for c in np.round(a, 6)} for a in (world_cylinders(grid), world.cylinders))
        cylinders += ours == theirs
    return paths, cylinders


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("real", type=Path, nargs="?", default=REAL)
    parser.add_argument("--seeds", type=int, default=1, help="sets of 300 generated worlds to pool")
    args = parser.parse_args()
    real_worlds = load_worlds(args.real)
    real = measures(real_worlds)
    made_worlds = [w for seed in range(args.seeds) for w in generate_worlds(300, seed)]
    made = measures(made_worlds)
    lines = [f"{'':24} {'BARN, ' + str(len(real)):>20} {'generated, ' + str(len(made)):>20} {'KS p':>7}"]
    for k, name in enumerate(COLUMNS):
        a, b = real[:, k], made[:, k]
        lines.append(
            f"{name:24} {a.mean():10.3f} +- {a.std():6.3f} {b.mean():10.3f} +- {b.std():6.3f} "
            f"{ks_2samp(a, b).pvalue:7.3f}"
        )
    lines.append("mean density by set (fill 0.15 0.20 0.25 0.30 with 2, 3, 4 smoothing passes each)")
    for name, worlds, values in (("BARN, by index", real_worlds, real), ("generated", made_worlds, made)):
        sets = np.array([w.set_index for w in worlds])
        lines.append(
            f"{name:15}" + " ".join(f"{values[sets == s, 1].mean():.3f}" for s in range(12) if (sets == s).any())
        )
    paths, cylinders = reproduced(real_worlds)
    lines.append(
        f"of {len(real)} BARN worlds, reproduced from their grids: {paths} paths, {cylinders} sets of cylinders"
    )
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
