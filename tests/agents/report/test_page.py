"""The page: what it holds, that nothing breaks out of it, and that it needs nothing beside it."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import pytest
from benchmarks import made_up_folder, made_up_outcome, made_up_results, made_up_suite

from lanebound.agents.benchmark.metrics import MAIN, METRICS
from lanebound.agents.benchmark.results import Results
from lanebound.agents.report import write_report
from lanebound.agents.report.write import LISTED, Clip, render

VOID = {"meta", "link", "br", "wbr", "input", "img"}
EVIL = """</title></script><script>alert("x")</script><img src=x onerror='a'> & "quoted" </code>"""


class Page(HTMLParser):
    """All elements in order, with text, and whether they were closed in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: dict[str, list[str]] = {}
        self.open: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open:
            self.words.setdefault(self.open[-1], []).append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    return made_up_folder(tmp_path_factory.mktemp("results"), seeds={"count": 4})


@pytest.fixture(scope="module")
def html(results) -> str:
    path = write_report(results, results.folder, clips=0)
    assert path == results.folder / "report.html"
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html) -> Page:
    return Page(html)


def test_every_part_is_there(results, page):
    places = [section["id"] for section in page.all("section") if section.get("class") == "place"]
    assert len(places) == 4
    ids = {attributes["id"] for _, attributes in page.elements if "id" in attributes}
    assert ids >= {"overview", "failures", "suite", "metrics", "versions", *places}
    assert {a["href"] for a in page.all("a") if a["href"].startswith("#")} <= {f"#{name}" for name in ids}
    assert page.words["h2"][:2] == ["Overview", "LaneKeeping, urban sky"]


def test_pictures_for_each_agent_and_place(results, page):
    labels = [svg["aria-label"] for svg in page.all("svg")]
    assert all(labels)
    assert sum(label.startswith("Stanford diagram of") for label in labels) == 4 * 3 * 2
    assert sum("against cost" in label for label in labels) == 4 * 4
    assert sum(label.startswith("Costs by cause") for label in labels) == 4
    assert sum(label.startswith("Errors and protection levels") for label in labels) == 4 * 2
    assert any("difference against nominal" in label for label in labels)


def test_the_table_holds_the_estimates(results, html):
    cell = results.cell(results.suite.places[0], "nominal")
    assert f"<b>{cell.metrics['mean_speed'].mean:.1f}</b>" in html
    for metric in METRICS:
        assert metric.meaning in html.replace("&#39;", "'")
    assert html.count('data-shows="overview"') == len(MAIN)


def test_the_best_is_marked_only_where_it_is_clear():
    suite = made_up_suite(agents=["nominal", "random"], envs=["LaneKeeping"], skies=["urban"], seeds={"count": 9})
    gain = {"nominal": 90.0, "random": 10.0}
    outcomes = [
        made_up_outcome(t, cost=float(t.seed), success=True, total_return=gain[t.agent] + t.seed - 10_004)
        for t in suite.tasks()
    ]
    html = render(Results.of(suite, outcomes))
    main = html.split("Main metrics, LaneKeeping, urban sky</span></caption>")[1].split("</table>")[0]
    marked = [line for line in main.split("<td") if line.startswith(' class="best"')]
    assert any("<b>90.0</b>" in line for line in marked)
    assert not any("<b>10.0</b>" in line or "<b>100 %</b>" in line for line in marked)  # worse, and equal
    assert sum("10,004" in line for line in marked) == 0  # equal costs


def test_what_was_never_seen_has_no_interval_and_leaves_nobody_the_best():
    suite = made_up_suite(agents=["nominal", "random"], envs=["LaneKeeping"], skies=["urban"], seeds={"count": 9})
    outcomes = [made_up_outcome(t, cost=0.0 if t.agent == "random" else float(t.seed)) for t in suite.tasks()]
    html = render(Results.of(suite, outcomes))
    assert '<b>0.000</b><small class="lacks">never in 9</small>' in html
    main = html.split("Main metrics, LaneKeeping, urban sky</span></caption>")[1].split("</table>")[0]
    assert not any("10,004" in line for line in main.split("<td") if line.startswith(' class="best"'))


