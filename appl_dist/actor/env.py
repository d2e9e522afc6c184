"""The meta-MDP of APPLR as a gymnasium environment: each step drives the robot for one decision period.

In: actions in [-1, 1], one per planner parameter. Out: observations of `spec.py`, rewards of `reward.py`. One episode
is one trial of a protocol in one BARN world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from appl_dist.actor.loop import NavigationLoop
from appl_dist.actor.protocol import APPL, Protocol
from appl_dist.actor.reward import REWARDS, Outcome, RewardSettings
from appl_dist.actor.timing import TimingSettings
from appl_dist.planner.planner_settings import PlannerSettings
from appl_dist.planner.planners import PLANNERS
from appl_dist.policy.observation import OBSERVATIONS, ObservationSettings
from appl_dist.sim.simulator import LidarSettings, RobotSettings, Simulator
from appl_dist.sim.worlds import World
from appl_dist.spec import FloatArray, ParameterSpace


class NavigationEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Tunes the planner of a robot every `decision_period_s` while it crosses a BARN world.

    Observation float32 (size,) of `observation_builder.layout`, action float32 (n,) in [-1, 1], one entry a parameter;
    that of the papers has 729 entries: 720 beams, the local goal, eight parameters. An episode terminates at the goal,
    in a roll-over, or in a collision where the protocol says so; the time limit truncates it. `info` holds time_s,
    success, collision, rolled_over, world, distance_m, min_clearance_m, recoveries and the parameters in force.

    `reset(options={"world": index})` picks a world; otherwise every world is visited once, in a seeded random order,
    before any is visited again.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  (gymnasium's own declaration)

    def __init__(
        self,
        worlds: Sequence[World],
        *,
        protocol: Protocol = APPL,
        decision_period_s: float = 2.0,
        space: ParameterSpace | None = None,
        observation: ObservationSettings = ObservationSettings(),
        timing: TimingSettings = TimingSettings(),
        rewards: RewardSettings = RewardSettings(),
        planner: PlannerSettings = PlannerSettings(),
        robot: RobotSettings = RobotSettings(),
        lidar: LidarSettings = LidarSettings(),
    ) -> None:
        if not worlds:
            raise ValueError("worlds: got none; an environment needs at least 1")
        if not 0.1 <= decision_period_s <= 60.0:
            raise ValueError(f"decision_period_s: got {decision_period_s}; allowed 0.1..60")
        self.worlds = {world.index: world for world in worlds}
        self.protocol = protocol
        kind = PLANNERS.get(planner.name)
        self.space = space = space or kind.parameters
        if unknown := set(space.names) - set(kind.parameters.names):
            raise ValueError(
                f"space {space.name!r}: {', '.join(sorted(unknown))}: no parameter of the planner {planner.name}"
            )
        self._defaults = kind.parameters.defaults
        self._indices = [kind.parameters.names.index(name) for name in space.names]  # the others keep their defaults
        self.rewards, self._reward = rewards, REWARDS.get(rewards.name)
        self.period_ms = round(decision_period_s * 1000)
        self.loop = NavigationLoop(Simulator(robot, lidar), kind.make(planner, lidar.geometry), timing)
        self.observation_builder = OBSERVATIONS.get(observation.name)(lidar.beams, space)
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self.observation_builder.layout.size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(space),), np.float32)
        self._order: list[int] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self._order = []
        index = (options or {}).get("world")
        if index is None:
            index = self.next_world()
        if index not in self.worlds:
            raise ValueError(f"options.world: got {index}; this environment has {len(self.worlds)} other worlds")
        self.world = self.worlds[index]
        start, self._goal = self.protocol.start(self.world), self.protocol.goal(self.world)
        rules = self.protocol.rules(self.world)
        self.loop.reset(self.world, int(self.np_random.integers(2**31)), start, rules)
        self._over = False
        self._apply(self.space.defaults)
        return self._observe(self.loop.scan), self._info()

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        return self.step_values(self.space.to_values(action))

    def step_values(self, values: NDArray[np.float64]) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """`step` with parameter values (n,) instead of an action: repeats a recorded trial to the bit."""
        if self._over:
            raise RuntimeError("step() after the end of an episode: call reset() first")
        self._apply(values)
        before = self.loop.simulator.position
        self.loop.advance(self.period_ms)
        after = self.loop.simulator.position
        scan = self.loop.scan
        observation = self._observe(scan)
        terminated = self.loop.success or self.loop.failed
        truncated = not terminated and self.loop.timed_out
        self._over = terminated or truncated
        nearest_m = float(scan.min())
        goal = (float(self._goal[0]), float(self._goal[1]))
        collided = self.loop.simulator.collided
        reward = self._reward(self.rewards, Outcome(before, after, goal, nearest_m, self.loop.success, collided))
        return observation, reward, terminated, truncated, self._info()

    def close(self) -> None:
        self.loop.simulator.close()

    def next_world(self) -> int:
        """Index of the next world in the seeded order that visits every world before any again."""
        if not self._order:
            self._order = [int(i) for i in self.np_random.permutation(list(self.worlds))]
        return self._order.pop()

    def _apply(self, values: NDArray[np.float64]) -> None:
        self.parameters = values
        in_force = self._defaults.copy()
        in_force[self._indices] = values
        self.loop.planner.set_parameters(in_force)

    def _observe(self, scan: FloatArray) -> FloatArray:
        bearing_rad = self.loop.planner.local_goal_bearing(self.loop.estimate[0])
        return self.observation_builder.build(scan, bearing_rad, self.parameters)

    def _info(self) -> dict[str, Any]:
        loop, simulator = self.loop, self.loop.simulator
        return {
            "time_s": loop.time_s,
            "success": loop.success,
            "collision": simulator.collided,
            "rolled_over": simulator.rolled_over,
            "world": self.world.index,
            "distance_m": simulator.distance_m,
            "min_clearance_m": loop.min_clearance_m,
            "collisions": loop.collisions,
            "recoveries": loop.planner.recoveries,
            "parameters": self.parameters,
        }
