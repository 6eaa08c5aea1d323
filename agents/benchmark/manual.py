"""The manual of the benchmark, put together from what it is made of.

``python -m lanebound.agents.benchmark.manual > docs/benchmark.md`` writes it.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from dataclasses import fields

from lanebound.agents.benchmark.metrics import HARM_OF_AN_END, METRICS, Metric
from lanebound.agents.benchmark.outcome import Outcome
from lanebound.agents.benchmark.results import CSV_COLUMNS, ESTIMATE_COLUMNS, PAIRED_COLUMNS
from lanebound.agents.benchmark.seeds import TEST, TRAIN
from lanebound.agents.benchmark.statistics import RESAMPLES, VERDICT_SEEDS, seeds_to_exclude
from lanebound.agents.benchmark.store import STORED
from lanebound.agents.benchmark.suite import SuiteConfig, load_suite
from lanebound.agents.benchmark.untuned import tuned_places
from lanebound.agents.benchmark.verdicts import MARGIN
from lanebound.agents.drivers import ABOUT
from lanebound.integrity.core.config import describe

__all__ = ["SUITES", "markdown"]

SUITES = ("quick", "standard", "claim", "faults", "look_ahead", "learnt")

HEAD = f"""# The benchmark

Made by `python -m lanebound.agents.benchmark.manual > docs/benchmark.md`.

`lanebound benchmark SUITE --out DIR` drives environments under skies and faults with several agents, seed by
seed, and compares them. A run that is interrupted goes on when the same command is given again, and ends
bit-equal to an unbroken one, whatever the number of processes; times on the wall (`solve_ms_median`,
`solve_ms_p99`) are the one exception. A folder may be gone on with as long as the same episode would come out
the same: agents and seeds may be added, nothing else changed, the code and the versions of Python and of the numerical
packages included.

Seeds to train and tune on are {TRAIN[0]} to {TRAIN[-1]}, those held out to test on {TEST[0]} to {TEST[-1]}; a
suite takes the first ones of its split. Every episode has an agent made for it, and an environment that is
reset with the seed."""


def _tuned() -> str:
    return "\n".join(f"- `{base.removesuffix('World')}`, {sky} sky" for base, sky in tuned_places())


KINDS = (
    (
        "path/model.zip",
        "a checkpoint of Stable-Baselines3 or sb3-contrib (PPO, A2C, SAC, TD3, DQN, ...); one learnt on flat "
        "observations drives where they are dicts as well",
    ),
    (
        "path/model.onnx",
        "a network, with `onnxruntime` installed: inputs `ego`, `integrity`, `road`, `traffic`, or one for flat "
        "observations; the first output is the action, or a value for each discrete action",
    ),
    ("path/model.npz", "a policy's arrays, as `lanebound export DIR --out FILE.npz` writes them"),
    (
        "package.module:callable",
        "called with the environment; returns an object with `predict` as in Stable-Baselines3, or a function from "
        "observations to actions",
    ),
)
KEPT = (
    (
        "suite.json",
        "the suite in full, the version, those of numerical packages, digests of the code and of the agents",
    ),
    (
        "episodes/<env>/<sky>-<faults>/<agent>/<seed>.parquet",
        "one episode: a row for each decision, and its outcome as JSON in the metadata under `lanebound.outcome`",
    ),
    ("left_out.json", "agents that cannot drive an environment, and why"),
    (
        "results.json",
        "`suite`, `statistics`, `metrics`, `cells`, `paired`, `failures`, `left_out`, `missing`, `outcomes`",
    ),
    (
        "results.csv",
        "a row for each cell and metric: "
        + ", ".join(f"`{c}`" for c in (*CSV_COLUMNS, *ESTIMATE_COLUMNS, *PAIRED_COLUMNS))
        + "; then one for each paired difference: the agent that it is `against`, the difference as `mean`, "
        "its interval, the pairs as `n`, the episodes in which either failed as `failed`",
    ),
    ("episodes.parquet", "a row for each episode: its outcome, costs and shares in columns of their own"),
    ("report.html", "all of it in one page"),
    ("clips/", "its films, which are not made again while their episodes stay as they are"),
)

EXAMPLE = """```yaml
title: mine beside ours
envs: [LaneKeeping, CarFollowing]
skies: [urban, dense]
agents: [nominal, integrity_aware, {mine: {agent: runs/model.zip, config: {observation: {vehicles: 3}}}}]
seeds: {count: 20}
```"""
AGENTS = f"""## Agents

