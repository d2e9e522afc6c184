"""Open-loop responses of the simulated Jackal beside those of Gazebo's physics.

    python benchmarks/jackal_response.py [jackal_response.csv] [--figure out.png]

Every row of the reference is measured again in `Simulator`, pybullet and all, in an empty world or before one
cylinder. A row passes within 10 % or 0.02 (m, s, rad and their rates) of Gazebo.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appl_dist.sim.robot import RobotSettings
from appl_dist.sim.simulator import Simulator
from appl_dist.sim.worlds import World

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "jackal_response.csv"
VARIANT = "gazebo_world_pyramid"
RELATIVE, ABSOLUTE = 0.10, 0.02
HEADINGS = np.arange(16) * math.pi / 8
TRACE = ("vx", "vy", "w", "x", "y", "yaw", "tilt", "wheel_v", "wheel_w")

Values = dict[str, float]


class Track:
    """Recorded motion: (n, 9) every millisecond, columns of TRACE; velocities in the body frame."""

    def __init__(self, rows: list[tuple[float, ...]]) -> None:
        self.rows = np.array(rows)

    def __getattr__(self, name: str) -> NDArray[np.float64]:
        return self.rows[:, TRACE.index(name)]


class Bench:
    """One simulator; commands come fresh every millisecond, so they never time out."""

    def __init__(self) -> None:
        self.simulator = Simulator(RobotSettings(odom_noise_w_radps=0.0, odom_noise_yaw_rad=0.0))

    def start(self, heading: float = 0.0, obstacle: tuple[float, float] | None = None) -> None:
        """At rest at the origin, perhaps with one cylinder at x, y."""
        cylinders = np.array([(*obstacle, 0.075)]) if obstacle else np.empty((0, 3))
        none = np.empty((0, 2))
        self.simulator.reset(World(0, "bench", cylinders, none, none, np.zeros(5), 0), 0, np.array([0.0, 0.0, heading]))

    def drive(self, v: float, w: float, time_s: float, until: Callable[[], bool] | None = None) -> Track:
        """Drive time_s, or until a condition holds."""
        simulator, rows = self.simulator, []
        for _ in range(round(1000 * time_s)):
            simulator.step((v, w), 0.001)
            pose, twist = simulator.pose, simulator.twist
            rows.append(
                (twist[0], simulator.side_speed_mps, twist[1], *pose, simulator.tilt_rad, *simulator.wheel_twist)
            )
            if until is not None and until():
                break
        return Track(rows)


def rise_s(signal: NDArray[np.float64], final: float, share: float) -> float:
    """First time at which `signal` has come within 1 - share of the way to `final`; 0 where there is none to go."""
    if abs(final) < 1e-3:
        return 0.0
    return 0.001 * (1 + int(np.argmax(signal / final >= share)))


def steady(bench: Bench, v: float, w: float, _: str) -> Values:
    """From rest, 3.5 s; means of the last 2 s."""
    bench.start()
    track = bench.drive(v, w, 3.5)
    late = Track(list(map(tuple, track.rows[-2000:])))
    vx, turn = late.vx.mean(), late.w.mean()
    return {
        "vx_mean": vx,
        "vy_mean": late.vy.mean(),
        "w_mean": turn,
        "vx_std": late.vx.std(),
        "w_std": late.w.std(),
        "t63_v": rise_s(track.vx, vx if v else 0.0, 0.63),
        "t90_v": rise_s(track.vx, vx if v else 0.0, 0.90),
        "t63_w": rise_s(track.w, turn if w else 0.0, 0.63),
        "t90_w": rise_s(track.w, turn if w else 0.0, 0.90),
        "flips_of_5": float(track.tilt.max() > 1.0),
        "max_tilt": track.tilt.max(),
    }


def stop(bench: Bench, v: float, w: float, heading: float) -> Values:
    """Full brake out of steady motion: where it ends in the frame in which it began."""
    bench.start(heading)
    before = bench.drive(v, w, 2.0)
    x, y, yaw = before.x[-1], before.y[-1], before.yaw[-1]
    simulator = bench.simulator
    track = bench.drive(0.0, 0.0, 1.5, lambda: math.hypot(*simulator.twist) < 0.01)
    dx, dy = track.x[-1] - x, track.y[-1] - y
    return {
        "forward": math.cos(yaw) * dx + math.sin(yaw) * dy,
        "side": math.cos(yaw) * dy - math.sin(yaw) * dx,
        "d": math.hypot(dx, dy),
        "yaw": track.yaw[-1] - yaw,
        "t": 0.001 * len(track.rows),
        "t90_accel": rise_s(before.vx, v, 0.90),
        "tilt": track.tilt.max(),
    }


def brake(bench: Bench, v: float, w: float, _: str) -> Values:
    got = stop(bench, v, w, 0.0)
    return {"mean_d": got["d"], "min_d": got["d"], "max_d": got["d"], "mean_t": got["t"], "tilt": got["tilt"]}


def brake_heading(bench: Bench, v: float, w: float, condition: str) -> Values:
    return stop(bench, v, w, heading_of(condition))


def brake_turn(bench: Bench, v: float, w: float, _: str) -> Values:
    """Mean over headings: the pyramid makes each different."""
    runs = [stop(bench, v, w, heading) for heading in HEADINGS]
    return {key: float(np.mean([run[key] for run in runs])) for key in runs[0]}


def reversal(bench: Bench, v: float, w: float, condition: str) -> Values:
    period_s = float(condition.split()[-2])
    bench.start()
    tilt = max(bench.drive(v, w * (-1) ** k, period_s).tilt.max() for k in range(max(4, round(2.0 / period_s))))
    return {"flips": float(tilt > 1.0), "max_tilt": tilt}


def fwdback(bench: Bench, v: float, _: float, __: str) -> Values:
    bench.start()
    return {"max_tilt": max(bench.drive(v * (-1) ** k, 0.0, 0.5).tilt.max() for k in range(6))}


def hit(bench: Bench, v: float, w: float, condition: str) -> Values:
    """Into a cylinder 1.5 m ahead; Gazebo's clock began 0.3 s before the command."""
    bench.start(obstacle=(1.5, float(condition.rsplit(maxsplit=1)[-1])))
    touch = bench.drive(v, w, 5.0, lambda: bench.simulator.collided)
    after = bench.drive(v, w, 5.0 - 0.001 * len(touch.rows))
    passed = after.x[-1] > 2.0
    return {
        "contact_t": 0.3 + 0.001 * len(touch.rows),
        "final_x": after.x[-1],
        "y": after.y[-1],
        "yaw": after.yaw[-1],
        "vx": after.vx[-1],
        "max_tilt": after.tilt.max(),
        "outcome": float(passed),
    }


