"""Checkpoints: everything learning depends on, in one safetensors file with a JSON header.

Comes in: a TD3, the sampling generator, and plain numbers of the caller (counts, schedules, ledger). Goes
out: `checkpoint-<updates>.safetensors`, written atomically. Training that resumes from one continues bit for
bit as if it had never stopped. Only the copy into a standing buffer (about 20 ms) holds up training; a
thread writes the file.
Nothing is ever unpickled.
"""

from __future__ import annotations

import json
import logging
import os
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from appl_dist.errors import UserError
from appl_dist.files import explain, to_disk
from appl_dist.learner.td3 import TD3, Diverged

log = logging.getLogger(__name__)

FORMAT = 3
_PATTERN = "checkpoint-*.safetensors"


@dataclass(frozen=True)
class Checkpoint:
    """One file's contents. `extra` is the caller's own, as given to `Checkpoints.save`."""

    path: Path
    tensors: dict[str, Tensor]
    learner: dict[str, Any]
    rng: dict[str, Any]
    settings: dict[str, Any]
    extra: dict[str, Any]

    def restore(self, learner: TD3, rng: np.random.Generator) -> dict[str, Any]:
        """Put the state back into `learner` and `rng`; returns `extra`. UserError if they do not match."""
        for name, now in _settings(learner).items():
            if self.settings.get(name) != now:
                log.warning("%s: %s was %s, now %s", self.path, name, self.settings.get(name), now)
        try:
            learner.load_state(self.tensors, self.learner)
            rng.bit_generator.state = self.rng
        except (ValueError, KeyError, TypeError, RuntimeError) as e:
            raise UserError(f"{self.path}: does not fit this run: {e}") from None
        return self.extra


class Checkpoints:
    """The checkpoints in one folder, the newest `keep` of them."""

    def __init__(self, folder: str | Path, keep: int = 2) -> None:
        if keep < 1:
            raise ValueError(f"keep: got {keep}; at least 1")
        self.folder, self._keep = Path(folder), keep
        self._buffers: dict[str, Tensor] = {}
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as e:
            raise UserError(f"checkpoint folder {folder}: cannot be made: {explain(e)}") from None
        for left_over in self.folder.glob("checkpoint-*.tmp"):
            left_over.unlink()

    def reserve(self, learner: TD3) -> None:
        """Make the standing buffer now, so that the first save takes no longer than the others."""
        for name, tensor in learner.state()[0].items():
            self._buffers[name] = tensor.detach().to("cpu", copy=True)

    def save(self, learner: TD3, rng: np.random.Generator, extra: dict[str, Any]) -> None:
        """Take a snapshot now and write it in the background.

        `extra` holds JSON values. Raises what the previous write raised: UserError (no space) or Diverged.
        """
        self.wait()
        if not self._buffers:
            self.reserve(learner)
        tensors, numbers = learner.state()
        for name, tensor in tensors.items():
            self._buffers[name].copy_(tensor.detach())
        header = json.dumps(
            {
                "format": FORMAT,
                "learner": numbers,
                "rng": rng.bit_generator.state,
                "settings": _settings(learner),
                "extra": extra,
            }
        )
        path = self.folder / f"checkpoint-{learner.updates:010d}.safetensors"
        self._thread = threading.Thread(target=self._write, args=(path, header), name="checkpoint")
        self._thread.start()

    def wait(self) -> None:
        """Until the write under way has ended; raises what it raised."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def newest(self) -> Path | None:
        """The last good checkpoint, None before the first."""
        return self.newest_in(self.folder)

    @staticmethod
    def newest_in(folder: Path) -> Path | None:
        """The last good checkpoint in a run's folder of them."""
        return max(folder.glob(_PATTERN), default=None)

    def load(self, learner: TD3, rng: np.random.Generator) -> dict[str, Any] | None:
        """Put the newest checkpoint back into `learner` and `rng`; its `extra`, None before the first.

        UserError if the file is damaged or does not fit.
        """
        path = self.newest()
        return None if path is None else load(path).restore(learner, rng)

    def close(self) -> None:
        """Wait for the write under way; raises what it raised, but only logs divergence."""
        try:
            self.wait()
        except Diverged as error:
            log.error("%s", error)

    def _write(self, path: Path, header: str) -> None:
        tmp = path.with_suffix(".tmp")
        try:
            for name, tensor in self._buffers.items():
                if tensor.is_floating_point() and not torch.isfinite(tensor).all():
                    raise Diverged(f"{name} holds a value that is not finite; {path.name} was not written")
            save_file(self._buffers, tmp, {"appl_checkpoint": header})
            to_disk(tmp)
            os.replace(tmp, path)
            to_disk(self.folder)
            for old in sorted(self.folder.glob(_PATTERN))[: -self._keep]:
                old.unlink()
        except (OSError, SafetensorError) as e:
            tmp.unlink(missing_ok=True)
            last = self.newest() or "none"
            self._error = UserError(f"{path}: cannot be written: {e}; the last good checkpoint is {last}")
        except Diverged as e:
            self._error = e


def _settings(learner: TD3) -> dict[str, Any]:
    """The settings in force as JSON values."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(learner.settings)))
    return {**plain, "precision": learner.precision}


def load(path: str | Path) -> Checkpoint:
    """Read and check one file; UserError names it and what is wrong."""
    path = Path(path)
    try:
        with safe_open(path, "pt") as file:
            header = json.loads((file.metadata() or {})["appl_checkpoint"])
            if header["format"] != FORMAT:
                raise ValueError(f"format {header['format']}, this version reads {FORMAT}")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        for name, tensor in tensors.items():
            if tensor.is_floating_point() and not torch.isfinite(tensor).all():
                raise ValueError(f"{name} holds a value that is not finite")
        parts = {key: header[key] for key in ("learner", "rng", "settings", "extra")}
        return Checkpoint(path, tensors, **parts)
    except OSError as e:
        raise UserError(f"{path}: cannot be read: {e.strerror or e}") from None
    except (SafetensorError, ValueError, KeyError, TypeError) as e:
        raise UserError(f"{path}: not a usable checkpoint: {e!r}") from None
