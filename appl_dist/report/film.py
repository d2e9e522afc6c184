"""A film of one trial: robot, lidar, plan, costmap, chosen roll-out and the parameters as bars.

GIF needs Pillow alone; MP4 needs the ffmpeg program. Frames are drawn with Pillow: a film takes a second or two.
"""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from appl_dist.errors import UserError
from appl_dist.evaluate.trial_replay import Frame, Recording, trial_name
from appl_dist.files import write_atomic
from appl_dist.report.maps import hull

FRAME_MS = 100  # simulated time between frames; films play in real time
SCALE = 64  # pixels a metre
VIEW_M = (5.6, 8.2)  # width and height of the world in view
PANEL = 300  # pixels of the panel beside it
COLOURS = {
    "ground": (255, 255, 255),
    "obstacle": (70, 70, 70),
    "path": (0, 0, 0),
    "beam": (213, 94, 0),
    "plan": (0, 158, 115),
    "rollout": (0, 114, 178),
    "hull": (0, 114, 178),
    "bar": (86, 180, 233),
    "frame": (200, 200, 200),
    "text": (30, 30, 30),
}


def write_film(recording: Recording, path: Path) -> None:
    """Write `path` (.gif or .mp4) of a recording that has frames. Raises UserError."""
    kind = path.suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise UserError(f"film: got {path.name!r}; allowed a name ending in .gif or .mp4")
    write_atomic(path, gif_bytes(recording) if kind == ".gif" else _mp4_bytes(recording))