def test_the_page_opens_with_harm_beside_throughput_in_three_sentences():
    page = Page(render(made_up_results(seeds={"count": 8})))
    first = [
        text
        for text in page.words["p"]
        if "reference" in text or "Least harm of the others" in text or "no agent" in text
    ]
    assert re.match(
        r"nominal, the reference, drives at [\d.]+ m/s with a harm of [\d.]+ an episode \(means of 4", first[0]
    )
    assert re.match(r"Least harm of the others: integrity_aware \([\d.]+ at [\d.]+ m/s\)\.", first[1])
    assert first[2].startswith("With 8 seeds no agent can be called safer than nominal")
    options = [(a["value"]) for a in page.all("option")]
    assert options[:2] == ["harm", "throughput"]
    assert "Means over all places, which weigh alike" in page.words["span"]


def test_why_an_interval_is_missing_is_said_in_few_words():
    suite = made_up_suite(agents=["nominal", "random"], envs=["LaneKeeping"], skies=["urban"], seeds={"count": 8})
    dominated = [200.0, 1.0, *[1.0] * 6]
    outcomes = [made_up_outcome(t, cost=dominated[t.seed - 10_000], mean_speed_mps=7.0) for t in suite.tasks()]
    html = render(Results.of(suite, outcomes))
    assert html.count('<small class="lacks">few seeds dominate</small>') >= 2
    assert '<small class="lacks">all 8 alike</small>' in html
    assert "too alike" not in html


def test_who_failed_is_never_the_best_and_figures_of_fewer_seeds_say_so():
    suite = made_up_suite(agents=["nominal", "random"], envs=["LaneKeeping"], skies=["urban"], seeds={"count": 12})
    gain = {"nominal": 90.0, "random": 10.0}
    sound = [made_up_outcome(t, total_return=gain[t.agent] + t.seed - 10_004) for t in suite.tasks()]
    failing = [replace(o, status="raised") if (o.agent, o.seed) == ("nominal", 10_000) else o for o in sound]

    def main(outcomes) -> str:
        html = render(Results.of(suite, outcomes))
        return html.split("Main metrics, LaneKeeping, urban sky</span></caption>")[1].split("</table>")[0]

    assert ' class="best"' in main(sound)
    assert "n = " not in main(sound)
    assert ' class="best"' not in main(failing)
    assert (
        main(failing).count('<small class="n">n = 11</small>') == len(MAIN) - 2
    )  # it has no success, within the limit or not
    assert "var(--worse)" in render(Results.of(suite, sound)).split("<main")[1]
    assert "var(--worse)" not in render(Results.of(suite, failing)).split("<main")[1]


def test_each_reference_has_its_pictures_and_untuned_caution_is_named(monkeypatch):
    monkeypatch.setattr("lanebound.agents.benchmark.untuned.tuned_places", lambda: (("CarFollowingWorld", "dense"),))
    agents = ["nominal", "cautious", "integrity_aware"]
    html = render(made_up_results(agents=agents, reference=["nominal", "cautious"], envs=["CarFollowing"]))
    headings = re.findall(r"<h3>Differences against ([^<]*)</h3>", html)
    assert headings == ["nominal", "cautious, untuned", "nominal", "cautious"]  # under urban and dense skies
    assert "against <b>nominal</b> and <b>cautious</b>" in html
    assert html.count("untuned here") == 2  # in both tables of the one place
    assert "With 6 seeds no agent can be called safer than cautious" in html


def test_few_seeds_are_told(html):
    assert "Too few seeds for a verdict" in html
    assert "clearly better" not in html
    assert "Too few seeds" not in render(made_up_results(seeds={"count": 8}))


def test_failures_come_with_the_command_that_drives_them_again(results, page):
    commands = [button["data-copy"] for button in page.all("button")]
    assert all(shlex.split(words)[:3] == ["lanebound", "replay-episode", str(results.folder)] for words in commands)
    failed = {o.id for o in results.outcomes if o.failed or not o.success}
    assert failed
    assert failed <= {shlex.split(words)[3] for words in commands}
    assert any("raised: ValueError: no idea" in words for words in page.words["td"])