An agent of a suite is a name of ours, or `name: agent` with

{{kinds}}

and, where it needs another environment than the suite's, `name: {{agent: ..., config: {{observation: {{vehicles:
3}}}}}}`. An agent is to decide by observations alone; what it may read of the environment are its spaces and
its configuration. Checkpoints and modules run code: open only those that you trust.

`oracle` sees the truth, to show what is possible. Its collisions and lane departures are a bound; its cost is
none, for it includes terms that judge its navigator's belief: `cost_lane_integrity`, and the protection level in
`cost_headway`.

`cautious` keeps constant margins, tuned without faults for:

{_tuned()}

Everywhere else they are not fitted to the place, and tables call it untuned: no fair opponent. Tuning takes the least
of nine rungs of caution, on one line of margins, that does no more harm than `integrity_aware`, or else the caution of
the same throughput, by means over training seeds; other constant margins may do better.

An agent that fails is reported with its seed, and the rest of the run is kept. Its episodes count in `failed`
and `success`, and in nothing else; so its other figures leave out what may be the hard seeds. Where an agent failed in
a cell it gets neither colour nor star nor verdict there, and figures of fewer seeds than were driven say of how many
they are.

| status | means |
|---|---|
| `ok` | the agent did its part |
| `raised` | it raised, left, or its process died |
| `not_finite` | an action with NaN or infinity |
| `wrong_shape` | an action of another shape, or no numbers |
| `outside_space` | an action outside the action space |
| `timeout` | its decisions took longer than `episode_timeout_s` together; its process was ended |"""

STATISTICS = f"""## Statistics

The mean over seeds, and the interquartile mean (a quarter of the seeds cut off at each end), each with a 95 %
interval over seeds. Bootstraps take {RESAMPLES:,} resamples from a stream named by the number of seeds.

| of | interval |
|---|---|
| means | at each end the wider of Student's t and the studentised bootstrap, no further than values can be |
| interquartile means | percentile bootstrap, expanded as Hesterberg 2015 has it, from {VERDICT_SEEDS} seeds on |
| rates | Clopper and Pearson: with no collision in n seeds it ends at about 3.7 / n |
| differences | paired by seed: that of means; of rates Agresti and Min 2005 with Student's quantile |

Seeds that are all the same say nothing of how others may differ: then there is no interval (`null`), and neither
is there where all but about three of the seeds are (nearly) the same, or where there are fewer than four. What is
rare is judged by whether it happened at all: `any_hmi`, `any_mi` and `any_missed` are rates, and always have one.

A difference comes with the share of the seeds in which it is for the better. One agent is called better than
another where the interval of their difference leaves 0 out, and never with fewer than {VERDICT_SEEDS} seeds: so
few do not show how figures are spread. Among many comparisons some intervals leave 0 out by chance; colours and stars
are of each figure by itself.

The lines that call an agent safer in a cell take more:

- one of `collision`, `off_road`, `lane_departure` and `harm` is clearly lower, also by its p-value adjusted by Holm's
  method over all agents, references, cells and these four. P-values are of Student's t, never less than the signs of
  the differences can give (`2^(1 - k)` with k seeds that differ), and of rates those of McNemar's exact test;
- none of the four is clearly higher;
- the upper ends of the intervals of the differences in `collision` and `off_road` are at most
  {100.0 * MARGIN:g} percentage points, which takes {seeds_to_exclude(MARGIN)} seeds even where nothing happens;
- the agent ended an episode well, and neither of the two failed.

`cost` is no part of it: some of its causes judge protection levels and alerts, which some agents obey. `harm` is
{HARM_OF_AN_END:g} for an episode that ends in a crash or off the road, and the sum of `cost_lane`. Differences in
throughput are told over all cells where neither agent failed, not over those of the praise.

How often intervals leave out the truth, nominally 5 %
(2,000 trials; "zeros" is 0 in four of five seeds, exponential in the others):

| seeds | normal | exponential | zeros, of those with an interval | percentile bootstrap, for comparison |
|---|---|---|---|---|
| 4 | 2.0 % | 5.3 % | 0 %; 97 % have none | 21 %, 27 %, 53 % |
| 10 | 3.9 % | 4.6 % | 0.6 %; 83 % have none | 9.4 %, 14 %, 32 % |
| 50 | 5.4 % | 4.3 % | 1.9 %; 0.6 % have none | 6.5 %, 7.1 %, 13 % |"""

FILES = """## Files

{files}

JSON holds no infinity: what is infinite or does not exist is `null`. From Python:

```python
from lanebound.agents.benchmark import Results

