"""Where numbers come from: the code and the machine that made them."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import appl_dist

_ROOT = Path(appl_dist.__file__).resolve().parents[1]
_LIBRARIES = ("numpy", "pybullet", "scipy")


def code() -> dict[str, Any]:
    """Version of the package and, in a git checkout, its commit and whether files differ from it."""
    commit = _git("rev-parse", "HEAD") if (_ROOT / ".git").exists() else ""
    return {
        "version": _version("appl-dist") or "not installed",
        "commit": commit,
        "changed": bool(_git("status", "--porcelain", "--untracked-files=no")) if commit else None,
    }


def machine() -> dict[str, Any]:
    """Processor, cores and the libraries that numbers depend on; no name of the host."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: _version(name) for name in _LIBRARIES},
    }


def same_machine(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    """Whether two `machine()` agree in all that bits of a trajectory may depend on: processor, system, libraries."""
    return all(a.get(k) == b.get(k) for k in ("processor", "system", *_LIBRARIES))


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _git(*arguments: str) -> str:
    try:
        found = subprocess.run(
            ["git", "-C", str(_ROOT), *arguments], capture_output=True, text=True, timeout=10.0, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip() if found.returncode == 0 else ""