def yaw_step_at_speed(bench: Bench, v: float, w: float, _: str) -> Values:
    """Yaw command stepped while driving straight; means over headings."""
    runs = []
    for heading in HEADINGS:
        bench.start(heading)
        bench.drive(v, 0.0, 1.0)
        track = bench.drive(v, w, 2.0)
        final = track.w[-1000:].mean()
        runs.append((final, rise_s(track.w, final, 0.63), rise_s(track.w, final, 0.90)))
    return dict(zip(("ss", "t63", "t90"), np.mean(runs, axis=0), strict=True))


def odom_stop_go(bench: Bench, v: float, _: float, __: str) -> Values:
    """One second on, one second off, for ten."""
    bench.start()
    tracks = [bench.drive(v * (1 - k % 2), 0.0, 1.0) for k in range(10)]
    return {
        key: 0.001 * sum(getattr(t, name).sum() for t in tracks) for key, name in (("wheel", "wheel_v"), ("true", "vx"))
    }


def odom_slalom(bench: Bench, v: float, w: float, _: str) -> Values:
    """The yaw command changes sign every second, for eight."""
    bench.start()
    tracks = [bench.drive(v, w * (-1) ** k, 1.0) for k in range(8)]
    return {
        "wheel_dist": 0.001 * sum(t.wheel_v.sum() for t in tracks),
        "true_forward": 0.001 * sum(t.vx.sum() for t in tracks),
        "wheel_yaw": 0.001 * sum(np.abs(t.wheel_w).sum() for t in tracks),
        "true_yaw": 0.001 * sum(np.abs(t.w).sum() for t in tracks),
    }


def in_place_vs_heading(bench: Bench, v: float, w: float, condition: str) -> Values:
    """Mean yaw rate while the heading is within pi / 16 of the one named, over four turns."""
    key = (v, w)
    if key not in _turns:
        bench.start()
        _turns[key] = bench.drive(v, w, 8 * math.pi / w)
    track = _turns[key]
    off = np.abs((track.yaw - heading_of(condition) + math.pi) % (2 * math.pi) - math.pi)
    return {"w_mean": track.w[(off < math.radians(2.0)) & (track.yaw > 0.5)].mean()}


_turns: dict[tuple[float, float], Track] = {}
TESTS: dict[str, Callable[[Bench, float, float, str], Values]] = {
    "steady": steady,
    "brake": brake,
    "brake_heading": brake_heading,
    "brake_turn": brake_turn,
    "reversal": reversal,
    "fwdback": fwdback,
    "hit": hit,
    "yaw_step_at_speed": yaw_step_at_speed,
    "odom_stop_go_10s": odom_stop_go,
    "odom_slalom_8s": odom_slalom,
    "in_place_vs_heading": in_place_vs_heading,
}


def heading_of(condition: str) -> float:
    return float(condition.split()[1])


