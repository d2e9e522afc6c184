"""The costmaps against plain Python: cells a scan frees and marks, and costs around lethal cells."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from appl_dist import _native
from appl_dist.planner.dwa import DWA
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import LaserGeometry

LASER = LaserGeometry(beams=90)
RES = 0.05


def with_radius(radius_m):
    values = DWA.defaults
    values[7] = radius_m
    return values


def line_cells(x0, y0, x1, y1, reach):
    """Costmap2D::raytraceLine, step by step."""
    ax, ay = abs(x1 - x0), abs(y1 - y0)
    sx, sy = (1 if x1 >= x0 else -1), (1 if y1 >= y0 else -1)
    along_x = ax >= ay
    far, near = max(ax, ay), min(ax, ay)
    cut = 1.0 if ax == ay == 0 else min(1.0, reach / math.hypot(ax, ay))
    x, y, error = x0, y0, far // 2
    yield x, y
    for _ in range(int(cut * far)):
        x, y = (x + sx, y) if along_x else (x, y + sy)
        error += near
        if error >= far:
            error -= far
            x, y = (x, y + sy) if along_x else (x + sx, y)
        yield x, y


class Layer:
    """costmap_2d::ObstacleLayer of a rolling or fixed window; without the robot's footprint."""

    def __init__(self, side, origin, rolling):
        self.side, self.origin, self.rolling = side, list(origin), rolling
        self.cells = np.zeros((side, side), bool)

    def cell(self, x, y):
        if not (x >= self.origin[0] and y >= self.origin[1]):
            return None
        cx, cy = (x - self.origin[0]) / RES, (y - self.origin[1]) / RES
        return (int(cx), int(cy)) if cx < self.side and cy < self.side else None

    def follow(self, pose):
        half = (self.side - 1 + 0.5) * RES / 2
        shift = [int((pose[k] - half - self.origin[k]) / RES) for k in (0, 1)]
        if not any(shift):
            return
        self.origin = [self.origin[k] + shift[k] * RES for k in (0, 1)]
        moved = np.zeros_like(self.cells)
        for y, x in np.argwhere(self.cells):
            if 0 <= y - shift[1] < self.side and 0 <= x - shift[0] < self.side:
                moved[y - shift[1], x - shift[0]] = True
        self.cells = moved

    def cut(self, sensor, x, y):
        (sx, sy), (ox, oy) = sensor, self.origin
        end_x, end_y = ox + self.side * RES, oy + self.side * RES
        a, b = x - sx, y - sy
        if x < ox:
            x, y = ox, sy + b * ((ox - sx) / a)
        if y < oy:
            x, y = sx + a * ((oy - sy) / b), oy
        if x > end_x:
            x, y = end_x - 0.001, sy + b * ((end_x - sx) / a)
        if y > end_y:
            x, y = sx + a * ((end_y - sy) / b), end_y - 0.001
        return x, y

    def observe(self, sensor, points, raytrace_m, obstacle_m):
        start = self.cell(*sensor)
        if start:
            for x, y in points:
                end = self.cell(*self.cut(sensor, x, y))
                if end:
                    for cx, cy in line_cells(*start, *end, math.ceil(raytrace_m / RES)):
                        self.cells[cy, cx] = False
        for x, y in points:
            cell = self.cell(x, y)
            if cell and (x - sensor[0]) ** 2 + (y - sensor[1]) ** 2 < obstacle_m**2:
                self.cells[cell[1], cell[0]] = True


