"""A parameter policy as a file, and as the blob the learner broadcasts: safetensors with a JSON header.

Comes in: the learner's actor network, or fixed parameter values from a fit. Goes out: the same, checked.
A file holds exactly one of an MLP (ReLU between layers, tanh at the end, action in [-1, 1]) or fixed
parameter values. It carries the parameter space (planner, names and bounds) and the observation layout, so a file
can never be run against bounds or a layout it was not trained for.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from appl_dist.errors import UserError
from appl_dist.files import write_atomic
from appl_dist.spec import FloatArray, ObservationLayout, Parameter, ParameterSpace

FORMAT = 3
ACTIVATION = "relu"  # between layers; the output layer is always tanh
_HEADER_KEY = "appl_policy"
_HALF_MAX = float(np.finfo(np.float16).max)
_MAX_HEADER_BYTES = 1 << 20


@dataclass(frozen=True)
class Training:
    """Where a policy comes from: fingerprints of its training courses, the run's id and seed, its settings' digest."""

    courses: tuple[str, ...]
    run: str
    seed: int
    config: str


@dataclass(frozen=True)
class PolicyFile:
    """An MLP (`weights` (out, in) and `biases` (out,), float32) or fixed `values` (n,) of `space`.

    (epoch, version) orders the policies of one run: the learner raises `epoch` each time it starts and
    `version` each time it publishes. `transitions` is how many transitions the learner had received,
    the clock of every exploration schedule. Raises ValueError naming the first field that cannot be.
    """

    weights: tuple[FloatArray, ...] = ()
    biases: tuple[FloatArray, ...] = ()
    space: ParameterSpace = field(kw_only=True)
    values: NDArray[np.float64] | None = None
    epoch: int = 0
    version: int = 0
    transitions: int = 0
    training: Training | None = None  # None: unknown, as for a fixed set or a file made elsewhere
    observation: ObservationLayout | None = None  # None with fixed values, which look at nothing

    def __post_init__(self) -> None:
        for name in ("epoch", "version", "transitions"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: got {getattr(self, name)}; it counts from 0")
        if self.values is not None:
            if self.weights or self.biases:
                raise ValueError("values: given beside weights; a policy is either fixed values or an MLP")
            _check_values(self.values, self.space)
        elif not self.weights:
            raise ValueError("weights: got no layer and no fixed values; one of the two is needed")
        elif self.observation is None:
            raise ValueError("observation: got none; a network needs the layout of what it sees")
        else:
            self._check_layers(self.observation.size)

    def _check_layers(self, fan_in: int) -> None:
        if len(self.weights) != len(self.biases):
            raise ValueError(f"biases: got {len(self.biases)}; {len(self.weights)} weights need as many")
        for i, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            for name, array in ((f"weight.{i}", w), (f"bias.{i}", b)):
                if array.dtype != np.float32:
                    raise ValueError(f"{name}: got dtype {array.dtype}; expected float32")
                if not np.isfinite(array).all():
                    raise ValueError(f"{name}: holds a value that is not finite")
            if w.ndim != 2 or w.shape[1] != fan_in:
                raise ValueError(f"weight.{i}: got shape {w.shape}; expected (outputs, {fan_in})")
            if b.shape != (w.shape[0],):
                raise ValueError(f"bias.{i}: got shape {b.shape}; expected ({w.shape[0]},)")
            fan_in = w.shape[0]
        if fan_in != len(self.space):
            raise ValueError(
                f"weight.{len(self.weights) - 1}: gives {fan_in} outputs; "
                f"space {self.space.name!r} has {len(self.space)} parameters"
            )

    def to_bytes(self, half: bool = False) -> bytes:
        """The file's bytes. half: weights in float16, which is what the wire broadcasts.

        Half the bytes reach a fleet in half the time; the rounding (2^-11) is finer than that of the bfloat16 the
        learner may compute in, and far below exploration noise. ValueError: a weight beyond float16.
        """
        dtype = np.float16 if half else np.float32
        header = {
            "format": FORMAT,
            **({} if self.observation is None else {"observation": asdict(self.observation)}),
            "activation": ACTIVATION,
            "layers": len(self.weights),
            "space": _space_to_plain(self.space),
            "epoch": self.epoch,
            "version": self.version,
            "transitions": self.transitions,
            **({} if self.training is None else {"training": asdict(self.training)}),
        }
        tensors: dict[str, NDArray[Any]] = {}
        for i, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            for name, array in ((f"weight.{i}", w), (f"bias.{i}", b)):
                if half and np.abs(array).max(initial=0.0) > _HALF_MAX:
                    raise ValueError(f"{name}: holds a value beyond float16's {_HALF_MAX:g}")
                tensors[name] = np.ascontiguousarray(array, dtype)
        if self.values is not None:
            tensors["values"] = np.ascontiguousarray(self.values, np.float64)
        return bytes(save_tensors(tensors, {_HEADER_KEY: json.dumps(header)}))

    @classmethod
    def from_bytes(cls, blob: bytes, source: str = "policy blob") -> PolicyFile:
        """Parse and check `blob`; UserError names `source` and the field that is wrong."""
        try:
            header = _read_header(blob)
            tensors = load_tensors(bytes(blob))
            return _from_parts(header, tensors)
        except (SafetensorError, ValueError, OverflowError, RecursionError) as e:
            raise UserError(f"{source}: not a usable policy: {e}") from None

    def save(self, path: str | Path) -> None:
        """Write atomically; a reader sees the old file or the new one, never half of one."""
        write_atomic(Path(path), self.to_bytes())

    @classmethod
    def load(cls, path: str | Path) -> PolicyFile:
        """Read and check a file; UserError names it and the field that is wrong."""
        try:
            blob = Path(path).read_bytes()
        except OSError as e:
            raise UserError(f"{path}: cannot read policy file: {e.strerror or e}") from None
        return cls.from_bytes(blob, str(path))


def _check_values(values: NDArray[Any], space: ParameterSpace) -> None:
    if values.shape != (len(space),) or values.dtype != np.float64:
        raise ValueError(f"values: got {values.dtype}{values.shape}; expected float64({len(space)},)")
    for p, v in zip(space.parameters, values, strict=True):
        if not p.low <= v <= p.high:  # also catches nan
            raise ValueError(f"values: {p.name} = {v:g}; {space.name} allows {p.low:g}..{p.high:g}")
        if p.integer and v != round(v):
            raise ValueError(f"values: {p.name} = {v:g}; it must be a whole number")


def _space_to_plain(space: ParameterSpace) -> dict[str, Any]:
    return {
        "name": space.name,
        "planner": space.planner,
        "parameters": [
            {
                "name": p.name,
                "default": p.default,
                "low": p.low,
                "high": p.high,
                "unit": p.unit,
                "integer": p.integer,
            }
            for p in space.parameters
        ],
    }


def _space_from_plain(plain: Any) -> ParameterSpace:
    name = _take(plain, "name", str, "space.name")
    planner = _take(plain, "planner", str, "space.planner")
    rows = _take(plain, "parameters", list, "space.parameters")
    parameters = []
    for i, row in enumerate(rows):
        at = f"space.parameters[{i}]"
        default, low, high = (float(_take(row, k, (int, float), f"{at}.{k}")) for k in ("default", "low", "high"))
        if not all(map(math.isfinite, (default, low, high))):
            raise ValueError(f"{at}: a default or bound is not finite")
        unit, integer = _take(row, "unit", str, f"{at}.unit"), _take(row, "integer", bool, f"{at}.integer")
        parameters.append(Parameter(_take(row, "name", str, f"{at}.name"), default, low, high, unit, integer))
    if not parameters:
        raise ValueError("space.parameters: is empty")
    if len({p.name for p in parameters}) < len(parameters):
        raise ValueError("space.parameters: a name appears twice")
    return ParameterSpace(name, planner, tuple(parameters))


def _observation_from_plain(plain: Any) -> ObservationLayout:
    name = _take(plain, "name", str, "observation.name")
    scan_size, size, version = (
        _take(plain, key, int, f"observation.{key}") for key in ("scan_size", "size", "version")
    )
    clip_m = float(_take(plain, "clip_m", (int, float), "observation.clip_m"))
    if not 0.0 < clip_m < math.inf:
        raise ValueError(f"observation.clip_m: got {clip_m}; allowed above 0, finite")
    return ObservationLayout(name, scan_size, size, clip_m, version)


def _take(mapping: Any, key: str, kind: type | tuple[type, ...], label: str) -> Any:
    if not isinstance(mapping, Mapping) or key not in mapping:
        raise ValueError(f"{label}: missing from the header")
    value = mapping[key]
    bool_as_number = isinstance(value, bool) and kind is not bool
    if not isinstance(value, kind) or bool_as_number:
        raise ValueError(f"{label}: got {value!r}; expected {getattr(kind, '__name__', 'a number')}")
    return value


def _read_header(blob: bytes) -> dict[str, Any]:
    """Our JSON header, read straight from the safetensors prefix (its API only gives tensors)."""
    if len(blob) < 8:
        raise ValueError(f"got {len(blob)} bytes, too few for a safetensors file")
    (size,) = struct.unpack("<Q", blob[:8])
    if size > min(len(blob) - 8, _MAX_HEADER_BYTES):
        raise ValueError(f"header of {size} bytes does not fit (file of {len(blob)} bytes: cut or not safetensors)")
    outer = json.loads(blob[8 : 8 + size])
    header = json.loads(_take(_take(outer, "__metadata__", dict, "__metadata__"), _HEADER_KEY, str, _HEADER_KEY))
    if _take(header, "format", int, "format") != FORMAT:
        raise ValueError(f"format: got {header['format']}; this version reads {FORMAT}")
    if _take(header, "activation", str, "activation") != ACTIVATION:
        raise ValueError(f"activation: got {header['activation']!r}; allowed {ACTIVATION!r}")
    return dict(header)


def _from_parts(header: dict[str, Any], tensors: dict[str, NDArray[Any]]) -> PolicyFile:
    layers = _take(header, "layers", int, "layers")
    if not 0 <= layers <= 64:
        raise ValueError(f"layers: got {layers}; allowed 0..64")
    wanted = {f"{kind}.{i}" for i in range(layers) for kind in ("weight", "bias")} or {"values"}
    if set(tensors) != wanted:
        raise ValueError(f"tensors: got {sorted(tensors)}; expected {sorted(wanted)}")
    tensors = {name: a.astype(np.float32) if a.dtype == np.float16 else a for name, a in tensors.items()}
    return PolicyFile(
        weights=tuple(tensors[f"weight.{i}"] for i in range(layers)),
        biases=tuple(tensors[f"bias.{i}"] for i in range(layers)),
        space=_space_from_plain(_take(header, "space", dict, "space")),
        values=tensors.get("values"),
        epoch=_take(header, "epoch", int, "epoch"),
        version=_take(header, "version", int, "version"),
        transitions=_take(header, "transitions", int, "transitions"),
        training=_training(header["training"]) if "training" in header else None,
        observation=_observation_from_plain(header["observation"]) if "observation" in header else None,
    )


def _training(plain: Any) -> Training:
    courses = _take(plain, "courses", list, "training.courses")
    if not all(isinstance(course, str) and len(course) <= 64 for course in courses):
        raise ValueError("training.courses: expected a list of fingerprints")
    run, config = (_take(plain, name, str, f"training.{name}")[:255] for name in ("run", "config"))
    return Training(tuple(courses), run, _take(plain, "seed", int, "training.seed"), config)
