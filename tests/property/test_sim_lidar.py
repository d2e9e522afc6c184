"""Any scan among any cylinders is the exact intersection of every beam with every circle."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist._native import Lidar

coordinate = st.floats(-40.0, 40.0)
cylinders_of = st.lists(st.tuples(coordinate, coordinate, st.floats(0.01, 3.0)), min_size=0, max_size=12)


def exact(pose: np.ndarray, cylinders: np.ndarray, low: float, high: float, beams: int) -> np.ndarray:
    """(beams,) first intersections, by the quadratic formula for all pairs."""
    angles = pose[2] + low + np.arange(beams) * ((high - low) / (beams - 1))
    ranges = np.full(beams, np.inf)
    for x, y, radius in cylinders:
        dx, dy = x - pose[0], y - pose[1]
        if math.hypot(dx, dy) <= radius:
            continue  # a lidar inside a cylinder sees the others
        along = dx * np.cos(angles) + dy * np.sin(angles)
        across = dy * np.cos(angles) - dx * np.sin(angles)
        inside = radius**2 - across**2
        hit = (inside >= 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], np.maximum(along[hit] - np.sqrt(inside[hit]), 0.1))
    ranges[ranges > 30.0] = np.inf
    return ranges


@settings(max_examples=150, deadline=None)
@given(
    pose=st.tuples(coordinate, coordinate, st.floats(-10.0, 10.0)),
    cylinders=cylinders_of,
    half=st.sampled_from([0.3, 2.35619, math.pi]),
)
def test_a_scan_is_exact(
    pose: tuple[float, float, float], cylinders: list[tuple[float, float, float]], half: float
) -> None:
    beams = 181
    at, obstacles = np.array(pose), np.array(cylinders, np.float64).reshape(-1, 3)
    ranges = np.empty(beams, np.float32)
    Lidar(beams, -half, half, 0.1, 30.0, 0.0).cast(at, obstacles, 0, 0, ranges)
    expected = exact(at, obstacles, -half, half, beams)
    # A beam that touches a circle within rounding may count as a hit or not.
    wrong = ~np.isclose(ranges, expected, rtol=1e-6, atol=1e-4)
    if wrong.any():
        for nudge in (-1e-9, 1e-9):
            grown = obstacles + np.array([0.0, 0.0, nudge])
            wrong &= ~np.isclose(ranges, exact(at, grown, -half, half, beams), rtol=1e-6, atol=1e-4)
    assert not wrong.any()


@settings(max_examples=50, deadline=None)
@given(cylinders=cylinders_of, seed=st.integers(0, 2**64 - 1), stamp=st.integers(0, 2**40))
def test_the_order_of_obstacles_does_not_matter(
    cylinders: list[tuple[float, float, float]], seed: int, stamp: int
) -> None:
    lidar, obstacles = Lidar(180, -2.0, 2.0, 0.1, 30.0, 0.01), np.array(cylinders, np.float64).reshape(-1, 3)
    scans = np.empty((2, 180), np.float32)
    lidar.cast(np.zeros(3), obstacles, seed, stamp, scans[0])
    lidar.cast(np.zeros(3), np.ascontiguousarray(obstacles[::-1]), seed, stamp, scans[1])
    np.testing.assert_array_equal(scans[0], scans[1])
