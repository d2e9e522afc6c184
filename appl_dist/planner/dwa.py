"""The parameters of ROS's TrajectoryPlannerROS that APPL tunes, in the order in which the planner takes them."""

from __future__ import annotations

from appl_dist.spec import Parameter, ParameterSpace

NAME = "dwa"
_ROWS = (
    ("max_vel_x", 0.5, "m/s", False),
    ("max_vel_theta", 1.57, "rad/s", False),
    ("vx_samples", 6, "", True),
    ("vtheta_samples", 20, "", True),
    ("occdist_scale", 0.1, "", False),
    ("pdist_scale", 0.75, "", False),
    ("gdist_scale", 1.0, "", False),
    ("inflation_radius", 0.30, "m", False),
)


def _space(name: str, bounds: tuple[tuple[float, float], ...]) -> ParameterSpace:
    rows = zip(_ROWS, bounds, strict=True)
    return ParameterSpace(name, NAME, tuple(Parameter(n, d, lo, hi, u, i) for (n, d, u, i), (lo, hi) in rows))


# APPLR's bounds (journal Tab. I and Sec. V-D).
DWA = _space(
    "dwa",
    ((0.2, 2.0), (0.314, 3.14), (4, 20), (4, 60), (0.05, 1.0), (0.1, 1.5), (0.1, 2.0), (0.01, 0.5)),
)
# Bounds that also hold every parameter set published for APPLD and APPLI, for cloning them.
DWA_WIDE = _space(
    "dwa_wide",
    ((0.1, 2.0), (0.314, 3.14), (4, 20), (3, 60), (0.01, 1.0), (0.1, 1.5), (0.1, 2.0), (0.005, 0.6)),
)
