"""The sizes of the papers' environment: 720 beams, the parameters of DWA, and the observation made of both."""

from __future__ import annotations

from appl_dist.planner.dwa import DWA
from appl_dist.policy.observation import PAPER, layout_of
from appl_dist.spec import LaserGeometry

LAYOUT = layout_of(PAPER, LaserGeometry().beams, DWA)
LIDAR_BEAMS, OBSERVATION_SIZE = LAYOUT.scan_size, LAYOUT.size
SIZES = {"observation_size": OBSERVATION_SIZE, "scan_size": LIDAR_BEAMS, "action_size": len(DWA)}  # of a replay
