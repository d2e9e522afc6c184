import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from appl_dist.planner.dwa import DWA, DWA_WIDE
from appl_dist.spec import Rollout
from tests.paper_sizes import LIDAR_BEAMS, OBSERVATION_SIZE


@given(st.lists(st.floats(-1, 1, width=32), min_size=8, max_size=8))
def test_values_lie_in_the_box_and_map_back(action: list[float]) -> None:
    values = DWA.to_values(np.array(action, np.float32))
    assert (values >= DWA.low).all()
    assert (values <= DWA.high).all()
    assert np.array_equal(values[DWA.integer], np.rint(values[DWA.integer]))
    assert DWA.to_values(DWA.to_action(values)) == pytest.approx(values, rel=1e-5)


def test_defaults_are_the_published_ones() -> None:
    assert DWA.defaults.tolist() == [0.5, 1.57, 6, 20, 0.1, 0.75, 1.0, 0.3]
    assert (DWA_WIDE.low <= DWA.low).all()
    assert (DWA_WIDE.high >= DWA.high).all()


def rollout(n: int = 3, **changes: object) -> Rollout:
    fields = {
        "observations": np.zeros((n + 1, OBSERVATION_SIZE), np.float32),
        "actions": np.zeros((n, 8), np.float32),
        "rewards": np.zeros(n, np.float32),
        "terminal": False,
        "info": {},
        "scan_size": LIDAR_BEAMS,
    }
    return Rollout(**{**fields, **changes})  # type: ignore[arg-type]


def test_a_good_rollout_passes() -> None:
    rollout().check()


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"observations": np.zeros((3, OBSERVATION_SIZE), np.float32)}, "observations"),
        ({"observations": np.zeros((4, OBSERVATION_SIZE))}, "observations"),
        ({"actions": np.full((3, 8), 1.5, np.float32)}, "actions"),
        ({"actions": np.full((3, 8), np.nan, np.float32)}, "actions"),
        ({"rewards": np.full(3, np.inf, np.float32)}, "rewards"),
        ({"rewards": np.zeros(0, np.float32)}, "rewards"),
    ],
)
def test_a_broken_rollout_is_named(changes: dict[str, object], field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        rollout(**changes).check()


def test_the_action_of_the_defaults_gives_exactly_the_defaults() -> None:
    """0.30000000045 m of inflation would be seven cells of 0.05 m, not six, and another robot."""
    for space in (DWA, DWA_WIDE):
        assert space.to_values(space.to_action(space.defaults)).tolist() == space.defaults.tolist()