results = Results.load("out/demo")
for cell in results.cells:
    print(cell.place, cell.agent, cell.metrics["return"].mean)
rows = results.rows(results.outcomes[0])  # a pyarrow Table
```

`lanebound replay-episode DIR ID --video FILE.mp4` drives an episode again by its id
(`env/sky-faults/agent/seed`), checks that it ends as it did, and films it."""


def markdown() -> str:
    """The whole manual in Markdown."""
    parts = [
        HEAD,
        "## Suites",
        _suites(),
        "A suite of your own is a YAML file, such as",
        EXAMPLE,
        "with these keys (`extends: suites/quick` and the lines that differ will do, too):",
        _keys(),
        AGENTS.replace("{kinds}", _pairs("agent", KINDS)),
        _drivers(),
        "## Metrics",
        "Arrows: which way is better. Shares are from 0 to 1.",
        _metrics(),
        STATISTICS,
        FILES.replace("{files}", _pairs("file", KEPT)),
        "## An outcome",
        _outcome(),
        "## A row of an episode",
        _columns(),
    ]
    return "\n\n".join(parts) + "\n"


def _pairs(head: str, rows: Sequence[tuple[str, str]]) -> str:
    return "\n".join([f"| {head} | is |", "|---|---|", *(f"| `{name}` | {text} |" for name, text in rows)])


def _drivers() -> str:
    """The agents of ours, as ``lanebound agents`` lists them."""
    head = "Ours; levels are protection levels, actions the spaces that it can command:"
    lines = ["| agent | does | reads | on an alert | actions |", "|---|---|---|---|---|"]
    lines += [f"| `{name}` | {' | '.join(about)} |" for name, about in ABOUT.items()]
    return "\n".join([head, "", *lines])


def _suites() -> str:
    lines = ["| suite | for | environments | skies | faults | agents | seeds |", "|---|---|---|---|---|---|---|"]
    for name in SUITES:
        s = load_suite(name)
        faults = ", ".join(fault.value for fault in s.faults)
        envs = ", ".join(env.removesuffix("-v0") for env in s.envs)
        agents = ", ".join(f"`{agent}`" for agent in s.agents)
        seeds = f"{s.seeds.count} after {s.seeds.skip:,}" if s.seeds.skip else f"{s.seeds.count}"
        lines.append(f"| `{name}` | {s.title} | {envs} | {', '.join(s.skies)} | {faults} | {agents} | {seeds} |")
    return "\n".join(lines)


def _keys() -> str:
    suite = SuiteConfig.load({"envs": ["LaneKeeping"], "agents": ["nominal"]})
    told = [(e.path, _value(e.value), e.description) for e in describe(suite) if not e.path.startswith("agents")]
    told.insert(4, ("agents", "", str(SuiteConfig.model_fields["agents"].description)))
    needed = [name for name, field in SuiteConfig.model_fields.items() if field.is_required()]
    lines = [f"| `{key}` | {'needed' if key in needed else default} | {text} |" for key, default, text in told]
    return "\n".join(["| key | default | is |", "|---|---|---|", *lines])


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f"`[{', '.join(str(getattr(item, 'value', item)) for item in value)}]`"
    return "" if value in ("", {}) else f"`{value}`"


def _metrics() -> str:
    lines = ["| key | unit | | is |", "|---|---|---|---|"]
    return "\n".join([*lines, *map(_line, METRICS)])


def _line(metric: Metric) -> str:
    arrow = {"higher": "↑", "lower": "↓", None: ""}[metric.better]
    return f"| `{metric.key}` | {metric.unit} | {arrow} | {metric.meaning} |"


def _outcome() -> str:
    """The attributes' part of its docstring, a list."""
    text = (inspect.getdoc(Outcome) or "").partition("Attributes\n----------\n")[2].replace("``", "`")
    names = ", ".join(f"`{item.name}`" for item in fields(Outcome))
    items = "\n".join(f"- {line}" if line[:1] != " " else line for line in text.splitlines())
    return f"Its fields in their order: {names}.\n\n{items}"


def _columns() -> str:
    lines = ["| column | type | unit | is |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| `{c.name}` | {c.kind} | {c.unit} | {c.meaning} |" for c in STORED)])


if __name__ == "__main__":
    sys.stdout.write(markdown())
