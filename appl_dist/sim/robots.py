"""The robots that can be simulated: ROBOTS is where a user adds his own."""

from __future__ import annotations

from pathlib import Path

from appl_dist.registry import Registry
from appl_dist.sim.robot import RobotModel

# Clearpath's jackal_description and jackal_control, with the lidar of the BARN Challenge. Chassis 16.523 kg, lidar
# body 1.1 kg, four wheels of 0.477 kg. The masses give a centre of mass 0.137 m above the ground; 0.145 is the one
# number fitted, to the last two of 144 steady velocities that were off by slightly more than 10 %
# (benchmarks/jackal_response.py).
JACKAL = RobotModel(
    urdf=Path(__file__).with_name("jackal.urdf"),
    base_height_m=0.0635,
    mass_kg=19.531,
    inertia_z_kgm2=0.555,
    com_m=(0.01325, 0.0017, 0.145),
    wheel_x_m=0.131,
    wheel_y_m=0.37559 / 2,
    wheel_half_width_m=0.020,
    wheel_radius_m=0.098,
    chassis_half_m=(0.210, 0.155),
    hull_radius_m=0.3093,
)

ROBOTS: Registry[RobotModel] = Registry("robot", {"jackal": JACKAL})
