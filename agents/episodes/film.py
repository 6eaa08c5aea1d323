"""A film of a drive, smoother than decisions are taken: pictures between them too."""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.episodes.columns import Moment
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.errors import InputError

__all__ = ["Film", "part_of"]


def part_of(path: Path) -> Path:
    """The file of a film until it is complete."""
    return path.with_name(f"{path.stem}.part{path.suffix}")


class Film:
    """Writes an MP4 (H.264) of what an environment renders; a watcher of a drive, and a context manager.

    Pictures within a policy step use the world's hook for rendering. They update the belief as the beginning of the
    next simulation step would, so that filming does not change the drive.

    Parameters
    ----------
    env : with render_mode ``rgb_array``
    path : of the film; the file appears when it is complete
    fps : pictures in a second of the drive; must divide ``simulation_hz``

    Raises
    ------
    InputError
        The name does not end in .mp4, the rate does not divide, or nothing can be written there.
    """

    def __init__(self, env: DrivingEnv, path: Path, fps: int = 10) -> None:
        rate = env.config.simulation_hz
        if path.suffix != ".mp4":
            raise InputError(f"video must end in .mp4, got {path.name}: rename it")
        if fps < 1 or rate % fps:
            fits = ", ".join(str(n) for n in range(1, rate + 1) if rate % n == 0)
            raise InputError(f"fps must divide simulation_hz = {rate}, got {fps}: choose one of {fits}")
        _require_writable(path)
        self.env, self.path, self.fps = env, path, fps
        self.frames = 0
        self._part = part_of(path)
        self._every, self._count = rate // fps, 0
        self._sink: Generator[None, Any, None] | None = None

    def __enter__(self) -> Film:
        self.env.world._automatic_rendering = self._between
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        del self.env.world._automatic_rendering
        if self._sink is None:
            return
        self._sink.close()
        if kind is None:
            os.replace(self._part, self.path)
        else:
            self._part.unlink(missing_ok=True)

    def note(self, moment: Moment) -> None:
        """A decision was executed, or an episode begins."""
        if moment.step == 0:
            self._count = 0
            self._shoot()
        else:
            self._tick()

    def _between(self) -> None:
        """The world has moved by a simulation step that is not the last before a decision."""
        self._tick()

    def _tick(self) -> None:
        self._count += 1
        if self._count % self._every == 0:
            self._shoot()

    def _shoot(self) -> None:
        picture = self.env.render()
        assert picture is not None
        if self._sink is None:
            self._sink = self._open(picture.shape[1], picture.shape[0])
        self._sink.send(np.ascontiguousarray(picture))
        self.frames += 1

    def _open(self, width_px: int, height_px: int) -> Generator[None, Any, None]:
        from imageio_ffmpeg import write_frames

        sink: Generator[None, Any, None] = write_frames(
            str(self._part),
            (width_px, height_px),
            fps=self.fps,
            quality=7,
            macro_block_size=2,
            ffmpeg_log_level="fatal",
        )
        sink.send(None)
        return sink


def _require_writable(path: Path) -> None:
    """Refuse now what could not be written when the first picture comes."""
    part = part_of(path)
    try:
        if path.is_dir():
            raise IsADirectoryError(f"{path} is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        there = part.exists()
        part.open("ab").close()
        if not there:
            part.unlink()
    except OSError as error:
        raise InputError(f"video must be a file that can be written, got {path} ({error}): choose another") from error
