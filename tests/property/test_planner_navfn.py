"""The global plan on random maps: the bounded wave finds what the whole one finds, and plans can be driven."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist import _native
from appl_dist.planner.parameters import PlannerSettings
from appl_dist.spec import DWA

SIDE = 160


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 250), st.floats(0.1, 0.5))
def test_bounded_wave_gives_the_plan_of_the_whole_wave(seed, blocks, radius):
    rng = np.random.default_rng(seed)
    lethal = np.zeros((SIDE, SIDE), np.uint8)
    for x, y in rng.integers(0, SIDE, (blocks, 2)):
        lethal[y : y + 2, x : x + 2] = 254
    values = DWA.defaults
    values[7] = radius
    planner = _native.Planner(PlannerSettings(global_size_m=SIDE * 0.05, global_origin_m=0.0), values)
    planner.load_map(False, lethal, 0.0, 0.0)
    planner.inflate(False)
    for _ in range(3):  # the second and third start from what the one before needed
        start, goal = rng.uniform(0.1, SIDE * 0.05 - 0.1, (2, 2))
        bounded, whole = planner.plan_between(start, goal, False), planner.plan_between(start, goal, True)
        assert bounded.tolist() == whole.tolist()
        if len(whole):
            assert whole[-1].tolist() == goal.tolist()
            steps = np.hypot(*np.diff(whole[:-1], axis=0).T)
            assert not len(steps) or steps.max() < 0.11  # half a cell each, a cell's diagonal at the wave's edge
