"""Whatever scans, poses, twists, parameters and orders of calls: finite commands, no crash, legal maps."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from appl_dist.planner.navigator import Navigator, State
from appl_dist.planner.planner_settings import PlannerSettings

HIGHEST = np.array([20.0, 20.0, 300.0, 300.0, 5.0, 5.0, 5.0, 1.0])
LOWEST = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])


def scan(rng, kind):
    ranges = rng.uniform(0.0, [0.4, 3.0, 40.0][kind % 3], 720).astype(np.float32)
    if kind > 2:
        ranges[rng.integers(0, 720, 200)] = rng.choice([np.nan, np.inf, -np.inf, -1.0, 0.0, 3e38], 200)
    return ranges


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.sampled_from(["exact", "fast"]),
    st.sampled_from([1.0, 4.0, 10.0]),
    st.sampled_from([5.0, 40.0]),
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=3, max_size=25),
)
def test_any_sequence_of_calls_is_survived(seed, meter, arithmetic, local, reach, calls):
    rng = np.random.default_rng(seed)
    chosen = PlannerSettings(
        meter_scoring=meter,
        arithmetic=arithmetic,
        local_size_m=max(local, 2.0),
        global_size_m=reach,
        global_origin_m=-reach / 2,
        sim_time=1.0,
    )
    navigator = Navigator(chosen)
    navigator.reset(np.array([*rng.uniform(-reach / 2, reach / 2, 2), rng.uniform(-9, 9)]))
    pose = rng.uniform(-reach / 3, reach / 3, 3)
    for k, (call, kind) in enumerate(calls):
        pose = pose + rng.normal(0, [0.02, 0.5, 30.0][kind % 3], 3)
        twist = rng.normal(0, [0.3, 3.0, 1e6][kind % 3], 2)
        if call == 0:
            values = rng.uniform(LOWEST, np.where(rng.random(8) < 0.2, HIGHEST, np.minimum(HIGHEST, 6.0)))
            navigator.set_parameters(np.minimum(values, [20, 20, 40, 40, 5, 5, 5, 1]))
        elif call == 1:
            navigator.add_scan(scan(rng, kind), pose)
            navigator.update_local_map(pose)
        elif call == 2:
            navigator.update_global_map(pose)
        elif call == 3:
            navigator.plan(pose, 0.05 * k)
        else:
            command = navigator.cycle(scan(rng, kind), pose, twist, 0.05 * k)
            assert np.isfinite(command).all()
        assert set(np.unique(navigator.local_costmap[navigator.local_costmap >= 253])) <= {253, 254}
        assert np.isfinite(navigator.path).all()
        assert -np.pi <= navigator.local_goal_bearing(pose) <= np.pi
        assert navigator.state in State
        assert navigator.rollouts >= 0
