"""The global plan on random maps: the bounded wave finds what the whole one finds, and plans can be driven."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist import _native
from appl_dist.planner.dwa import DWA
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import LaserGeometry

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
    planner = _native.Planner(PlannerSettings(global_size_m=SIDE * 0.05, global_origin_m=0.0), LaserGeometry(), values)
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


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(20, 200), st.booleans())
def test_plans_along_a_drive_with_a_changing_map(seed, blocks, fast):
    """The bound comes from the plan before: cells blocked and freed between plans must not make it too small."""
    rng = np.random.default_rng(seed)
    lethal = np.zeros((SIDE, SIDE), np.uint8)
    for x, y in rng.integers(0, SIDE, (blocks, 2)):
        lethal[y : y + 2, x : x + 2] = 254
    arithmetic = "fast" if fast else "exact"
    planner_settings = PlannerSettings(global_size_m=SIDE * 0.05, global_origin_m=0.0, arithmetic=arithmetic)
    bounded, whole = (_native.Planner(planner_settings, LaserGeometry(), DWA.defaults) for _ in range(2))
    start, goal = rng.uniform(0.1, SIDE * 0.05 - 0.1, (2, 2))
    for _ in range(6):
        for x, y in rng.integers(0, SIDE, (8, 2)):
            lethal[y : y + 4, x : x + 4] = rng.choice([0, 254])
        for planner in (bounded, whole):
            planner.load_map(False, lethal, 0.0, 0.0)
            planner.inflate(False)
        mine, theirs = bounded.plan_between(start, goal, False), whole.plan_between(start, goal, True)
        assert (len(mine) > 0) == (len(theirs) > 0)
        if not fast:
            assert mine.tolist() == theirs.tolist()
        if len(mine) > 20:
            start = mine[rng.integers(0, 20)]  # on along the plan, as the robot does
