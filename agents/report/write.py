"""The report of a benchmark: one self-contained page."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from lanebound.agents.benchmark.metrics import METRICS
from lanebound.agents.benchmark.outcome import Outcome, Place
from lanebound.agents.benchmark.replay import differences, replay
from lanebound.agents.benchmark.results import Cell, Results
from lanebound.agents.benchmark.statistics import VERDICT_SEEDS
from lanebound.agents.benchmark.store import CLIPS, EpisodeStore, source_digest
from lanebound.agents.benchmark.verdicts import limits_of_other_skies, opening
from lanebound.agents.checkpointing.files import replace_file
from lanebound.agents.report.style import Actor, actors_of, replay_command, title_of
from lanebound.agents.report.views import (
    badness,
    causes,
    head_of,
    means_table,
    overviews,
    view_of,
    what_happened,
    worst_of,
)
from lanebound.integrity.assessment.plotting import mode_colour
from lanebound.integrity.positioning.modes import Mode

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


NAME = "report.html"
PACKAGES = ("lanebound", "gymnasium", "highway-env", "numpy", "numba", "scipy", "stable-baselines3", "torch")
LISTED = 20  # failures of an agent at a place with their commands; of others only the seeds
OPEN_PLACES = 3  # with more places each one is folded


@dataclass(frozen=True)
class Failures:
    """Failures of an agent at a place."""

    title: str
    agent: str
    driven: int
    kinds: list[tuple[str, int]]
    listed: list[tuple[Outcome, str, str]]
    others: list[int]
    count: int


def write_report(
    results: Results, out: Path, clips: int = 3, on_clip: Callable[[int, int], None] = lambda done, of: None
) -> Path:
    """Write the page ``report.html`` into the folder ``out``; returns its path.

    Parameters
    ----------
    results : of a suite, finished or not
    out : a folder, made if missing
    clips : number of the worst episodes to be filmed, one for each place
    on_clip : called with the number of finished clips and of all, before each clip and at the end

    Returns
    -------
    The page, with style, script, pictures and films; it loads nothing from a network.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / NAME
    with replace_file(path) as draft:
        draft.write_text(render(results, clips, on_clip), encoding="utf-8")
    return path


def render(results: Results, clips: int = 0, on_clip: Callable[[int, int], None] = lambda done, of: None) -> str:
    """The page as text; its worst episodes are driven again and filmed, but for films of ``clips/`` in the folder."""
    actors = actors_of(results.suite)
    places = _places(results)
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    return page.from_string(_part("page.html")).render(
        style=Markup(_part("page.css")),
        script=Markup(_part("page.js")),
        suite=results.suite,
        places=[view_of(results, place, cells, actors) for place, cells in places.items()],
        folded=len(places) > OPEN_PLACES,
        overviews=overviews(places, actors) if len(places) > 1 else [],
        actors=list(actors.values()),
        bounds=[actor.name for actor in actors.values() if actor.bound],
        opening=[*opening(results), *limits_of_other_skies(results)] if results.cells else [],
        means=means_table(results, actors),
        few=max((cell.episodes for cell in results.cells), default=VERDICT_SEEDS) < VERDICT_SEEDS,
        verdict_seeds=VERDICT_SEEDS,
        episodes=len(results.outcomes),
        missing=len(results.missing),
        left_out=results.left_out,
        clips=_clips(results, places, actors, clips, on_clip),
        failures=_failures(results),
        failed_agents=len(results.failures),
        metrics=[head_of(metric) for metric in METRICS],
        causes=causes(),
        modes=[(mode.label, mode_colour(mode)) for mode in Mode],
        definition=json.dumps(results.suite.to_dict(), indent=2, ensure_ascii=False),
        versions=_versions(results.folder),
        title_of=title_of,
        breakable=Markup("_<wbr>"),  # long names may be broken
        replay=lambda outcome: replay_command(results.folder, outcome),
    )


def _part(name: str) -> str:
    """A file next to this one."""
    return (files("lanebound.agents.report") / name).read_text(encoding="utf-8")


def _places(results: Results) -> dict[Place, list[Cell]]:
    """The places with results, in the order of the suite."""
    found: dict[Place, list[Cell]] = {}
    for cell in results.cells:
        found.setdefault(cell.place, []).append(cell)
    return found


def _clips(
    results: Results,
    places: Mapping[Place, Any],
    actors: Mapping[str, Actor],
    count: int,
    on_clip: Callable[[int, int], None],
) -> list[Clip]:
    """Films of the worst episodes, the worst first, one for each place."""
    if count < 1 or results.folder is None:
        return []
    worst: list[Outcome] = []
    for place in places:
        worst += worst_of((o for o in results.outcomes if o.task.place == place), actors, 1)
    chosen = sorted(worst, key=badness, reverse=True)[:count]
    clips = []
    for done, outcome in enumerate(chosen):
        on_clip(done, len(chosen))
        clips.append(film_clip(results.folder, outcome))
    on_clip(len(chosen), len(chosen))
    return clips


def _failures(results: Results) -> list[Failures]:
    groups: dict[tuple[Place, str], list[Outcome]] = {}
    for outcome in results.outcomes:
        groups.setdefault((outcome.task.place, outcome.agent), []).append(outcome)
    found = [_failures_of(results, place, agent, group) for (place, agent), group in groups.items()]
    return [failures for failures in found if failures.count]


def _failures_of(results: Results, place: Place, agent: str, group: Sequence[Outcome]) -> Failures:
    bad = [outcome for outcome in group if what_happened(outcome)]
    kinds = Counter(o.status.replace("_", " ") if o.failed else what_happened(o) for o in bad)
    shown = [(o, what_happened(o), replay_command(results.folder, o)) for o in bad[:LISTED]]
    others = [outcome.seed for outcome in bad[LISTED:]]
    return Failures(title_of(place), agent, len(group), kinds.most_common(), shown, others, len(bad))


def _versions(folder: Path | None) -> list[tuple[str, str]]:
    """Recorded versions of the episodes; present versions of packages that are not recorded."""
    manifest = {} if folder is None else EpisodeStore(folder).manifest()
    found: list[tuple[str, str]] = []
    if manifest:
        found = [("driven by lanebound", str(manifest["version"])), ("digest of its code", str(manifest["source"]))]
        found.append(("digest of its defaults", str(manifest.get("defaults", "not recorded"))))
    recorded = {"Python": platform.python_version(), **manifest.get("packages", {})}
    found += recorded.items()
    for name in PACKAGES:
        if name in recorded:
            continue
        with suppress(PackageNotFoundError):
            found.append((name, version(name)))
    return found
