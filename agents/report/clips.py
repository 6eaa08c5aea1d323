"""Short films of episodes that are driven again, small enough for a page."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.replay import differences, replay
from lanebound.agents.benchmark.source import source_digest
from lanebound.agents.benchmark.store import CLIPS
from lanebound.agents.checkpointing.files import replace_file

__all__ = ["Clip", "film_clip", "shrink"]

LAST_S = 12.0  # of the episode
WIDTH_PX = 960
FPS = 10
POSTER_BEFORE_END_S = 1.0
QUALITY = (30, 36, 42)  # constant rate factors of x264, tried until a clip is small enough
LARGEST_BYTES = 1_200_000


@dataclass(frozen=True)
class Clip:
    """A film of an episode's end.

    Attributes
    ----------
    address : the film as a ``data:`` address; "" where there is none
    poster : a picture of its last second as a ``data:`` address, shown before the film is played
    trouble : why there is no film, or what differs from the stored episode
    """

    outcome: Outcome
    address: str = ""
    poster: str = ""
    trouble: str = ""


def film_clip(folder: Path, outcome: Outcome) -> Clip:
    """Drive an episode of a result folder again and film its last seconds.

    Errors are reported in the clip, not raised: a failing agent must not prevent the report.
    """
    try:
        kept = folder / CLIPS / f"{_name(outcome)}.mp4"
        if kept.exists():
            return _clip(outcome, kept.read_bytes())
        film, other = _filmed(folder, outcome)
        if other:
            return _clip(outcome, film, f"The outcome differs from the stored one in {other}.")
        with suppress(OSError):  # a film that cannot be stored is shown too
            kept.parent.mkdir(exist_ok=True)
            with replace_file(kept) as draft:
                draft.write_bytes(film)
        return _clip(outcome, film)
    except Exception as error:
        return Clip(outcome, trouble=f"No clip: {type(error).__name__}: {error}")


def _filmed(folder: Path, outcome: Outcome) -> tuple[bytes, str]:
    """The end of an episode that is driven again, and the attributes that differ from the stored outcome."""
    with tempfile.TemporaryDirectory() as place:
        whole, small = Path(place) / "whole.mp4", Path(place) / "small.mp4"
        other = differences(*replay(folder, outcome.id, whole, FPS))
        return shrink(whole, small, outcome.time_s), ", ".join(other)


def _name(outcome: Outcome) -> str:
    """Name of a film: a digest of the outcome, the code, and the settings of filming."""
    made = (source_digest(), outcome.to_dict(), LAST_S, WIDTH_PX, FPS, QUALITY, LARGEST_BYTES)
    text = json.dumps(made, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def shrink(whole: Path, small: Path, length_s: float) -> bytes:
    """The last seconds of a film, scaled down and compressed until they are small enough."""
    from imageio_ffmpeg import get_ffmpeg_exe

    start = max(0.0, length_s - LAST_S)
    for quality in QUALITY:
        command = [get_ffmpeg_exe(), "-v", "error", "-y", "-ss", f"{start:.2f}", "-i", str(whole), "-an"]
        command += ["-vf", rf"scale=min({WIDTH_PX}\,iw):-2:flags=area", "-c:v", "libx264", "-preset", "slow"]
        command += ["-crf", str(quality), "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(small)]
        subprocess.run(command, check=True, stdin=subprocess.DEVNULL, capture_output=True)
        if small.stat().st_size <= LARGEST_BYTES:
            break
    return small.read_bytes()


def _clip(outcome: Outcome, film: bytes, trouble: str = "") -> Clip:
    return Clip(outcome, _address("video/mp4", film), _address("image/jpeg", poster_of(film)), trouble)


def poster_of(film: bytes) -> bytes:
    """A picture shortly before the end of a film, as JPEG."""
    from imageio_ffmpeg import get_ffmpeg_exe

    command = [get_ffmpeg_exe(), "-v", "error", "-y", "-sseof", f"-{POSTER_BEFORE_END_S}", "-i"]
    with tempfile.TemporaryDirectory() as place:
        whole, picture = Path(place) / "film.mp4", Path(place) / "poster.jpg"
        whole.write_bytes(film)
        command += [str(whole), "-frames:v", "1", "-vf", "scale=640:-2", "-q:v", "6", str(picture)]
        subprocess.run(command, check=True, stdin=subprocess.DEVNULL, capture_output=True)
        return picture.read_bytes()


def _address(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
