"""The closed loop of robot and planner: one clock, the events of timing.py, simulator and navigator.

In: a world, a start, a goal and planner parameters. Out: the robot driving. The simulator lives in the world frame;
the navigator lives in the odometry frame, whose origin is the start position (axes parallel to the world's).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appl_dist.actor.timing import TimingSettings
from appl_dist.planner.navigator import Navigator
from appl_dist.sim.simulator import Pose, Simulator
from appl_dist.sim.worlds import World
from appl_dist.spec import FloatArray

Array = NDArray[np.float64]
NEVER = 1 << 60


class Rate:
    """`ros::Rate`: cycles lie on a grid of one period; after an overrun the next starts at once."""

    def __init__(self, period_ms: int, phase_ms: int) -> None:
        self.period_ms = period_ms
        self.due_ms = phase_ms  # when the next cycle starts
        self._grid_ms = phase_ms

    def wait(self, until_ms: int) -> None:
        """Something else holds what the cycle needs: start it later, on the same grid."""
        self.due_ms = until_ms

    def finish(self, now_ms: int) -> None:
        """The cycle has ended: sets when the next one starts."""
        expected = self._grid_ms + self.period_ms
        late = now_ms > expected + self.period_ms  # more than a whole period: forget the old grid
        self._grid_ms = now_ms if late else expected
        self.due_ms = max(expected, now_ms)


class _Stamp(NamedTuple):
    """When and where the lidar fired: true pose in the world, estimated pose in the odometry frame. Cast when read."""

    time_ms: int
    pose: Pose
    pose_odom: Pose


class NavigationLoop:
    """Robot and planner coupled by the event model. Deterministic: world, seed and parameters fix every event."""

    def __init__(self, simulator: Simulator, navigator: Navigator, timing: TimingSettings) -> None:
        self.simulator = simulator
        self.navigator = navigator
        self.timing = timing

    def reset(self, world: World, seed: int, start: Array, goal: Array) -> None:
        """Put the robot at `start` (3,) of `world` and send it to `goal` (2,), both in the world frame."""
        t = self.timing
        rng = np.random.default_rng([seed, 0x7151])
        phase = [
            int(rng.integers(period)) if t.random_phases else 0
            for period in (
                t.local_map_period_ms,
                t.global_map_period_ms,
                t.plan_period_ms,
                t.control_period_ms,
            )
        ]
        filter_phase_ms = int(rng.integers(t.scan_period_ms)) if t.random_phases else 0
        self._odometry_delay_ms = t.odometry_delay_ms + filter_phase_ms
        # A scan waits for the transform of its stamp.
        self._scan_delay_ms = max(t.scan_delay_ms, self._odometry_delay_ms)
        self.simulator.reset(world, seed, start)
        self.origin = float(start[0]), float(start[1])
        self.navigator.reset(np.array([goal[0] - start[0], goal[1] - start[1], 0.0]))
        self.now_ms = 0
        self._command = (0.0, 0.0)
        self._received_ms = 0
        self._in_flight: list[tuple[int, tuple[float, float]]] = []  # commands on their way to the wheels
        self._scan_due_ms = 0
        self._scans: list[tuple[int, _Stamp]] = []  # usable from
        self._estimates: list[tuple[int, Pose, tuple[float, float]]] = []  # usable from, pose, twist
        self._local = Rate(t.local_map_period_ms, phase[0])
        self._global = Rate(t.global_map_period_ms, phase[1])
        self._plan = Rate(t.plan_period_ms, phase[2])
        self._control = Rate(t.control_period_ms, phase[3])
        self._planning_from: Array | None = None
        self._plan_done_ms = NEVER
        self._control_done_ms = 0
        self._work_due_ms = self._next_work_ms()
        self._sense()
        self.estimate = self._estimate()

    def advance(self, duration_ms: int, stop: Callable[[], bool]) -> None:
        """Run for `duration_ms`, or until `stop()`, asked whenever the lidar has fired, is true."""
        end_ms = self.now_ms + duration_ms
        while True:
            arrival_ms = self._in_flight[0][0] if self._in_flight else NEVER
            scan_ms, work_ms = self._scan_due_ms, self._work_due_ms
            # Simultaneous events in the order of the data's way, so that `ideal` is one synchronous tick.
            if arrival_ms <= scan_ms and arrival_ms <= work_ms and arrival_ms < end_ms:
                self._drive_until(arrival_ms)
                self._command = self._in_flight.pop(0)[1]
                self._received_ms = arrival_ms
            elif scan_ms <= work_ms and scan_ms < end_ms:
                self._drive_until(scan_ms)
                self._sense()
                if stop():
                    return
            elif work_ms < end_ms:
                self._compute(work_ms)
                self._work_due_ms = self._next_work_ms()
            else:
                self._drive_until(end_ms)
                return

    def _next_work_ms(self) -> int:
        plan_ms = self._plan.due_ms if self._planning_from is None else self._plan_done_ms
        return min(self._local.due_ms, self._global.due_ms, plan_ms, self._control.due_ms)

    @property
    def scan(self) -> FloatArray:
        """(720,) the newest scan, m, inf = no return."""
        return self.simulator.scan_from(self._newest.pose, self._newest.time_ms)

    def _drive_until(self, time_ms: int) -> None:
        if time_ms > self.now_ms:
            age_s = (self.now_ms - self._received_ms) / 1000.0
            self.simulator.step(self._command, (time_ms - self.now_ms) / 1000.0, age_s)
            self.now_ms = time_ms

    def _sense(self) -> None:
        """The lidar fires and odometry is published, on the same 50 Hz grid."""
        pose, (x, y, yaw), twist = self.simulator.readings()
        pose_odom = (x - self.origin[0], y - self.origin[1], yaw)
        now_ms, t = self.now_ms, self.timing
        self._newest = _Stamp(now_ms, pose, pose_odom)
        self._scans.append((now_ms + self._scan_delay_ms, self._newest))
        self._estimates.append((now_ms + self._odometry_delay_ms, pose_odom, twist))
        self._scan_due_ms = now_ms + t.scan_period_ms

    def _estimate(self) -> tuple[Array, Array]:
        """Pose (3,) in the odometry frame and twist (2,), as the wheels and the IMU told them last."""
        _, pose, twist = self._estimates[0]
        return np.array(pose), np.array(twist)

    def _newest_estimate(self, now_ms: int) -> tuple[Array, Array]:
        waiting = self._estimates
        if waiting and waiting[0][0] <= now_ms:
            while len(waiting) > 1 and waiting[1][0] <= now_ms:
                del waiting[0]
            self.estimate = self._estimate()
            del waiting[0]
        return self.estimate

    def _delay_ms(self, work_ms: float) -> int:
        return math.ceil(work_ms * self.timing.cpu_factor)

    def _compute(self, now_ms: int) -> None:
        """Run the map, plan or control cycle that is due at `now_ms`."""
        pose, twist = self._newest_estimate(now_ms)
        t = self.timing
        if now_ms == self._local.due_ms:
            if now_ms < self._control_done_ms:  # control holds the local map: wait for it
                self._local.wait(self._control_done_ms)
                return
            self._give_scan(now_ms)
            self.navigator.update_local_map(pose)
            self._local.finish(now_ms)
        elif now_ms == self._global.due_ms:
            if self._planning_from is not None and now_ms < self._plan_done_ms:  # planning holds the global map
                self._global.wait(self._plan_done_ms)
                return
            self._give_scan(now_ms)
            self.navigator.update_global_map(pose)
            self._global.finish(now_ms)
        elif self._planning_from is None and now_ms == self._plan.due_ms:
            # The map is held while planning, so computing at the end from the pose at the start is the same.
            self._planning_from = pose
            self._plan_done_ms = now_ms + self._delay_ms(t.plan_ms)
        elif self._planning_from is not None and now_ms == self._plan_done_ms:
            self.navigator.plan(self._planning_from)
            self._planning_from = None
            self._plan.finish(now_ms)
        else:
            v, w = self.navigator.control(pose, twist, now_ms / 1000.0).tolist()
            work_ms = t.control_base_ms + t.control_us_per_step * self.navigator.rollout_steps / 1000.0
            self._control_done_ms = now_ms + self._delay_ms(work_ms)
            self._in_flight.append((self._control_done_ms + t.command_delay_ms, (v, w)))
            self._control.finish(self._control_done_ms)

    def _give_scan(self, now_ms: int) -> None:
        newest = None
        while self._scans and self._scans[0][0] <= now_ms:
            newest = self._scans.pop(0)[1]
        if newest is not None:
            ranges = self.simulator.scan_from(newest.pose, newest.time_ms)
            self.navigator.add_scan(ranges, np.array(newest.pose_odom))
