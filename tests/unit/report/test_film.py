"""Films and figures of a real trial."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from appl_dist.actor.env import NavigationEnv
from appl_dist.actor.protocol import PROTOCOLS
from appl_dist.errors import UserError
from appl_dist.evaluate.comparison import evaluate
from appl_dist.evaluate.folder import read_evaluation
from appl_dist.evaluate.trial_replay import Recording, replay
from appl_dist.report import film, maps
from appl_dist.sim.generate import generate_worlds
from appl_dist.sim.robot import RobotSettings

SHORT = replace(PROTOCOLS.get("appl"), limit_s=6.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    folder, worlds = tmp_path_factory.mktemp("film"), generate_worlds(1, seed=0)
    quiet = Console(file=io.StringIO())
    evaluate([("a", "set:max_vel_x=1.5")], worlds, 1, folder, protocol=SHORT, workers=0, console=quiet)
    env = NavigationEnv(worlds, protocol=SHORT)
    yield replay(env, read_evaluation(folder).trials[0], every_ms=film.FRAME_MS)
    env.close()


def test_a_gif_shows_every_frame_and_the_robot_moves(recording: Recording, tmp_path: Path) -> None:
    film.write_film(recording, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == len(recording.frames) > 30
        gif.seek(5)
        early = np.asarray(gif.convert("RGB"))
        gif.seek(gif.n_frames - 1)
        late = np.asarray(gif.convert("RGB"))
    assert (early != late).any()
    small = film.gif_bytes(recording, frames=10, scale=0.5)
    with Image.open(io.BytesIO(small)) as gif:
        assert 10 <= gif.n_frames <= 14
    assert len(small) < (tmp_path / "film.gif").stat().st_size / 4


def test_an_mp4_where_ffmpeg_is(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("ffmpeg") is not None:
        film.write_film(recording, tmp_path / "film.mp4")
        command = ["ffmpeg", "-v", "error", "-i", tmp_path / "film.mp4", "-f", "null", "-"]
        assert subprocess.run(command, capture_output=True, check=True).stderr == b""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r"needs the program ffmpeg.*\.gif"):
        film.write_film(recording, tmp_path / "other.mp4")
    with pytest.raises(UserError, match=r"'film\.avi'; allowed a name ending in"):
        film.write_film(recording, tmp_path / "film.avi")


def test_lidar_points_lie_on_obstacles(recording: Recording) -> None:
    for frame in recording.frames[::10]:
        points = recording.scan_points(frame)
        centres, radius = recording.world.cylinders[:, :2], recording.world.cylinders[:, 2]
        gap = np.abs(np.linalg.norm(points[:, None] - centres, axis=2) - radius).min(axis=1)
        assert gap.max() < 0.02  # noise of 1 mm, and the shot is of the pose within the sample


def test_what_the_planner_holds_is_drawn_where_the_robot_is(tmp_path: Path) -> None:
    """Though odometry is far out on slippery ground: in its frame the roll-outs start a metre ahead."""
    slippery: dict[str, Any] = {"robot": RobotSettings(friction=0.1)}
    worlds, quiet = generate_worlds(1, seed=0), Console(file=io.StringIO())
    methods = [("a", "set:max_vel_x=1.5")]
    evaluate(methods, worlds, 1, tmp_path, environment=slippery, protocol=SHORT, workers=0, console=quiet)
    env = NavigationEnv(worlds, protocol=SHORT, **slippery)
    recording = replay(env, read_evaluation(tmp_path).trials[0], every_ms=film.FRAME_MS)
    env.close()
    assert recording.difference == ""
    behind = [np.linalg.norm(f.trajectory[0] - f.pose[:2]) for f in recording.frames[1:] if len(f.trajectory)]
    assert len(behind) > 20
    assert max(behind) < 0.2  # driven since the roll-out was chosen


def test_the_path_is_coloured_by_speed_or_by_any_parameter(recording: Recording) -> None:
    values, label = maps.path_values(recording, "speed")
    assert label == "speed, m/s"
    assert values == pytest.approx(np.abs(recording.result.trajectory[:, 4]))
    for name in recording.names:
        values, label = maps.path_values(recording, name)
        assert label == name
        assert len(values) == len(recording.result.trajectory)
    recording.result.parameters[1:, 0] = [0.7, 0.9][: len(recording.result.parameters) - 1]
    values, _ = maps.path_values(recording, recording.names[0])
    t_s = recording.result.trajectory[:, 0]
    assert set(values[t_s <= 2.0]) == {1.5}
    assert set(values[(t_s > 2.0) & (t_s <= 4.0)]) == {0.7}
    assert set(values[t_s > 4.0]) == {0.9}


def test_figures_of_a_trial_have_their_panels(recording: Recording) -> None:
    assert len(maps.parameter_figure(recording).axes) == 1 + len(recording.names)
    overview, lidar, costs = maps.inset_figure(recording, recording.frames[20]).axes[:3]
    assert lidar.get_title() == f"lidar at {recording.frames[20].t_s:.1f} s"
    assert len(costs.images) == 1
    assert overview.get_title().startswith("a/0/0")
    assert len(maps.map_figure([recording] * 7).axes) == 8 + 1  # two rows of four, and the colour bar
    bar = maps.map_figure([recording], "max_vel_x").axes[-1]
    assert bar.get_ylim() == (recording.low[0], recording.high[0])  # not what of it was used
