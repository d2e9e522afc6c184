"""The upright cylinders of a Gazebo world file (SDF). Whatever else could stand in the robot's way is refused.

Poses of models, links and collisions are composed, as are those of a saved `<state>`, which in Gazebo replace them.
Ground plane, sun, physics, appearance and user interface are known not to matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from appl_dist.errors import UserError

# Elements of no consequence for a wheeled robot with a planar lidar among static obstacles.
_IGNORED = {
    "light", "gravity", "magnetic_field", "atmosphere", "physics", "scene", "spherical_coordinates", "gui", "audio",
    "wind", "inertial", "material", "surface", "max_contacts", "laser_retro", "self_collide", "kinematic",
    "cast_shadows", "meta", "transparency", "enable_wind", "allow_auto_disable", "velocity_decay", "acceleration",
    "velocity", "wrench", "sim_time", "real_time", "wall_time", "iterations", "plugin",
    "must_be_base_link", "static",
}  # fmt: skip
_TREE = {
    "sdf": {"world"},
    "world": {"model", "include", "state", "actor", "road", "population"},
    "model": {"pose", "link", "model", "include", "joint", "frame", "scale"},
    "link": {"pose", "collision", "visual", "sensor", "projector", "audio_source", "battery", "light"},
    "collision": {"pose", "geometry"},
    "visual": set(),
    "geometry": None,
    "state": {"model", "light", "insertions", "deletions"},
    "include": {"uri", "name", "pose"},
}  # fmt: skip
_KNOWN_MODELS = ("model://sun", "model://ground_plane")
_ONCE = {"pose", "geometry", "radius", "length", "scale", "normal", "uri"}  # at most one in its parent
_FLAT = 1e-6  # rad
_LIDAR_M = (0.05, 0.35)  # heights that an obstacle must cover to be what the robot's lidar and body meet
Pose = tuple[float, float, float, float]  # x, y, z, yaw


@dataclass
class _Element:
    tag: str
    line: int
    attributes: dict[str, str]
    text: str = ""
    children: list[_Element] = field(default_factory=list)

    def all(self, tag: str) -> list[_Element]:
        return [child for child in self.children if child.tag == tag]

    def one(self, tag: str) -> _Element | None:
        return next(iter(self.all(tag)), None)

    @property
    def name(self) -> str:
        return f"{self.tag} {self.attributes.get('name', '')!r}"


class _Reader:
    """Builds the elements that matter and composes what they say."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.root = _Element("", 0, {})
        self._stack = [self.root]
        self._ignored = 0  # depth inside an element of no consequence
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._data
        self.parser.EntityDeclHandler = self._entity

    def fail(self, element: _Element, reason: str) -> UserError:
        return UserError(f"{self.where}, line {element.line}: {reason}")

    def _entity(self, *_: object) -> None:
        raise UserError(f"{self.where}, line {self.parser.CurrentLineNumber}: declares an XML entity; not allowed")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        parent = self._stack[-1]
        if self._ignored or tag in _IGNORED or parent.tag in ("visual", "pose"):
            self._ignored += 1
            return
        element = _Element(tag, self.parser.CurrentLineNumber, attributes)
        allowed = _TREE.get(parent.tag, set())
        in_shape = len(self._stack) > 1 and self._stack[-2].tag == "geometry"  # a shape is judged as a whole
        if parent is not self.root and allowed is not None and tag not in allowed and not in_shape:
            raise self.fail(element, f"<{tag}> in <{parent.tag}> is unknown; it could stand in the robot's way")
        if tag in _ONCE and parent.one(tag) is not None:
            raise self.fail(element, f"a second <{tag}> in {parent.name}")
        parent.children.append(element)
        self._stack.append(element)

    def _end(self, _: str) -> None:
        if self._ignored:
            self._ignored -= 1
        else:
            self._stack.pop()

    def _data(self, text: str) -> None:
        if not self._ignored:
            self._stack[-1].text += text

    def numbers(self, element: _Element, count: int) -> list[float]:
        try:
            found = [float(word) for word in element.text.split()]
        except ValueError:
            found = []
        if len(found) != count or not np.isfinite(found).all():
            got = element.text.strip()[:40]
            raise self.fail(element, f"<{element.tag}> got {got!r}; expected {count} finite number(s)")
        return found

    def pose(self, parent: _Element) -> Pose:
        """The pose that an element gives itself in its parent's frame; upright."""
        element = parent.one("pose")
        if element is None:
            return (0.0, 0.0, 0.0, 0.0)
        for attribute in ("frame", "relative_to", "rotation_format", "degrees"):
            if element.attributes.get(attribute, "") not in ("", "euler_rpy", "false", "0"):
                raise self.fail(
                    element, f"<pose {attribute}=…> of {parent.name} is not supported; give it in its parent"
                )
        x, y, z, roll, pitch, yaw = self.numbers(element, 6)
        if abs(roll) > _FLAT or abs(pitch) > _FLAT:
            raise self.fail(element, f"{parent.name} is tilted; only upright cylinders can be read")
        return (x, y, z, yaw)

    def world(self) -> NDArray[np.float64]:
        """(n, 3) cylinders of the one world."""
        worlds = [world for sdf in self.root.all("sdf") for world in sdf.all("world")]
        if len(worlds) != 1:
            raise UserError(f"{self.where}: holds {len(worlds)} worlds; expected 1")
        (world,) = worlds
        for child in world.children:
            if child.tag == "include":
                uri = child.one("uri")
                if uri is None or uri.text.strip() not in _KNOWN_MODELS:
                    named = "" if uri is None else uri.text.strip()[:80]
                    raise self.fail(
                        child, f"includes {named!r}, whose shape is not in this file; write its cylinders out"
                    )
            elif child.tag not in ("model", "state"):
                raise self.fail(child, f"<{child.tag}> could stand in the robot's way and cannot be read")
        saved = self._saved(world)
        models = world.all("model")
        names = [m.attributes.get("name", "") for m in models]
        if saved and len(set(names)) < len(names):
            raise UserError(f"{self.where}: two models have one name, so that <state> cannot be applied")
        if missing := sorted(saved.keys() - {m.attributes.get("name", "") for m in models}):
            raise self.fail(saved[missing[0]], f"<state> has a model {missing[0]!r} that the world lacks")
        found = [row for model in models for row in self._model(model, saved)]
        if not found:
            raise UserError(f"{self.where}: holds no cylinder")
        return np.array(found, np.float64)

    def _saved(self, world: _Element) -> dict[str, _Element]:
        return {m.attributes.get("name", ""): m for state in world.all("state") for m in state.all("model")}

    def _model(self, model: _Element, saved: dict[str, _Element]) -> list[tuple[float, float, float]]:
        """x, y, radius of every cylinder of a model."""
        if model.attributes.get("placement_frame", ""):
            raise self.fail(model, f"placement_frame of {model.name} is not supported")
        state = saved.get(model.attributes.get("name", ""))
        pose = self.pose(model if state is None or state.one("pose") is None else state)
        if state is not None:
            self._check_state(state)
        rows = []
        for child in model.children:
            if child.tag == "link":
                rows += self._link(child, model, _composed(pose, self._link_pose(child, pose, state)))
            elif child.tag not in ("pose", "frame"):
                raise self.fail(child, f"{model.name} holds a <{child.tag}>, which is not supported")
        return rows

    def _check_state(self, state: _Element) -> None:
        scale = state.one("scale")
        if scale is not None and self.numbers(scale, 3) != [1.0, 1.0, 1.0]:
            raise self.fail(scale, f"<state> scales {state.name}; not supported, write the radius into the model")

    def _link_pose(self, link: _Element, model_pose: Pose, state: _Element | None) -> Pose:
        """A link's pose in its model; a saved one is in the world's frame and must say the same."""
        pose = self.pose(link)
        name = link.attributes.get("name", "")
        moved = next((s for s in (state.all("link") if state else []) if s.attributes.get("name", "") == name), None)
        if moved is not None and moved.one("pose") is not None:
            now, then = self.pose(moved), _composed(model_pose, pose)
            turn = math.remainder(now[3] - then[3], math.tau)
            if max(abs(turn), *(abs(a - b) for a, b in zip(now[:3], then[:3], strict=True))) > 1e-3:
                raise self.fail(moved, f"<state> moves {link.name} within its model; not supported")
        return pose

    def _link(self, link: _Element, model: _Element, pose: Pose) -> list[tuple[float, float, float]]:
        if link.all("visual") and not link.all("collision"):
            raise self.fail(link, f"{link.name} of {model.name} is seen but cannot be touched; not supported")
        rows = []
        for collision in link.all("collision"):
            geometry = collision.one("geometry")
            shapes = geometry.children if geometry is not None else []
            if len(shapes) != 1:
                raise self.fail(collision, f"{collision.name} of {model.name} has {len(shapes)} shapes; expected 1")
            row = self._shape(shapes[0], model, _composed(pose, self.pose(collision)))
            rows += [] if row is None else [row]
        return rows

    def _shape(self, shape: _Element, model: _Element, pose: Pose) -> tuple[float, float, float] | None:
        if shape.tag == "plane":
            normal = shape.one("normal")
            if pose[2] > 0.0 or (normal is not None and self.numbers(normal, 3) != [0.0, 0.0, 1.0]):
                raise self.fail(shape, f"{model.name} is a plane that is not the ground; not supported")
            return None
        if shape.tag != "cylinder":
            raise self.fail(shape, f"{model.name} is a <{shape.tag}>; only upright cylinders can be read")
        sizes = []
        for name in ("radius", "length"):
            element = shape.one(name)
            if element is None:
                raise self.fail(shape, f"the cylinder of {model.name} lacks its <{name}>")
            sizes += self.numbers(element, 1)
        radius, length = sizes
        x, y, z, _ = pose
        if not 0.0 < radius <= 10.0 or max(abs(x), abs(y)) > 1000.0:
            raise self.fail(shape, f"cylinder at ({x:g}, {y:g}) of radius {radius:g} m; allowed +-1000 m and 0..10 m")
        if z - length / 2 > _LIDAR_M[0] or z + length / 2 < _LIDAR_M[1]:
            raise self.fail(
                shape,
                f"{model.name} reaches from {z - length / 2:g} to {z + length / 2:g} m; an obstacle must stand on the "
                f"ground and be at least {_LIDAR_M[1]} m high",
            )
        return (x, y, radius)


def _composed(outer: Pose, inner: Pose) -> Pose:
    """The pose of a frame `inner`, given in the frame `outer`, in outer's parent."""
    if inner == (0.0, 0.0, 0.0, 0.0):
        return outer
    c, s = math.cos(outer[3]), math.sin(outer[3])
    x, y, z, yaw = inner
    return (outer[0] + c * x - s * y, outer[1] + s * x + c * y, outer[2] + z, outer[3] + yaw)


def parse_sdf(data: bytes, where: str) -> NDArray[np.float64]:
    """(n, 3) x, y, radius, m, of the cylinders in file order; UserError names `where`, the line and what is wrong."""
    reader = _Reader(where)
    try:
        reader.parser.Parse(data, True)
    except expat.ExpatError as error:
        raise UserError(f"{where}, line {error.lineno}: not well-formed SDF ({error})") from error
    return reader.world()
