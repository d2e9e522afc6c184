"""The C roll-outs against `planner/reference.py` on random maps, plans, poses and parameters."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist import _native
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.planner.reference import Costmap, Parameters, TrajectoryScorer
from appl_dist.spec import LaserGeometry

SIDE = 80  # cells, 4 m


def inflated(planner, lethal, origin):
    planner.load_map(True, lethal, *origin)
    planner.inflate(True)
    return planner.map(True, False)


@st.composite
def scenes(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    lethal = np.zeros((SIDE, SIDE), np.uint8)
    for x, y in rng.integers(0, SIDE, (draw(st.integers(0, 14)), 2)):
        lethal[y : y + 3, x : x + 3] = 254
    heading = rng.uniform(-np.pi, np.pi)
    bends = np.cumsum(rng.normal(0, 0.1, 90)) + heading
    plan = np.cumsum(np.stack([np.cos(bends), np.sin(bends)], 1) * rng.uniform(0.02, 0.07), 0)
    pose = np.array([*rng.normal(0, 0.1, 2), heading + rng.normal(0, 0.4)]).astype(np.float32).astype(float)
    twist = np.array([rng.uniform(-0.5, 2), rng.uniform(-3, 3)]).astype(np.float32).astype(float)
    values = np.array(
        [
            rng.uniform(0.2, 2),
            rng.uniform(0.4, 3),  # above min_in_place_vel_theta
            draw(st.integers(1, 4)),
            draw(st.integers(1, 6)),
            rng.uniform(0, 1),
            rng.uniform(0, 1.5),
            rng.uniform(0, 2),
            rng.uniform(0.1, 0.5),
        ]
    )
    return lethal, plan, pose, twist, values, draw(st.booleans()), draw(st.sampled_from([0.6, 1.0, 2.0]))


@settings(max_examples=60, deadline=None)
@given(scenes())
def test_rollouts_equal_the_plain_python(scene):
    lethal, plan, pose, twist, values, meter, sim_time = scene
    chosen = PlannerSettings(meter_scoring=meter, sim_time=sim_time, local_size_m=SIDE * 0.05)
    origin = (-2.0, -2.0)
    found = {}
    for trace in (False, True):
        planner = _native.Planner(chosen, LaserGeometry(), values)
        planner.reset(np.zeros(3))
        costs = inflated(planner, lethal, origin)
        planner.set_plan(plan, 0.0)
        ok, command, rows = planner.local_command(pose, twist, trace)
        found[trace] = (ok, command.tolist(), planner.best_sample().tolist(), planner.best().tolist())
        near_goal = len(rows) > 0 and planner.status()["rotating_to_goal"]
    assert found[True] == found[False] or np.isnan(found[True][2]).all()
    if np.isnan(found[True][2]).all() or near_goal:
        return
    first, count = _local_part(plan, pose)
    # The yaws pass through a quaternion and everything through float32 before the roll-outs see them.
    yaw, rate = (np.float32(2 * np.arctan2(np.sin(a / 2), np.cos(a / 2))) for a in (pose[2], twist[1]))
    scorer = TrajectoryScorer(chosen, Parameters(*values), Costmap(costs, 0.05, origin), plan[first : first + count])
    best = scorer.best((pose[0], pose[1], float(yaw)), (twist[0], float(rate)))
    _, _, sample, points = found[True]
    np.testing.assert_allclose(sample, [best.v, best.w, best.cost], rtol=0, atol=2e-6)
    assert len(points) == len(best.points)
    path, goal = planner.wavefronts()
    np.testing.assert_array_equal(path, scorer.path)
    np.testing.assert_array_equal(goal, scorer.goal)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([45, 64, 133, 200, 240]), st.integers(1, 100), st.integers(1, 90))
def test_the_search_takes_what_scoring_every_sample_takes(seed, side, speeds, rates):
    """Any number of samples, also more than are searched at a time, and any width of map."""
    rng = np.random.default_rng(seed)
    half = side * 0.05 / 2
    lethal = np.zeros((side, side), np.uint8)
    for x, y in rng.integers(0, side, (int(rng.integers(0, 1 + side // 4)), 2)):
        lethal[y : y + 3, x : x + 3] = 254
    heading = rng.uniform(-np.pi, np.pi)
    bends = np.cumsum(rng.normal(0, 0.1, 90)) + heading
    plan = np.cumsum(np.stack([np.cos(bends), np.sin(bends)], 1) * rng.uniform(0.02, 0.07), 0)
    origin = tuple(-half + rng.uniform(-0.05, 0.05, 2))
    pose, twist = np.array([*rng.normal(0, 0.1, 2), heading]), rng.uniform([-0.5, -3], [2, 3])
    values = np.array([*rng.uniform([0.2, 0.4], [2, 3]), speeds, rates, *rng.uniform(0, [1, 1.5, 2, 0.5])])
    found = []
    for trace in (False, True):
        planner = _native.Planner(PlannerSettings(local_size_m=side * 0.05), LaserGeometry(), values)
        planner.reset(np.zeros(3))
        inflated(planner, lethal, origin)
        planner.set_plan(plan, 0.0)
        ok, command, _ = planner.local_command(pose, twist, trace)
        waves = planner.wavefronts().tolist() if not np.isnan(planner.best_sample()).all() else None
        found.append((ok, command.tolist(), planner.best_sample().tolist(), planner.best().tolist(), waves))
    assert found[0] == found[1] or np.isnan(found[1][2]).all()


def _local_part(plan, pose):
    """Cut at half the map's width (and one point more), then drop what is a metre or more behind."""
    distance = np.hypot(*(plan - pose[:2]).T)
    inside = np.flatnonzero(distance <= SIDE * 0.05 / 2)
    first = inside[0]
    outside = np.flatnonzero(distance[first:] > SIDE * 0.05 / 2)
    end = first + outside[0] + 1 if len(outside) else len(plan)
    while first < end and not distance[first] < 1:
        first += 1
    return first, end - first
