"""The C boundary: the search finds what scoring every sample finds, whatever the map; bad input is refused by name."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist import _native
from appl_dist.planner.dwa import DWA
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.spec import LaserGeometry

EXTREMES = st.sampled_from([-7.0, -5.0, -4.999999, 0.0, 0.025, 4.95, 4.975, 5.0, 5.000001, 300.0, 1e12])


def random_planner(rng, chosen, blocks, smear):
    """A planner in the middle of a local map with random blocks and costs, and a plan across it."""
    values = np.array([rng.uniform(0.1, 4), rng.uniform(0.3, 6), rng.integers(1, 15), rng.integers(1, 45),
                       *rng.uniform(0, 2, 3), rng.uniform(0, 0.7)])  # fmt: skip
    planner = _native.Planner(chosen, LaserGeometry(), values)
    planner.reset(np.zeros(3))
    side = len(planner.map(True, False))
    cost = np.zeros((side, side), np.uint8)
    for x, y in rng.integers(0, side, (blocks, 2)):
        cost[y : y + 2, x : x + 2] = 254
    half = side * chosen.resolution_m / 2
    planner.load_map(True, cost, -half, -half)
    planner.inflate(True)
    if smear:  # costs no inflation makes, unknown cells among them
        cost = planner.map(True, False)
        cost[rng.random(cost.shape) < 0.02] = rng.integers(0, 256)
        planner.load_map(True, cost, -half, -half)
    corners = np.vstack([[0.0, 0.0], rng.uniform(-1.3 * half, 1.3 * half, (rng.integers(1, 4), 2))])
    along = np.linspace(0, len(corners) - 1, rng.integers(1, 150))
    plan = np.stack([np.interp(along, np.arange(len(corners)), corners[:, i]) for i in (0, 1)], axis=1)
    planner.set_plan(plan, rng.uniform(-4, 4))
    return planner


def state(planner):
    # As text: a cycle without any sample leaves NaN, which equals nothing.
    return str((planner.best_sample().tolist(), planner.status(), planner.best().tolist()))


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 120),
    st.booleans(),
    st.booleans(),
    st.sampled_from([2.0, 5.0, 10.0, 12.0]),
    st.sampled_from([0.5, 2.0, 3.0]),
    st.sampled_from([(10.0, 20.0), (0.4, 0.7), (1000.0, 1000.0)]),
)
def test_search_chooses_what_scoring_every_sample_chooses(seed, blocks, smear, meter, size, sim_time, limits):
    chosen = PlannerSettings(
        local_size_m=size,
        global_size_m=2.0,
        meter_scoring=meter,
        sim_time=sim_time,
        acc_lim_x=limits[0],
        acc_lim_theta=limits[1],
    )
    searched, scored = (random_planner(np.random.default_rng(seed), chosen, blocks, smear) for _ in range(2))
    rng = np.random.default_rng(seed)
    for turn in range(3):  # flags of a cycle decide the next
        pose = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-4, 4)]) if turn or seed % 3 else np.zeros(3)
        twist = np.array([rng.uniform(-0.5, 2.5), rng.uniform(-3, 3)])
        found, wanted = (p.local_command(pose, twist, full) for p, full in ((searched, False), (scored, True)))
        assert found[0] == wanted[0]
        assert found[1].tolist() == wanted[1].tolist()
        assert state(searched) == state(scored)
        assert searched.rollouts == scored.rollouts


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), EXTREMES, EXTREMES, st.floats(-10, 10), st.floats(-1e38, 1e38), st.floats(-1e9, 1e9))
def test_poses_at_edges_and_absurd_twists_are_survived(seed, x, y, yaw, v, w):
    rng = np.random.default_rng(seed)
    planner = random_planner(rng, PlannerSettings(global_size_m=8.0, global_origin_m=-4.0), 60, True)
    _, command, _ = planner.local_command(np.array([x, y, yaw]), np.array([v, w]), False)
    assert not np.isnan(command).any()
    scan = rng.uniform(0, 4, 720).astype(np.float32)
    for k in range(4):
        assert np.isfinite(planner.cycle(scan, np.array([x, y, yaw]), np.array([v, w]), 0.05 * k)).all()
        planner.set_parameters(np.array([20.0, 20.0, 3.0, 5.0, 5.0, 5.0, 5.0, rng.uniform(0, 1)]))
    start, goal = np.array([x, y]), rng.uniform(-25, 25, 2)
    assert np.isfinite(planner.plan_between(start, goal, False)).all()


def test_empty_and_one_point_plans():
    planner = _native.Planner(PlannerSettings(), LaserGeometry(), DWA.defaults)
    planner.reset(np.zeros(3))
    planner.load_map(True, np.zeros((200, 200), np.uint8), -5.0, -5.0)
    planner.set_plan(np.zeros((0, 2)), 0.0)
    ok, command, _ = planner.local_command(np.zeros(3), np.zeros(2), False)
    assert (ok, command.tolist()) == (False, [0.0, 0.0])
    planner.set_plan(np.array([[0.9, 0.0]]), 0.0)  # points 1 m and more away are pruned
    ok, command, _ = planner.local_command(np.zeros(3), np.zeros(2), False)
    assert ok
    assert command[0] > 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused_by_name(bad):
    planner = _native.Planner(PlannerSettings(), LaserGeometry(), DWA.defaults)
    with pytest.raises(ValueError, match="goal"):
        planner.reset(np.array([0.0, bad, 0.0]))
    for k in range(8):
        values = DWA.defaults
        values[k] = bad
        with pytest.raises(ValueError, match=DWA.names[k]):
            planner.set_parameters(values)
    with pytest.raises(ValueError, match="start"):
        planner.plan_between(np.array([bad, 0.0]), np.zeros(2), False)
    with pytest.raises(ValueError, match="plan"):
        planner.set_plan(np.array([[0.0, bad]]), 0.0)
    with pytest.raises(ValueError, match="now_s"):
        planner.control(np.zeros(3), np.zeros(2), bad)


@pytest.mark.parametrize("change", [{"local_size_m": 1.0}, {"local_size_m": 12.0}, {"global_size_m": 1.0},
                                    {"obstacle_range": 0.0}, {"raytrace_range": 0.0},
                                    {"half_length_m": 0.05, "half_width_m": 0.05, "footprint_padding": 0.0},
                                    {"sim_time": 0.01}, {"sim_time": 10.0}, {"sim_granularity": 5.0}])  # fmt: skip
@pytest.mark.parametrize("arithmetic", ["exact", "fast"])
@pytest.mark.parametrize("beams", [2, 720])
def test_degenerate_settings_run(change, arithmetic, beams):
    if change.get("local_size_m") == 1.0:
        change = change | {"half_length_m": 0.1, "half_width_m": 0.1, "footprint_padding": 0.01}
    chosen = PlannerSettings(**change, arithmetic=arithmetic)
    planner = _native.Planner(chosen, LaserGeometry(beams), DWA.defaults)
    planner.reset(np.array([2.0, 1.0, 0.0]))
    scan = np.full(beams, 0.8, np.float32)
    for k in range(5):
        assert np.isfinite(planner.cycle(scan, np.array([0.1 * k, 0, 0]), np.zeros(2), 0.05 * k)).all()


def test_an_unknown_arithmetic_is_refused():
    with pytest.raises(ValueError, match=r"planner\.arithmetic: got 'quick'; allowed exact, fast"):
        PlannerSettings(arithmetic="quick")
