from __future__ import annotations

import dataclasses

import numpy as np

from appl_dist.learner.augment import mirrored
from appl_dist.learner.rows import Batch
from appl_dist.sim.simulator import LidarSettings, Simulator
from appl_dist.spec import BEARING, LIDAR_BEAMS, OBSERVATION_SIZE, PARAMETERS, SCAN
from tests.unit.sim.courses import course


def batch(size: int) -> Batch:
    rng = np.random.default_rng(0)

    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(-1, 1, shape).astype(np.float32)

    return Batch(
        uniform(size, OBSERVATION_SIZE), uniform(size, 8), uniform(size), uniform(size), uniform(size, OBSERVATION_SIZE)
    )


def test_half_of_the_transitions_are_mirrored_in_both_states_and_nothing_else_changes() -> None:
    before = batch(2000)
    after = mirrored(before, np.random.default_rng(1))
    changed = after.observations[:, BEARING] != before.observations[:, BEARING]
    assert 0.45 < changed.mean() < 0.55
    for old, new in (
        (before.observations, after.observations),
        (before.next_observations, after.next_observations),
    ):
        np.testing.assert_array_equal(new[~changed], old[~changed])
        np.testing.assert_array_equal(new[changed, SCAN], old[changed, SCAN][:, ::-1])
        np.testing.assert_array_equal(new[changed, BEARING], -old[changed, BEARING])
        np.testing.assert_array_equal(new[:, PARAMETERS], old[:, PARAMETERS])
    for name in ("actions", "returns", "discounts"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    again = mirrored(after, np.random.default_rng(1))
    np.testing.assert_array_equal(again.observations, before.observations)


def test_a_mirrored_course_gives_the_mirrored_scan() -> None:
    cylinders = np.array([[1.2, 0.5, 0.1], [0.4, -0.9, 0.2], [-0.3, 1.1, 0.15]])
    scans = []
    for side in (1.0, -1.0):
        simulator = Simulator(lidar=dataclasses.replace(LidarSettings(), noise_m=0.0))
        simulator.reset(course(*(cylinders * [1.0, side, 1.0])), 0, np.zeros(3))
        scans.append(np.array(simulator.scan()))
        simulator.close()
    assert (scans[0] < 2.0).sum() > LIDAR_BEAMS / 20
    np.testing.assert_allclose(scans[0], scans[1][::-1], atol=1e-4)
