"""Build the C core with every compiler that is installed, warnings as errors; `make compilers` runs it.

Host compilers also build the Python module, with which the reference vectors are replayed where they are there.
GCC 9 to 14 and clang 14 on, x86-64 and (cross) aarch64, are meant to pass; what is not installed is named.

    python tools/compilers.py
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NAMES = ("tp.jsonl.gz", "tp_grids.npz", "inflation.npz", "navfn.npz", "sim.jsonl.gz", "sim_full.npz")
VECTORS = [file for name in NAMES if (file := ROOT.parent / "shared" / "reference" / name).exists()]
HOST = [(f"gcc-{n}", f"g++-{n}") for n in range(9, 15)] + [(f"clang-{n}", f"clang++-{n}") for n in range(14, 23)]
CROSS = [("aarch64-linux-gnu-gcc", "aarch64-linux-gnu-g++")]


def run(command: list[str], **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]


def build(c: str, cxx: str, folder: Path, target: str) -> str:
    """Build one CMake target; "" or the first complaint."""
    configure = [
        "cmake", "-S", str(ROOT / "appl_dist" / "native"), "-B", str(folder), "-G", "Ninja", "-DAPPL_WERROR=ON",
        "-DCMAKE_BUILD_TYPE=Release", f"-DCMAKE_C_COMPILER={c}", f"-DCMAKE_CXX_COMPILER={cxx}",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]  # fmt: skip
    for command in (configure, ["cmake", "--build", str(folder), "--target", target]):
        done = run(command)
        if done.returncode:
            lines = [line for line in (done.stdout + done.stderr).splitlines() if " error: " in line]
            return (lines or ["failed"])[0][:160]
    return ""


def replay(folder: Path) -> str:
    """Conformance of the module just built, from a copy of the package beside it."""
    if not VECTORS:
        return "no reference vectors"
    tree = folder / "tree"
    shutil.copytree(ROOT / "appl_dist", tree / "appl_dist", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    for module in folder.glob("_native*.so"):
        shutil.copy(module, tree / "appl_dist")
    command = [sys.executable, "-P", "-m", "appl_dist", "conformance", *map(str, VECTORS)]
    done = run(command, env={**os.environ, "PYTHONPATH": str(tree)}, cwd=tree)
    return "bit-equal" if done.returncode == 0 else f"DIFFERS: {(done.stdout + done.stderr).strip()[-120:]}"


def main() -> int:
    """Print a line a compiler; status 1 if one that is installed fails."""
    failed, missing = 0, []
    for pairs, target in ((HOST, "_native"), (CROSS, "core")):
        for c, cxx in pairs:
            if shutil.which(c) is None or shutil.which(cxx) is None:
                missing.append(c)
                continue
            with tempfile.TemporaryDirectory() as name:
                complaint = build(c, cxx, Path(name), target)
                vectors = replay(Path(name)) if target == "_native" and not complaint else "not run"
            failed += bool(complaint) or vectors.startswith("DIFFERS")
            print(f"{c:24} {complaint or 'built without a warning':60} reference vectors: {vectors}", flush=True)
    print(f"not installed: {', '.join(missing)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
