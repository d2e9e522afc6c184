"""When things happen on a robot: rates, phases and delays of sensing, mapping, planning and control.

The numbers are those of ROS `move_base` around Gazebo's Jackal; `ideal` is one synchronous tick at 20 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class TimingSettings:
    """Periods and delays in whole milliseconds; computing times in milliseconds of work.

    A control cycle takes `control_base_ms + steps * control_us_per_step / 1000` and a plan `plan_ms`, times
    `cpu_factor`: what the real C++ needs on one core of a server, scaled to the computer it runs on. Three is what
    the recorded Gazebo runs are met with (benchmarks/gazebo_population.py): simulator and planner shared cores there.
    """

    scan_period_ms: int = 20
    scan_delay_ms: int = 20  # stamp to usable in the costmaps
    odometry_delay_ms: int = 3  # and up to a scan period more: the filter runs on a clock of its own
    local_map_period_ms: int = 50
    global_map_period_ms: int = 100
    plan_period_ms: int = 50
    control_period_ms: int = 50
    command_delay_ms: int = 2  # published to acted on
    random_phases: bool = True
    cpu_factor: float = 3.0
    control_base_ms: float = 1.65  # goal and path wavefronts, plus 1.5 ms for the published cost cloud
    control_us_per_step: float = 0.16  # one roll-out step: footprint outline and cell costs
    plan_ms: float = 1.65  # navfn, whose wave covers about the same area in every plan

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name.endswith("period_ms") and not 1 <= value <= 1000:
                raise ValueError(f"timing.{f.name}: got {value}; allowed 1..1000 ms")
            elif not isinstance(value, bool) and not 0 <= value <= 1000:
                raise ValueError(f"timing.{f.name}: got {value}; allowed 0..1000")


IDEAL = TimingSettings(
    scan_period_ms=50,
    scan_delay_ms=0,
    odometry_delay_ms=0,
    command_delay_ms=0,
    random_phases=False,
    cpu_factor=0.0,
)