def gif_bytes(recording: Recording, *, frames: int = 0, scale: float = 1.0) -> bytes:
    """A looping GIF in real time; frames: about how many are kept, 0 for all; scale: of their size."""
    every = max(1, len(recording.frames) // frames) if frames else 1
    thinned = replace(recording, frames=(*recording.frames[:-1:every], recording.frames[-1]))
    images = [_resized(i, scale) for i in draw_frames(thinned)]
    palette = images[len(images) // 2].quantize(64)
    small = [i.quantize(palette=palette, dither=Image.Dither.NONE) for i in images]
    data = io.BytesIO()
    durations = [FRAME_MS * every] * (len(small) - 1) + [1500]
    small[0].save(data, "GIF", save_all=True, append_images=small[1:], duration=durations, loop=0, optimize=False)
    return data.getvalue()


def _resized(image: Image.Image, scale: float) -> Image.Image:
    if scale == 1.0:
        return image
    return image.resize((round(image.width * scale), round(image.height * scale)), Image.Resampling.LANCZOS)


def _mp4_bytes(recording: Recording) -> bytes:
    if shutil.which("ffmpeg") is None:
        raise UserError("film: .mp4 needs the program ffmpeg, which is not installed; choose a name ending in .gif")
    frames = list(draw_frames(recording))
    command = (
        f"ffmpeg -loglevel error -f rawvideo -pix_fmt rgb24 -s {frames[0].width}x{frames[0].height} "
        f"-r {1000 // FRAME_MS} -i - -c:v libx264 -pix_fmt yuv420p -f mp4 -movflags frag_keyframe+empty_moov -"
    )
    raw = b"".join(f.tobytes() for f in frames)
    done = subprocess.run(command.split(), input=raw, capture_output=True, check=False)
    if done.returncode != 0:
        reason = done.stderr.decode("utf8", "replace").strip().splitlines()
        raise UserError(f"film: ffmpeg failed ({reason[-1] if reason else 'no reason given'}); choose .gif")
    return done.stdout


def draw_frames(recording: Recording) -> Iterator[Image.Image]:
    """Every frame of the recording as an RGB image of even width and height."""
    view = _View(recording)
    for frame in recording.frames:
        yield view.draw(frame)


class _View:
    """The part of the world that is shown, and what stays the same from frame to frame."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        path = recording.result.trajectory[:, 1:3]
        centre = 0.5 * (path.min(axis=0) + path.max(axis=0))
        self._corner = np.array([centre[0] - VIEW_M[0] / 2.0, centre[1] - VIEW_M[1] / 2.0])
        self._size = (round(VIEW_M[0] * SCALE), round(VIEW_M[1] * SCALE))
        self._font, self._small = ImageFont.load_default(15), ImageFont.load_default(12)
        self._driven = self._pixels(path)
        self._times_s = recording.result.trajectory[:, 0]

    def _pixels(self, points: NDArray[np.float64]) -> list[tuple[float, float]]:
        """World points (n, 2) as x right, y down."""
        x, y = ((points - self._corner) * SCALE).T
        return list(zip(x.tolist(), (self._size[1] - y).tolist(), strict=True))

    def draw(self, frame: Frame) -> Image.Image:
        image = Image.new("RGB", (self._size[0] + PANEL, self._size[1] + self._size[1] % 2), COLOURS["ground"])
        world = Image.new("RGB", self._size, COLOURS["ground"])
        self._costmap(world, frame)
        pen = ImageDraw.Draw(world)
        for x, y, r in self._recording.world.cylinders:
            (px, py) = self._pixels(np.array([(x, y)]))[0]
            pen.ellipse((px - r * SCALE, py - r * SCALE, px + r * SCALE, py + r * SCALE), fill=COLOURS["obstacle"])
        so_far = self._driven[: int(np.searchsorted(self._times_s, frame.t_s, "right"))]
        for points, colour, width in (
            (so_far, "path", 1),
            (self._pixels(frame.plan) if len(frame.plan) else [], "plan", 2),
            (self._pixels(frame.trajectory) if len(frame.trajectory) else [], "rollout", 4),
            (self._pixels(hull(frame.pose)), "hull", 3),
        ):
            if len(points) > 1:
                pen.line(points, fill=COLOURS[colour], width=width)
        nose = frame.pose[:2] + 0.254 * np.array([np.cos(frame.pose[2]), np.sin(frame.pose[2])])
        pen.line(self._pixels(np.array([frame.pose[:2], nose])), fill=COLOURS["hull"], width=3)
        for px, py in self._pixels(self._recording.scan_points(frame)):
            pen.rectangle((px - 1, py - 1, px + 1, py + 1), fill=COLOURS["beam"])
        image.paste(world, (0, 0))
        self._panel(ImageDraw.Draw(image), frame)
        return image

    def _costmap(self, world: Image.Image, frame: Frame) -> None:
        """Costs as grey, free cells clear: inflated ones light, those the robot's centre may not enter darker."""
        costs = frame.costmap[::-1].astype(np.float64)
        shade = np.where(costs > 252, 175.0, np.where(costs > 0, 250.0 - 0.25 * costs, 255.0)).astype(np.uint8)
        cell = self._recording.resolution_m * SCALE
        size = (round(shade.shape[1] * cell), round(shade.shape[0] * cell))
        grey = Image.fromarray(shade).resize(size, Image.Resampling.NEAREST)
        top_left = frame.costmap_origin + np.array((0.0, frame.costmap.shape[0] * self._recording.resolution_m))
        px, py = self._pixels(top_left[None])[0]
        world.paste(grey.convert("RGB"), (round(px), round(py)))

    def _panel(self, pen: ImageDraw.ImageDraw, frame: Frame) -> None:
        recording, left, y = self._recording, self._size[0] + 14, 12
        trial = recording.trial
        last = frame is recording.frames[-1]
        lines = [
            trial_name(trial),
            f"{frame.t_s:5.1f} s   {frame.twist[0]:+.2f} m/s   {frame.twist[1]:+.2f} rad/s",
            f"recoveries {frame.recoveries}" + (f"   {trial.outcome}" if last else ""),
        ]
        for line in lines:
            pen.text((left, y), line, fill=COLOURS["text"], font=self._font)
            y += 22
        y += 12
        width = PANEL - 28
        for name, low, high, value in zip(
            recording.names, recording.low, recording.high, frame.parameters, strict=True
        ):
            pen.text((left, y), f"{name}  {value:.3g}", fill=COLOURS["text"], font=self._small)
            pen.rectangle((left, y + 17, left + width, y + 27), outline=COLOURS["frame"])
            share = float(np.clip((value - low) / (high - low), 0.0, 1.0))
            pen.rectangle((left, y + 17, left + max(1, round(width * share)), y + 27), fill=COLOURS["bar"])
            y += 40
        y += 8
        for name, text in (
            ("plan", "global plan"),
            ("rollout", "chosen roll-out"),
            ("beam", "lidar"),
            ("path", "driven"),
        ):
            pen.line((left, y + 8, left + 24, y + 8), fill=COLOURS[name], width=4)
            pen.text((left + 34, y), text, fill=COLOURS["text"], font=self._small)
            y += 19
