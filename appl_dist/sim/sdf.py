"""The cylinders of a Gazebo world file (SDF), as BARN's authors publish their worlds."""

from __future__ import annotations

from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError


class _SdfReader:
    """Collects the static cylinders of an SDF world; expat keeps the line for errors."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.stack: list[str] = []
        self.text = ""
        self.model: dict[str, list[float]] = {}
        self.cylinders: list[tuple[float, float, float]] = []
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def fail(self, reason: str) -> UserError:
        return UserError(f"{self.where}, line {self.parser.CurrentLineNumber}: {reason}")

    def _start(self, tag: str, _: dict[str, str]) -> None:
        self.stack.append(tag)
        if tag in ("pose", "radius"):  # most of the file is text that nobody reads
            self.text = ""
            self.parser.CharacterDataHandler = self._data
        elif tag == "model":
            self.model = {}
        elif tag == "cylinder" and "collision" in self.stack:
            self.model["cylinder"] = []

    def _data(self, text: str) -> None:
        self.text += text

    def _numbers(self, count: int) -> list[float]:
        try:
            numbers = [float(word) for word in self.text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise self.fail(f"<{self.stack[-1]}> got {self.text.strip()[:40]!r}; expected {count} finite number(s)")
        return numbers

    def _end(self, tag: str) -> None:
        self.parser.CharacterDataHandler = None
        parent = self.stack[-2] if len(self.stack) > 1 else ""
        if tag == "pose" and parent == "model":
            self.model["pose"] = self._numbers(6)
        elif tag == "radius" and parent == "cylinder" and "collision" in self.stack:
            self.model["radius"] = self._numbers(1)
        elif tag == "model" and parent == "world" and "cylinder" in self.model:
            self._finish()
        self.stack.pop()

    def _finish(self) -> None:
        if "pose" not in self.model or "radius" not in self.model:
            raise self.fail("a cylinder model lacks its <pose> or <radius>")
        x, y, _, roll, pitch, _ = self.model["pose"]
        radius = self.model["radius"][0]
        if roll or pitch:
            raise self.fail("a cylinder is tilted; only upright cylinders are known")
        if not 0.0 < radius <= 10.0 or max(abs(x), abs(y)) > 1000.0:
            raise self.fail(f"cylinder at ({x:g}, {y:g}) of radius {radius:g} m; allowed +-1000 m and 0..10 m")
        self.cylinders.append((x, y, radius))


def parse_sdf(data: bytes, where: str) -> NDArray[np.float64]:
    """(n, 3) x, y, radius, m, of the cylinders in file order; UserError names `where`, the line and what cannot be."""
    reader = _SdfReader(where)
    # The saved <state> repeats every pose in the second half of the file.
    head, state, _ = data.partition(b"<state ")
    try:
        if b"<!ENTITY" in head:
            raise UserError(f"{where}: declares an XML entity; not allowed")
        reader.parser.Parse(head, False)
        if state:
            reader.parser.Parse(b"</world></sdf>", True)
        else:
            reader.parser.Parse(b"", True)
    except expat.ExpatError as error:
        raise UserError(f"{where}, line {error.lineno}: not well-formed SDF ({error})") from error
    if not reader.cylinders:
        raise UserError(f"{where}: holds no cylinder")
    return np.array(reader.cylinders, np.float64)
