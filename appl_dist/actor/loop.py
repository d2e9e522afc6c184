"""The closed loop of robot and planner: one clock, the events of timing.py, simulator and planner.

In: a world, a start, the rules of a trial and planner parameters. Out: the robot driving, and what the trial comes to.
The events run in C (`csrc/loop.h`, `csrc/trial.h`), which comes back for contacts alone: those are pybullet's. The
simulator lives in the world frame; the planner in the odometry frame, whose origin is the start (axes parallel).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appl_dist._native import LOOP_BROKEN, LOOP_CONTACT, LOOP_SAMPLED, Loop
from appl_dist.actor.protocol import TrialRules
from appl_dist.actor.timing import TimingSettings
from appl_dist.planner.planners import Planner
from appl_dist.sim.simulator import Simulator
from appl_dist.sim.worlds import World
from appl_dist.spec import FloatArray

Array = NDArray[np.float64]
TRAJECTORY = ("t_s", "x_m", "y_m", "yaw_rad", "v_mps", "w_radps")


class Stage(NamedTuple):
    """What a part of the loop has cost since it was made."""

    seconds: float
    calls: int


class NavigationLoop:
    """Robot and planner coupled by the event model. Deterministic: world, seed and parameters fix every event."""

    def __init__(self, simulator: Simulator, planner: Planner, timing: TimingSettings) -> None:
        self.simulator = simulator
        self.planner = planner
        self.timing = timing
        self.on_sample: Callable[[], None] | None = None  # told whenever the lidar has fired
        self._core = Loop(*simulator.native, getattr(planner, "native", planner), simulator.lidar.mount_x_m, timing)
        self._contact_s = 0.0

    def reset(self, world: World, seed: int, start: Array, rules: TrialRules) -> None:
        """Put the robot at `start` (3,) of `world` and send it to the goal of `rules`, both in the world frame."""
        t = self.timing
        rng = np.random.default_rng([seed, 0x7151])
        periods = (
            t.local_map_period_ms,
            t.global_map_period_ms,
            t.plan_period_ms,
            t.control_period_ms,
            t.scan_period_ms,  # the odometry filter runs on a clock of its own
        )
        phases = [int(rng.integers(period)) if t.random_phases else 0 for period in periods]
        self.simulator.reset(world, seed, start)
        x, y = float(start[0]), float(start[1])
        self.planner.reset(np.array([rules.goal_x_m - x, rules.goal_y_m - y, 0.0]))
        self._core.reset((x, y), np.array(phases, np.int64), rules)

    def advance(self, duration_ms: int) -> None:
        """Run for `duration_ms`, or until the trial is over: whenever the lidar has fired, its rules are asked."""
        end_ms = self.now_ms + duration_ms
        while True:
            pause = self._core.run(end_ms, self.on_sample is not None)
            if pause == LOOP_CONTACT:
                started = time.perf_counter()
                ms = self._core.contact_ms
                self.simulator.contact_step(ms)
                self._core.stepped(ms)
                self._contact_s += time.perf_counter() - started
            elif pause == LOOP_BROKEN:
                raise RuntimeError(f"{self.now_ms} ms: the robot's pose is not finite: {self.simulator.pose.tolist()}")
            else:
                if self.on_sample is not None:
                    self.on_sample()
                if pause != LOOP_SAMPLED:
                    return

    @property
    def now_ms(self) -> int:
        """Simulated time since reset."""
        return int(self._core.now_ms)

    @property
    def estimate(self) -> tuple[Array, Array]:
        """Pose (3,) in the odometry frame and twist (2,), as the planner was told them last."""
        pose, twist = self._core.estimate
        return np.array(pose), np.array(twist)

    @property
    def scan(self) -> FloatArray:
        """(beams,) the newest scan, m, inf = no return."""
        return self.simulator.scan_from(*self._core.newest)

    @property
    def time_s(self) -> float:
        """The trial's time by its protocol's clock."""
        return float(self._core.time_s)

    @property
    def success(self) -> bool:
        """Whether the robot was at the goal before anything ended the trial."""
        return bool(self._core.success)

    @property
    def failed(self) -> bool:
        """Whether the robot rolled over or, where the rules say so, touched something."""
        return bool(self._core.failed)

    @property
    def timed_out(self) -> bool:
        return bool(self._core.timed_out)

    @property
    def collisions(self) -> int:
        """Times the robot ran into something (contacts less than half a second apart are one)."""
        return int(self._core.collisions)

    @property
    def min_clearance_m(self) -> float:
        """Least distance from the hull to an obstacle in any sample; negative inside, at most 100."""
        return float(self._core.min_clearance_m)

    @property
    def trajectory(self) -> Array:
        """(n, 6) true poses in the world frame whenever the lidar fired, in the order of TRAJECTORY. A copy."""
        samples: Array = self._core.samples()
        return samples

    def digest(self) -> str:
        """Sixteen hex digits that stand for every bit of the trajectory."""
        return blake2b(self.trajectory.tobytes(), digest_size=8).hexdigest()

    @property
    def stages(self) -> dict[str, Stage]:
        """Wall-clock time and calls of each stage since the loop was made."""
        stages = {name: Stage(*spent) for name, spent in self._core.stages().items()}
        physics = stages["physics"]
        return stages | {"physics": physics._replace(seconds=physics.seconds + self._contact_s)}