def passes(ours: float, gazebo: float) -> bool:
    return abs(ours - gazebo) <= max(ABSOLUTE, RELATIVE * abs(gazebo))


def measure(reference: Path) -> list[tuple[dict[str, str], float, float]]:
    """(row, Gazebo's value, ours) of every row of the fitted variant that we can measure."""
    with reference.open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["variant"] == VARIANT]
    bench, results = Bench(), []
    done: dict[tuple[str, ...], Values] = {}
    with bench.simulator:
        for row in rows:
            key = (row["test"], row["v_cmd"], row["w_cmd"], row["condition"])
            if key not in done:
                done[key] = TESTS[row["test"]](bench, float(row["v_cmd"]), float(row["w_cmd"]), row["condition"])
            if row["quantity"] in done[key]:  # wheel lift has no counterpart: our wheels stay on the ground
                value = row["value"]
                gazebo = float(value == "passed") if row["quantity"] == "outcome" else float(value)
                results.append((row, gazebo, done[key][row["quantity"]]))
    return results


# test, quantity, column along x, column of the curves, labels of the axes
PANELS = (
    ("steady", "w_mean", "w_cmd", "v_cmd", "commanded yaw rate, rad/s", "steady yaw rate, rad/s"),
    ("steady", "vy_mean", "w_cmd", "v_cmd", "commanded yaw rate, rad/s", "side slip, m/s"),
    ("in_place_vs_heading", "w_mean", "condition", "w_cmd", "heading, rad", "yaw rate in place, rad/s"),
    ("brake", "mean_d", "v_cmd", "w_cmd", "speed, m/s", "braking distance, m"),
    ("yaw_step_at_speed", "t63", "v_cmd", "w_cmd", "speed, m/s", "yaw step, time to 63 %, s"),
)


def draw(results: list[tuple[dict[str, str], float, float]], out: Path) -> None:
    """Five responses, lines ours and dots Gazebo's, and where hits of a cylinder end, one against the other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 3).ravel()
    for panel, (test, quantity, along, group, x_label, y_label) in zip(panels[:-1], PANELS, strict=True):
        chosen = [(r, g, o) for r, g, o in results if (r["test"], r["quantity"]) == (test, quantity)]
        for k, level in enumerate(sorted({float(r[group]) for r, _, _ in chosen})):
            own = [(r, g, o) for r, g, o in chosen if float(r[group]) == level]
            x = [heading_of(r[along]) if along == "condition" else float(r[along]) for r, _, _ in own]
            unit = "m/s" if group == "v_cmd" else "rad/s"
            panel.plot(x, [o for _, _, o in own], color=f"C{k}", label=f"{level:g} {unit} commanded")
            panel.plot(x, [g for _, g, _ in own], "o", ms=4, color=f"C{k}")
        panel.set(xlabel=x_label, ylabel=y_label)
        panel.legend(fontsize=7, frameon=False)
    for k, (quantity, label) in enumerate((("final_x", "forward, m"), ("y", "sideways, m"), ("yaw", "turned, rad"))):
        pairs = [(g, o) for r, g, o in results if (r["test"], r["quantity"]) == ("hit", quantity)]
        panels[-1].plot(*zip(*pairs, strict=True), "o", ms=4, color=f"C{k}", label=label)
    panels[-1].axline((0, 0), slope=1, color="0.7", linewidth=1)
    panels[-1].set(xlabel="after hitting a cylinder: Gazebo", ylabel="this simulator")
    panels[-1].legend(fontsize=7, frameon=False)
    figure.suptitle("lines: this simulator, dots: Gazebo's physics")
    figure.savefig(out, dpi=110)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reference", type=Path, nargs="?", default=REFERENCE)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--failures", action="store_true", help="print only rows that do not pass")
    args = parser.parse_args()
    results = measure(args.reference)
    lines, score = [], {}
    for row, gazebo, ours in results:
        good = passes(ours, gazebo)
        won, total = score.get((row["test"], row["quantity"]), (0, 0))
        score[row["test"], row["quantity"]] = (won + good, total + 1)
        if not (args.failures and good):
            lines.append(
                f"{row['test']:20} v {row['v_cmd']:>4} w {row['w_cmd']:>4} {row['condition'][:36]:36} "
                f"{row['quantity']:12} gazebo {gazebo:8.3f} ours {ours:8.3f} {ours - gazebo:+8.3f} "
                f"{'pass' if good else 'FAIL'}"
            )
    lines += [f"{test:20} {quantity:12} {won:3} of {total:3}" for (test, quantity), (won, total) in score.items()]
    lines.append(f"all: {sum(w for w, _ in score.values())} of {len(results)} within 10 % or 0.02")
    sys.stdout.write("\n".join(lines) + "\n")
    if args.figure:
        draw(results, args.figure)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