def points_of(ranges, pose):
    """(n, 2) float32 as they pass through two clouds."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    sensor = pose[0] + LASER.mount_x_m * c, pose[1] + LASER.mount_x_m * s
    points = []
    for i, r in enumerate(ranges.astype(float)):
        if not 0 < r < 1e6:
            continue
        angle = -LASER.angle_max_rad + i * (2 * LASER.angle_max_rad / (LASER.beams - 1))
        x, y = float(np.float32(r * math.cos(angle))), float(np.float32(r * math.sin(angle)))
        points.append((float(np.float32(sensor[0] + (x * c - y * s))), float(np.float32(sensor[1] + (x * s + y * c)))))
    return sensor, points


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(3.0, 2.5), (0.7, 2.0), (8.0, 8.0), (2.5, 0.0)]),
    st.sampled_from([0.6, 2.5, 9.0]),
)
def test_scans_free_and_mark_the_cells_of_the_plain_layer(seed, ranges_m, reach):
    rng = np.random.default_rng(seed)
    chosen = PlannerSettings(
        local_size_m=4.0, global_size_m=5.0, global_origin_m=-2.5, half_length_m=0.05, half_width_m=0.05,
        footprint_padding=0.0, raytrace_range=ranges_m[0], obstacle_range=ranges_m[1],
    )  # fmt: skip
    planner = _native.Planner(chosen, LASER, with_radius(0.2))
    planner.reset(np.array([2.0, 0.0, 0.0]))
    layers = {True: Layer(80, (0.0, 0.0), True), False: Layer(100, (-2.5, -2.5), False)}
    pose = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
    for _ in range(6):
        pose = pose + rng.normal(0, [0.2, 0.2, 0.5])
        pose[2] = math.remainder(pose[2], math.tau)
        scan = (reach * (1 + rng.uniform(-0.9, 0.9) * rng.random(LASER.beams))).astype(np.float32)
        scan[rng.random(LASER.beams) < 0.1] = np.inf
        sensor, points = points_of(scan, pose)
        planner.add_scan(scan, pose)
        for local, layer in layers.items():
            (planner.update_local if local else planner.update_global)(pose)
            if local:
                layer.follow(pose)
            layer.observe(sensor, points, *ranges_m)
            found = planner.map(local, True) == 254
            np.testing.assert_array_equal(planner.origin(local), layer.origin)
            robot = layer.cell(*pose[:2])
            differing = np.argwhere(found != layer.cells)
            # The robot's own cells are freed besides: a square of 0.1 m.
            if len(differing):
                assert robot is not None
                assert (abs(differing - np.array(robot)[::-1]) <= 2).all()
                assert not found[tuple(differing.T)].any()
            layer.cells = found


def random_walls(rng, side):
    lethal = rng.random((side, side)) < rng.choice([0.0, 0.01, 0.1])
    for _ in range(rng.integers(1, 40)):
        x, y, dx, dy = *rng.integers(0, side, 2), *rng.integers(-3, 4, 2)
        for i in range(rng.integers(1, 15)):
            if 0 <= x + i * dx < side and 0 <= y + i * dy < side:
                lethal[y + i * dy, x + i * dx] = True
    return lethal


def inflated(arithmetic, radius_m, lethal):
    side = len(lethal)
    chosen = PlannerSettings(local_size_m=side * RES, global_size_m=2.0, arithmetic=arithmetic)
    planner = _native.Planner(chosen, LaserGeometry(), with_radius(radius_m))
    planner.load_map(True, lethal.astype(np.uint8) * 254, 0.0, 0.0)
    planner.inflate(True)
    return planner.map(True, False)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 20))
def test_costs_are_those_of_the_nearest_lethal_cell(seed, cells):
    lethal = random_walls(np.random.default_rng(seed), 100)
    fire, stamps = (inflated(arithmetic, round(cells * RES, 3), lethal) for arithmetic in ("exact", "fast"))
    square = np.round(distance_transform_edt(~lethal) ** 2) if lethal.any() else np.full(lethal.shape, np.inf)
    metres = np.sqrt(square) * RES
    wanted = np.floor(252 * np.exp(-10 * (metres - 0.265)))
    wanted[metres <= 0.265] = 253
    wanted[square > cells * cells] = 0
    wanted[lethal] = 254
    np.testing.assert_array_equal(stamps, wanted)
    if cells <= 4:  # where the fire of ROS finds the nearest always
        np.testing.assert_array_equal(fire, stamps)
    assert (fire <= stamps).all()
    assert (fire != stamps).mean() < 0.01


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_maps_after_any_way_are_those_inflated_at_once(seed):
    """Scans, moves and radii in any order: the local map holds what its obstacles give, inflated at once."""
    rng = np.random.default_rng(seed)
    planner = _native.Planner(PlannerSettings(global_size_m=2.0), LaserGeometry(), with_radius(0.3))
    planner.reset(np.array([5.0, 0.0, 0.0]))
    pose = np.zeros(3)
    for _ in range(12):
        pose = pose + rng.normal(0, [0.1, 0.1, 0.4])
        if rng.random() < 0.3:
            planner.set_parameters(with_radius(round(rng.integers(2, 11) * RES, 3)))
        planner.add_scan(rng.uniform(1.0, 2.2, 720).astype(np.float32).repeat(12)[:720], pose)
        planner.update_local(pose)
    radius_m = round(rng.choice([1, *range(11, 19)]) * RES, 3)
    planner.set_parameters(with_radius(radius_m))
    planner.update_local(pose)  # a changed radius renews the whole map
    np.testing.assert_array_equal(planner.map(True, False), inflated("exact", radius_m, planner.map(True, True) == 254))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([("exact", 4), ("fast", 10)]), st.booleans())
def test_maps_renewed_in_part_are_those_made_anew(seed, kind, rolling):
    """Scans with a little noise, moves, plans: the map kept between updates holds what a planner without its past makes
    of the same cells and the same window."""
    arithmetic, cells = kind
    rng = np.random.default_rng(seed)
    side_m = float(rng.choice([5.0, 7.0, 10.0]))  # the window reaches the map's edges, or not
    chosen = PlannerSettings(
        local_size_m=side_m, global_size_m=side_m, global_origin_m=-side_m / 2, arithmetic=arithmetic
    )
    planner, anew = (_native.Planner(chosen, LaserGeometry(), with_radius(0.2)) for _ in range(2))
    for each in (planner, anew):
        each.reset(np.array([3.0, 0.0, 0.0]))
    pose, walls = np.zeros(3), rng.uniform(0.8, 3.5, 60).repeat(12)
    for _ in range(15):
        pose = pose + rng.normal(0, [0.05, 0.05, 0.1]) * rng.choice([0, 1, 8])
        if rng.random() < 0.2:
            walls[rng.integers(0, 600) :][:100] = rng.uniform(0.8, 3.5)
        radius = with_radius(round(rng.integers(1, cells + 1) * RES, 3)) if rng.random() < 0.15 else None
        scan = (walls + rng.normal(0, 0.01, 720)).astype(np.float32)
        for each in (planner, anew):
            if radius is not None:
                each.set_parameters(radius)
            each.add_scan(scan, pose)
        origin = planner.origin(rolling)
        # Loading a map drops what is known of it: the update then makes its whole window anew.
        before = planner.map(rolling, False)
        anew.load_map(rolling, before, *origin)
        for each in (planner, anew):
            (each.update_local if rolling else each.update_global)(pose)
        np.testing.assert_array_equal(planner.map(rolling, True), anew.map(rolling, True))
        np.testing.assert_array_equal(planner.map(rolling, False), anew.map(rolling, False))
        if not rolling:
            planner.plan_between(pose[:2], np.array([3.0, 0.0]), False)
