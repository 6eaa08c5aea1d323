"""Clips: the end of an episode, small, and no trouble for the report."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from benchmarks import made_up_folder, made_up_outcome, made_up_suite
from imageio_ffmpeg import count_frames_and_secs, write_frames

from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.benchmark.work import DrivenEpisodes
from lanebound.agents.checkpointing.runner import PartStatus
from lanebound.agents.report.write import LAST_S, film_clip, shrink


def film(path, seconds, width=640, height=360, fps=5):
    sink = write_frames(str(path), (width, height), fps=fps, macro_block_size=2, ffmpeg_log_level="fatal")
    sink.send(None)
    for k in range(int(seconds * fps)):
        sink.send(np.full((height, width, 3), k, dtype=np.uint8))
    sink.close()


@pytest.mark.parametrize(("length_s", "kept_s"), [(LAST_S + 4.0, LAST_S), (3.0, 3.0)])
def test_only_the_last_seconds_are_kept(tmp_path, length_s, kept_s):
    film(tmp_path / "whole.mp4", length_s)
    kept = shrink(tmp_path / "whole.mp4", tmp_path / "small.mp4", length_s)
    assert (tmp_path / "small.mp4").read_bytes() == kept
    _, seconds = count_frames_and_secs(str(tmp_path / "small.mp4"))
    assert seconds == pytest.approx(kept_s, abs=0.3)
    assert kept.find(b"moov") < kept.find(b"mdat")  # a player may begin before it has all


def test_clips_are_compressed_further_until_they_are_small(tmp_path, monkeypatch):
    from lanebound.agents.report import write as clips

    film(tmp_path / "whole.mp4", 2.0)
    tried = []
    run = clips.subprocess.run
    monkeypatch.setattr(clips.subprocess, "run", lambda c, **k: (tried.append(c[c.index("-crf") + 1]), run(c, **k)))
    monkeypatch.setattr(clips, "LARGEST_BYTES", 1)
    assert shrink(tmp_path / "whole.mp4", tmp_path / "small.mp4", 2.0)
    assert tried == [str(quality) for quality in clips.QUALITY]


def test_trouble_is_told(tmp_path):
    made_up_folder(tmp_path, seeds={"count": 1})
    stranger = made_up_outcome(next(iter(made_up_suite(envs=["Merge"]).tasks())))
    clip = film_clip(tmp_path, stranger)
    assert clip.address == ""
    assert clip.trouble.startswith("No clip: InputError: ")


def test_a_film_is_made_once(tmp_path, monkeypatch):
    from lanebound.agents.report import write as clips

    made_up_folder(tmp_path, seeds={"count": 2})
    first, second = list(made_up_suite().tasks())[:2]
    made = []
    monkeypatch.setattr(clips, "_filmed", lambda folder, outcome: (made.append(outcome.id) or b"film", ""))
    monkeypatch.setattr(clips, "poster_of", lambda film: b"poster")
    films = [film_clip(tmp_path, made_up_outcome(task)) for task in (first, first, second)]
    assert made == [first.id, second.id]
    assert films[0] == films[1]
    film_clip(tmp_path, made_up_outcome(first, cost=77.0))
    assert made.pop() == first.id  # the same episode that came out otherwise
    with monkeypatch.context() as patch:
        patch.setattr(clips, "source_digest", lambda: "another code")
        film_clip(tmp_path, made_up_outcome(first))
    assert made.pop() == first.id
    EpisodeStore(tmp_path).claim(EpisodeStore(tmp_path).suite(), fresh=True)
    assert not (tmp_path / "clips").exists()
    monkeypatch.setattr(clips, "_filmed", lambda folder, outcome: (made.append(outcome.id) or b"film", "cost"))
    assert all("stored one in cost" in film_clip(tmp_path, made_up_outcome(first)).trouble for _ in range(2))
    assert len(made) == 4  # what did not come out as it had is not kept


@pytest.mark.slow
def test_an_episode_is_driven_again(tmp_path):
    given = {"world": {"duration": 2}, "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
    suite = made_up_suite(envs=["LaneKeeping"], skies=["open"], agents=["nominal"], overrides=given)
    EpisodeStore(tmp_path).claim(suite)
    status = PartStatus([0.0] * PartStatus.SIZE)
    outcome = DrivenEpisodes(suite, tmp_path).do(next(iter(suite.tasks())), status)
    clip = film_clip(tmp_path, outcome)
    assert clip.trouble == ""
    assert base64.b64decode(clip.poster.partition(",")[2]).startswith(b"\xff\xd8")
    (tmp_path / "clip.mp4").write_bytes(base64.b64decode(clip.address.partition(",")[2]))
    _, seconds = count_frames_and_secs(str(tmp_path / "clip.mp4"))
    assert seconds == pytest.approx(2.0, abs=0.3)