def test_many_failures_are_listed_by_seed():
    suite = made_up_suite(envs=["LaneKeeping"], skies=["urban"], agents=["random"], seeds={"count": LISTED + 3})
    outcomes = [made_up_outcome(task, success=False, ended="collision") for task in suite.tasks()]
    html = render(Results.of(suite, outcomes))
    assert f"{LISTED + 3} of {LISTED + 3}: {LISTED + 3} collision" in html
    assert "10020, 10021, 10022" in html
    assert "lanebound replay-episode DIR LaneKeeping-v0/urban-none/random/10000" in html


def test_it_needs_nothing_beside_it(html, page):
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(", html)
    for _, attributes in page.elements:
        for name in ("src", "href", "poster", "srcset", "action"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))
    policy = next(meta["content"] for meta in page.all("meta") if meta.get("http-equiv"))
    assert policy.startswith("default-src 'none'")


def test_headings_go_down_step_by_step(page):
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))


def test_tables_are_captioned_and_headed(page, html):
    assert html.count("<table") == html.count("<caption") > 10
    assert all(th["scope"] in ("col", "row") for th in page.all("th"))
    assert page.all("html")[0]["lang"] == "en"


def test_nothing_breaks_out():
    suite = made_up_suite(title=EVIL, envs=["LaneKeeping"], skies=["urban"], seeds={"count": 2})
    outcomes = [
        made_up_outcome(task, status="raised", message=EVIL, ended=EVIL, success=False) for task in suite.tasks()
    ]
    html = render(Results.of(suite, outcomes, [("Merge-v0", EVIL, EVIL)]))
    page = Page(html)
    assert len(page.all("script")) == 1
    assert page.all("img") == []
    assert EVIL not in html
    assert any(EVIL in words for words in page.words["td"])


def test_results_without_rows_or_with_one_seed_are_shown():
    html = render(made_up_results(seeds={"count": 1}))
    assert "Stanford diagram of" not in html
    assert "difference against" not in html
    assert "against cost" in html


def test_nothing_driven_yet():
    suite = made_up_suite()
    html = render(Results.of(suite, []))
    assert "No episode has been driven yet" in html
    Page(html)


def test_agents_left_out_and_episodes_missing_are_told():
    suite = made_up_suite()
    outcomes = [made_up_outcome(task) for task in suite.tasks() if task.place.sky == "urban"]
    html = render(Results.of(suite, outcomes, [("Merge-v0", "lqr", "it steers")]))
    assert "lqr cannot drive Merge-v0 (it steers)" in html
    assert "not driven yet" in html


def test_who_sees_the_truth_is_told_and_never_best():
    suite = made_up_suite(agents=["nominal", "oracle"], envs=["LaneKeeping"], skies=["urban"])
    skill = {"nominal": 10.0, "oracle": 90.0}
    html = render(Results.of(suite, [made_up_outcome(t, total_return=skill[t.agent] + t.seed) for t in suite.tasks()]))
    assert "sees the truth" in html
    assert "their cost is not, because it includes terms that judge their navigator" in html
    assert 'class="best"' not in html


def test_a_clip_that_fails_is_told(results, monkeypatch):
    from lanebound.agents.report import write

    monkeypatch.setattr(write, "film_clip", lambda folder, outcome: Clip(outcome, trouble="No clip: <none>"))
    html = render(results, clips=2)
    assert html.count("No clip: &lt;none&gt;") == 2


def test_a_clip_lies_inside(results, monkeypatch):
    from lanebound.agents.report import write

    monkeypatch.setattr(
        write,
        "film_clip",
        lambda folder, outcome: Clip(outcome, "data:video/mp4;base64,AAAA", "data:image/jpeg;base64,BBBB"),
    )
    videos = Page(render(results, clips=9)).all("video")
    assert len(videos) == 4  # one at each place
    assert all(video["src"].startswith("data:video/mp4;base64,") and video["aria-label"] for video in videos)
    assert {video["poster"] for video in videos} == {"data:image/jpeg;base64,BBBB"}


def test_the_suite_and_its_version_are_told(results, html):
    mark = json.loads((results.folder / "run.json").read_text(encoding="utf-8"))
    assert mark["source"] in html
    assert f"<td>{mark['defaults']}</td>" in html
    assert f"<td>{mark['packages']['highway-env']}</td>" in html
    assert "test seeds 10000 to 10003" in html
