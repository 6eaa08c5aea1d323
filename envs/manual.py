"""The page of the environments, made from their docstrings, their configuration and the index of observations.

``python -m lanebound.envs.manual > docs/environments.md`` writes it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable
from enum import Enum
from typing import Any

import gymnasium

from lanebound.envs.config import EnvConfig
from lanebound.envs.core import DrivingEnv
from lanebound.envs.ids import CLASSES, MORE, PRICED, Preset, id_of
from lanebound.envs.lane_sensor import LaneSensorConfig
from lanebound.envs.observation import GROUPS, OBSERVATION_INDEX
from lanebound.envs.observation.index import Entry
from lanebound.envs.registration import make_config
from lanebound.integrity.core.config import describe
from lanebound.integrity.sensors.fault_kinds import FaultKind
from lanebound.integrity.sensors.fault_registry import fault_kinds

__all__ = ["SECTIONS", "markdown"]

SECTIONS = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Costs",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
)
"""Of an environment's page, in Gymnasium's order."""

HEAD = """# Environments

The page describes first what all environments share, then each id. In the section of an id, "as above" refers to [all
environments](#all-environments), and missing headings are as above. Then follow [sky](#sky),
[perception](#perception), [faults](#faults), [lane sensor](#lane-sensor), [many environments at
once](#many-environments-at-once), [other worlds](#other-worlds), [rendering](#rendering), [configuration
keys](#configuration-keys) and the [observation index](#observation-index).
`python -m lanebound.envs.manual > docs/environments.md` makes it from docstrings and defaults.

```pycon
>>> import gymnasium, lanebound.envs
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"}, render_mode="rgb_array")
>>> observation, info = env.reset(seed=1)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
>>> {group: len(vector) for group, vector in observation.items()}
{'ego': 15, 'integrity': 44, 'road': 43, 'traffic': 114}
>>> env.render().shape
(540, 960, 3)
>>> env.close()

```"""

TOPICS = """## Sky

`sky` sets the buildings along the roads and the outages of the correction link.

| `sky` | along the road | mean outage of the link | RTK missing at 12 m/s |
|---|---|---|---|
| `open` | nothing | no outages | 0 % |
| `suburban` | houses, trees, overpasses | 5 s | about 5 % |
| `urban` | four to seven storeys, trees, overpasses | 15 s | 10 to 25 % |
| `dense` | five to nine storeys, trees, overpasses | 30 s | 42 to 52 % |
| `plaza` | glass towers, far apart, beside wide streets | 15 s | 20 to 65 % |

Half of the missing RTK comes from buildings, half from the link; under `plaza` more from buildings (4 cities each,
`tests/envs/test_sky_levels.py`). UrbanCanyon has its own sequence of streets; the preset sets their heights. A `.yaml`
file of your own may start with `extends: skies/urban`. A recorded sky is a `.csv` file of `lanebound record-sky`, with
the link and the sensors of `urban`. `navigator: {gnss: {near_objects: {kind: vehicle}}}` adds multipath of the car's
roof and of what is beside it ([signals](results/signals.md#near-objects)).

## Perception

`perception.source` selects how the car knows other vehicles.

| source | measurements |
|---|---|
| `v2v` | each vehicle has a navigator of its own (`perception.others`) and broadcasts its estimated pose and levels |
| `sensor` | an ego sensor measures vehicles within 80 m that no other vehicle hides |
| `both` | the newest of the two measurements of each vehicle; if they are equally old, that of the sensor |
| `truth` | true poses without delay |
| `none` | no other vehicles |

- Messages: 10 a second, delayed by 0.05 s plus an exponential delay of 0.03 s on average. A message over the distance d
  is received with the probability 0.95 (1 - (d / 300 m)^4).
- Sensor errors (1 sigma): 0.2 m in distance, 0.3 degrees in bearing, 0.1 m/s in relative speed, 2 degrees in heading,
  and 0.1 m across, constant in an episode. A measurement is placed on the map with the estimated pose of the car.
- Vehicles are extrapolated at constant velocity and dropped 1 s after their last measurement. Their levels grow with
  the age t: along by `8 m/s2 t^2 / 2`, across by `8 m/s2 t^2 / 2 + v t sin(5 deg)`.
- Buildings at the corners of Intersection (`perception.sensor.corner_m`, none by default) hide vehicles from the
  sensor: a vehicle is seen if the line from the middle of the car to its middle crosses no building. With 7 m from the
  middles of both roads, 3 m beside the lanes, crossing traffic is seen where both are near the crossing. Messages come
  around corners.
- `perception.wrong_share` (0) makes each of the others a wrong sender with that probability: what it broadcasts is
  displaced by 5 to 20 m (`wrong_m`) in any direction for the whole episode, with its levels unchanged. The levels of
  a message cannot tell; a sensor of the car can.
- With `perception.others: surrogate` a vehicle broadcasts its true pose and speed with errors and levels from one of 64
  recorded episodes of the same configuration, which the vector engine records once, in a minute or more
  ([surrogates](results/surrogates.md)).

## Faults

`faults="nominal"` draws random faults at published rates (rare events), `"stress"` at rates so high that every kind is
expected within about an hour of driving, `"one"` [exactly one in each episode](#one-fault-in-each-episode).
`reset(options={"faults": [...]})` replaces those of the first two:

```pycon
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"sky": "open"})
>>> spoofing = {"kind": "spoofing", "start_s": 5.0, "duration_s": 20.0, "magnitude_m": 3.0, "azimuth_deg": 90.0}
>>> observation, info = env.reset(seed=1, options={"faults": [spoofing]})
>>> env.close()

```

@FAULT_KINDS@

### One fault in each episode

`faults="one"` draws exactly one fault in each episode, so that misleading information and late alerts, which nominal
rates hardly ever show, can be measured and learnt. It strikes the ego or what all vehicles share. Each kind with a
nominal rate above 0 is equally likely, but for `v2v_lie`, which a vehicle does not feel itself. Target, length and size
are drawn as at nominal rates; the onset is uniform over the longest time of an episode, so that an episode may be over
before it. `info` has:

| key | value |
|---|---|
| `fault_kind` | place of the kind in `fault_kinds()`, as in the table above, from 0 |
| `fault_onset_s` | onset since the start of the episode |
| `fault_weight` | w: probability of the kind at nominal rates, given exactly one fault, over that of the draw |
| `fault_probability` | P1 = L exp(-L): of one such fault at nominal rates; L: their expected number in an episode |
| `no_fault_probability` | P0 = exp(-L): of none |

For any figure X of an episode, `E[X] = P0 E[X | none] + P1 E[w X | one] + rest`; the rest is of episodes with two
faults and more (with probability 1 - P0 - P1). The [benchmark](benchmark.md#one-fault) estimates both terms.

```pycon
>>> from lanebound.integrity.sensors.fault_registry import fault_kinds
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"faults": "one"})
>>> observation, info = env.reset(seed=1)
>>> kind, weight = fault_kinds()[int(info["fault_kind"])].name, info["fault_weight"]
>>> env.close()

```

[Extending](extending.md#fault-kind) describes kinds of your own.

| key | default | meaning |
|---|---|---|
| `start_s`, `duration_s` | 0, 10 | from the start of the episode; length |
| `profile`, `ramp_s` | `step`, 10 | `ramp`: linear growth over `ramp_s`, also in Doppler |
| `system`, `prn` | None | 0 GPS, 1 Galileo, 2 GLONASS, 3 BeiDou, 4 QZSS; number of the satellite |
| `band` | None | band of a cycle slip, 0 or 1; None: both |
| `vehicle` | None | 0: the ego; 1 and more: other vehicles; None: all |
| `azimuth_deg` | 90 | direction of a displacement, or side of the sky of `nlos_burst`, clockwise from North |
| `satellites`, `loss_db` | 4, 6 | number of satellites that `nlos_burst` strikes, and their loss of C/N0 |
| `integers` | [] | errors of `wrong_fix` by satellite: `[system, prn, cycles of band 1, cycles of band 2]` |
| `magnitude` | 0 | size of a kind of your own, in the unit of its `Magnitude`, if that names no other field |

## Lane sensor

With `lane_sensor: {}` a forward camera keeps the car in its lane, and the position says on which road and where it is
(S2 section 2: cameras keep the lane, satellites choose the road). Without it (`null`, the default) the car keeps its
lane by the position.

- The camera measures offset and heading in the lane that the car is truly in, with noise and an error that is constant
  in an episode. It sees the number of that lane from the left, the lanes beside it, and how the lane bends ahead. It
  knows neither the road nor the place along it.
- Steering follows the measured offset, whatever the position says. A change of lane is to the lane beside the one that
  the camera sees. At a fork the lane decides: the car goes on along the lane that it follows.
- During a dropout (a process of two states) the pose in the lane is carried on by the odometer and the turns of the
  navigator, and its bound grows (`lane_sensor.gyro_bound_degps`).
- The believed road is the one that fits the navigator's position and heading best on the lane of the camera's number;
  the last one is kept unless another fits better by 2 m (`lane_sensor.switch_m`). The believed pose is on that lane,
  with the camera's offset and heading, at the navigator's place along it. So a wrong road is believed from an error
  across of half the distance of lanes of the same number and half of those 2 m on, until it is below half the distance
  less half of them.
- `err_at_m`, `err_ct_m`, `mi` and `hmi` are of the navigator's position, before it is put on a lane.
- Levels and alert limits are of the position, and say nothing about the lane. `cost_lane_integrity` takes the bound of
  the camera (`Qinv(risk / 2) sigma`). `alert_limit: budget` is refused.
- A road is possible if the level across reaches its pavement from the navigator's position, on a stretch that the level
  along reaches. `integrity.possible_limit` is the least limit of the possible roads, `integrity.roads_agree` whether
  they ask for the same change of lanes for the goal.

Entries in `road`: `lane_seen`, `route_shift`, `offset`, `other_road`, `other_limit`.

@LANE_SENSOR@

## Alert limits

`alert_limit: fixed` (default) has one limit for the whole id: 1.5 m along, `(lane width - car width) / 2` across. It
contains neither the body in bends, nor the control error, nor the gap; errors just below it harm in seven of eight ids
([alert limits](results/alert-limits.md)). `alert_limit: budget` computes both limits at each decision from the room
that is left: across from the lane, the turned body, the estimated offset and bends; along from bends, crossings and the
gap to a leader known by radio. Observations (`margin_*`, `ratio_*`, `al_*`) and `info` contain them. An alert by such a
limit is held for 1 s.

```pycon
>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config={"alert_limit": "budget", "sky": "open"})
>>> observation, info = env.reset(seed=1)
>>> bool(0.29 <= info["al_ct_m"] < 0.625)
True
>>> env.close()

```

## Many environments at once

`gymnasium.make_vec(id, num_envs=N, config={...})` steps N environments in compiled code where the table above says so,
and refuses options that the engine does not support. With seed s, environment i behaves as a single environment with
seed s + i, with the same random faults. Faults of `reset(options={"faults": [...]})` apply to all environments, or to
those of `"reset_mask"`. Rendering needs single environments (`vectorization_mode="sync"` or `"async"`).
[Training](training.md#many-environments-at-once) describes reset modes and Stable-Baselines3.

Given the same poses of all vehicles, observations, rewards, costs and infos have equal bits (the term `base` of
Racetrack agrees within 1e-12). The compiled dynamics round differently from highway-env's: poses agree within 1e-9, all
decisions exactly. The rounding can grow until the rest of the episode differs: where a vehicle steers by highway-env's
law below 0.5 m/s, two vehicles crash in line, or two lanes overlap (one bend of Racetrack). This happened in 37 of 844
episodes with random commands in dense traffic: 15 of 60 in Intersection, 10 of 80 in Roundabout, 8 of 213 in
UrbanCanyon (`.venv/bin/python tests/helpers/parted.py` prints all cases).

## Other worlds

`lanebound.envs.wrap(id, config)` adds the same navigation to other ids of highway-env:

```pycon
>>> env = lanebound.envs.wrap("two-way-v0", {"sky": "suburban"})
>>> env.action_space
Discrete(5)

```

Its `cost_limit` is 10. Worlds without lanes (parking) or with several agents are refused.

`lanebound.envs.wrap_vec(id, N, config)` makes N of them in the vector engine, with the same results. It drives
the ids `highway`, `highway-fast`, `exit`, `two-way` (with evenly spaced target speeds), `u-turn`, `merge`,
`roundabout`, `intersection`, `racetrack` and `racetrack-large` in all their versions, and refuses the others.

```pycon
>>> envs = lanebound.envs.wrap_vec("two-way-v0", 3, {"sky": "open"})
>>> observations, infos = envs.reset(seed=1)
>>> infos["pl_ct_m"].shape
(3,)
>>> envs.close()

```

## Rendering

`render_mode="rgb_array"` returns an array (height, width, 3) of uint8, `"human"` opens a window.

| drawn | meaning |
|---|---|
| filled car, outline | true car, estimated pose |
| solid box | the outline enlarged by the protection levels |
| dashed lines | the width swept along the lane, enlarged by the alert limit across |
| other vehicles | perceived vehicles with their levels |
| status light | navigation only: NORMAL means that all levels are within their limits |
| CRASHED, OFF ROAD, WRONG WAY | the true state |
| letters in the sky plot | G GPS, E Galileo, R GLONASS, C BeiDou, J QZSS |

The keys `rendering.*` set size, scale, orientation, theme and panel. `lanebound drive ID --video FILE.mp4` writes a
film."""


PRICED_TEXT = """In the ids `...Priced-v0` to stop has a price; the others stay as they are. Alert limits are of a
budget (`alert_limit: budget`), an alert permits the speed that follows from the level (`cost.alert_speed: level`),
`cost_blocking` has the weight 1, and a body beyond its lane costs at rest as at 2 m/s. The cost limit is for a mean:
that of `integrity_aware` without crashes over 40 training seeds, and 1 % of a crash, rounded up
([rule](results/cost-limits.md)). Other ids have no such variant, because a car that stands or crawls would keep such a
limit too often ([degenerate policies](results/degenerate-policies.md#priced-ids)), or because that was not measured."""
PAGED = (*CLASSES, *(kind for kind in MORE if kind not in PRICED))
"""Ids with a page of their own."""
PRICED_HEAD = ("id", "cost limit", "cost limit without prices", "more")


def _later(kind: type[Preset]) -> tuple[str, ...]:
    """The row of a priced id."""
    now, before = make_config(id_of(kind)), make_config(id_of(kind).replace("Priced", ""))
    more = f"`traffic.behind` {now.traffic.behind}" if now.traffic.behind else ""
    return f"`{id_of(kind)}`", f"{now.cost_limit:g}", f"{before.cost_limit:g}", more


def markdown() -> str:
    """The whole page in Markdown."""
    parts = [HEAD, _contents(), "## All environments", _page(DrivingEnv)]
    for kind in PAGED:
        parts += [f"## {kind.__name__}", f'`gymnasium.make("{id_of(kind)}")`', _page(kind)]
    parts += ["## Priced ids", PRICED_TEXT, _table(PRICED_HEAD, map(_later, PRICED))]
    return "\n\n".join([*parts, _topics(), _keys(), _index()]) + "\n"


def _topics() -> str:
    """The sections on single topics, with their tables."""
    fields = LaneSensorConfig.model_fields.items()
    keys = ((f"`{name}`", f"{field.default:g}", str(field.description)) for name, field in fields)
    sensor = _table(("key of `lane_sensor`", "default", "meaning"), keys)
    return TOPICS.replace("@FAULT_KINDS@", _fault_table()).replace("@LANE_SENSOR@", sensor)


SAME = re.compile(r"## [\w ]+\n(As above\.|\* v0: first version.*)(\n\n|$)")
"""A section of an id that says nothing of its own."""


def _page(kind: type[DrivingEnv]) -> str:
    """A class's docstring with its headings one level lower, less the sections that say nothing of their own."""
    return SAME.sub("", (inspect.getdoc(kind) or "").strip()).strip().replace("## ", "### ")


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    names = list(head)
    lines = [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


# Ids


def _contents() -> str:
    head = ("id", "world", "action", "sky", "cost limit", "compiled engine")
    return _table(head, (_line(kind, EnvConfig.build(kind.PRESET)) for kind in PAGED))


def _line(kind: type[Preset], c: EnvConfig) -> list[str]:
    engine = gymnasium.spec(id_of(kind)).vector_entry_point is not None
    name, action = f"[{id_of(kind)}](#{kind.__name__.lower()})", f"{c.action.value}, {c.policy_hz} Hz"
    return [name, f"`{c.base}`", action, c.sky, f"{c.cost_limit:g}", "yes" if engine else "no"]


# Configuration


SHORT = re.compile(
    r"perception\.(v2v|sensor|\w+_bound)|rendering\.|observation\.\w+_max|observation\.range_m|wander\.|cost\.|actuators\."
)
"""Keys without a meaning of their own in the table: other sections of the page document them."""


def _keys() -> str:
    """Every key of the configuration with its default, less weights, which have tables, and keys of the package."""
    rows: list[list[str]] = []
    short: dict[str, list[str]] = {}
    for key, value, unit, text in describe(EnvConfig(base="highway-v0")):
        default = "needed" if key == "base" else f"{_plain(value)} {unit if value is not None else ''}".strip()
        if text.startswith("weight of") or key.startswith("reward.") or "an environment sets it" in text:
            continue
        if SHORT.match(key):
            group, _, name = key.rpartition(".")
            short.setdefault(group, []).append(f"`{name}` {default}")
        else:
            rows.append([f"`{key}`", default, _without_source(text).replace("|", "\\|")])
    parts = [
        "## Configuration keys",
        'A dot separates levels: `cost.response_s` is `config={"cost": {"response_s": 0.5}}`. The defaults are those\n'
        "before the preset of an id. The descriptions in the code name the source of a number.",
        _table(("key", "default", "meaning"), rows),
        "Weights are keys such as `reward.progress` and `cost.lane` (of `cost_lane`), with the defaults of the tables\n"
        "of [rewards](#rewards) and [costs](#costs). Other keys that the sections above describe, and scales of\n"
        "observations:",
        _table(("group", "keys and defaults"), ([f"`{group}`", ", ".join(keys)] for group, keys in short.items())),
    ]
    return "\n\n".join(parts)


def _without_source(text: str) -> str:
    """A description without the parts that only say where a number comes from."""
    first, *more = text.split("; ")
    return "; ".join([first, *(part for part in more if ":" in part or part.startswith(("must", "not ", "or ")))])


def _plain(value: Any) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_plain, value))}]"
    if value == {}:
        return "empty"
    return f"{value:g}" if isinstance(value, float) else str(value)


# Faults


def _fault_table() -> str:
    """A row for each registered kind of fault."""
    return _table(("`kind`", "effect", "magnitude", "profiles", "needs"), map(_fault_row, fault_kinds()))


def _fault_row(kind: FaultKind) -> list[str]:
    magnitudes = " or ".join(f"`{m.field}` [{m.unit}], {m.bounds}" for m in kind.magnitudes) or "-"
    needs = ", ".join(f"`{name}`" for name in kind.needs) or "-"
    return [f"`{kind.name}`", kind.summary, magnitudes, ", ".join(kind.profiles), needs]


# Observations


def _index() -> str:
    """Every entry of the default observation; entries that repeat for vehicles and distances stand once."""
    places: dict[tuple[str, str], list[tuple[int, Entry]]] = {}
    for place, entry in enumerate(OBSERVATION_INDEX):
        places.setdefault((entry.group, _pattern(entry.name)), []).append((place, entry))
    parts = [
        "## Observation index",
        f"{len(OBSERVATION_INDEX)} entries by default. An entry is a quantity divided by the end of its range. `flat`"
        " is the position in\nthe flat form; in the dict form positions count from the first entry of the group. i is"
        " the number of a vehicle (0:\nthe nearest), a distance d or an axis (0 `at`, 1 `ct`). A configuration may add"
        " entries, such as those of services:\nselect entries by name.",
        "```pycon\n>>> from lanebound.envs.observation import entries\n"
        '>>> changes = {"sky": "open", "navigator": "services/spp"}\n'
        '>>> env = gymnasium.make("lanebound/LaneKeeping-v0", config=changes)\n'
        ">>> observation, info = env.reset(seed=1)\n"
        ">>> shown = entries(env.unwrapped.config.observation)\n"
        '>>> names = [entry.name for entry in shown if entry.group == "integrity"]\n'
        '>>> float(observation["integrity"][names.index("mode_spp")]), info["mode"]\n(1.0, 5)\n\n```',
        "`lanebound envs ID` prints the index of an id, with `--set` that of another configuration, and\n"
        "`lanebound.envs.observation.describe(config)` returns it as a table.",
    ]
    for group in GROUPS:
        rows = [_row(pattern, members) for (of, pattern), members in places.items() if of == group]
        parts += [f"### {group}", _table(("flat", "entry", "range", "meaning"), rows)]
    return "\n\n".join(parts)


DISTANCE = re.compile(r"(?<=_)(\d+)(?=m(_|$))")
AXIS = re.compile(r"^(pl|al|ratio|margin|trend)_(at|ct)(?=_|$)")
ONE_OF = re.compile(r"^(reason|mode)_(\w+)$")


def _pattern(name: str) -> str:
    """A name without the number of a vehicle or distance, the axis, or the case of which one flag is set."""
    plain = AXIS.sub(r"\1_{axis}", ONE_OF.sub(r"\1_{case}", re.sub(r"^v\d+_", "v{i}_", name)))
    return DISTANCE.sub("{d}", plain)


def _row(pattern: str, members: list[tuple[int, Entry]]) -> list[str]:
    (first, entry), *more = members
    flat, meaning = str(first), entry.meaning
    if pattern.endswith("_{case}"):
        cases = ", ".join(f"`{member.name.partition('_')[2]}`" for _, member in members)
        return [f"{first} to {members[-1][0]}", f"`{pattern}`", "flag", f"one flag for each {pattern[:-7]}: {cases}"]
    if more:
        flat = f"{first} + {more[0][0] - first} i"
    found = DISTANCE.search(entry.name)
    if found is not None:
        meaning = meaning.replace(f"{found[1]} m", "d")
    if "{axis}" in pattern:
        meaning = meaning.replace("along track", "on the axis")
    scale = f"{entry.scale:.4g}" if len({other.scale for _, other in members}) == 1 else "d"
    reach = f"0 to {scale}" if entry.low == 0.0 else f"±{scale}"
    is_flag = (entry.low, entry.scale, entry.unit) == (0.0, 1.0, "") and not entry.name.endswith("_share")
    shown = "flag" if is_flag else f"{reach} {entry.unit}".strip()
    return [flat, f"`{pattern}`", shown, meaning]


if __name__ == "__main__":
    sys.stdout.write(markdown())
