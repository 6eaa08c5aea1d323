"""Outcome of one episode of one agent, as plain data for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, NamedTuple

from lanebound.agents.episodes.guard import Failing
from lanebound.agents.serialization import finite_or_none

__all__ = [
    "GROUP_COST",
    "LEVEL_MAX_M",
    "MANOEUVRE_S",
    "OK",
    "PARTS",
    "TTA_S",
    "WALL_CLOCK",
    "Outcome",
    "Place",
    "Status",
    "Task",
]

Status = Literal["ok"] | Failing
OK: Status = "ok"
LEVEL_MAX_M = 10.0
"""Protection levels above it, and missing ones, count as this, as observations show them by default."""
TTA_S = 1.0
"""Longest time allowed from the onset of a failure to its alert (S3 II.A); as ``alert.time_to_alert_s`` by default."""
MANOEUVRE_S = 5.0
"""Length of the manoeuvres of which continuity is measured: a lane change in traffic takes 3 to 5 s; chosen."""
GROUP_COST = "group_cost_"
"""How the weighted costs of a group are named in tables and evaluations, before the name of the group."""
PARTS = {"costs": "", "mode_shares": "share_", "cost_limits": "cost_limit_", "group_costs": GROUP_COST}
"""Attributes that are mappings, and how their keys begin in a row of a table."""
WALL_CLOCK = ("solve_ms_median", "solve_ms_p99")


class Place(NamedTuple):
    """Where episodes are driven: an environment under a sky with faults."""

    env: str
    sky: str
    faults: str

    def __str__(self) -> str:
        return f"{self.env}/{self.sky.replace('/', '.')}-{self.faults}"


class Task(NamedTuple):
    """One episode to drive."""

    place: Place
    agent: str
    seed: int

    @property
    def id(self) -> str:
        """Its name in a folder of results: ``env/sky-faults/agent/seed``."""
        return f"{self.place}/{self.agent}/{self.seed}"


@dataclass(frozen=True)
class Outcome:
    """One episode of one agent.

    Everything but the solve times (see ``WALL_CLOCK``) follows from suite, seed and version, to the last bit. None
    stands for missing and infinite values. An agent that failed has a ``status`` other than ``ok``, and its values are
    those of the steps before the failure.

    Attributes
    ----------
    env, sky, faults, agent, seed : environment, sky, level of faults, agent and seed
    status, message : `ok` or the kind of failure of the agent; its description
    ended : `collision`, `off road`, `wrong way`, `time up`, `arrived` or `stopped` (the agent failed)
    steps, time_s, allotted_s : number of decisions, their time, longest possible time
    distance_m, mean_speed_mps : true distance and speed
    throughput_mps : distance over the time taken, or over the longest possible time in an episode without success
    gap_m : median true gap between bumpers to the vehicle ahead in the lane within 100 m
    total_return, cost, costs, cost_limit : sum of rewards, weighted sum of costs, unweighted sums by cause, limit
    cost_limits, group_costs : limits of the groups of causes that have one, and the weighted sums of these groups
    success, collision : the episode ended well; the true car crashed
    lane_departure : the true body left its lane outside commanded lane changes
    rms_acceleration_mps2, rms_jerk_mps3, rms_lateral_mps2 : of the true car, from decision to decision
    mode_shares : share of steps by positioning mode
    pl_at_median_m, pl_ct_median_m : protection levels; those above 10 m or missing count as 10 m
    no_level : share of steps without a protection level on either axis
    pe_at_median_m, pe_at_p75_m, pe_at_p95_m, pe_at_max_m : absolute errors along the track; `pe_ct_...` across it
    availability, alert_share, alerts : shares of steps; number of alerts
    mi_steps, hmi_steps : steps with misleading but not hazardous, and with hazardously misleading information
    time_to_alert_s : mean time from an error above its alert limit to the alert; if no alert comes, to the end of that
        error; None when no error was above its limit
    time_to_alert_max_s : the same of the latest alert
    missed_alerts : number of errors above their limits that ended without an alert
    integrity_failures : number of errors above their limits that lasted longer than TTA_S without an alert (S3 II.C)
    continuity : share of available steps after which the next one is available; 0 without any
    manoeuvre_continuity : of the steps without an alert and MANOEUVRE_S before the end at least, the share after which
        no alert comes for as long (S3 II.A); None without such a step
    first_fix_s : time to the first position by satellites; without one, the time of the episode
    fault_kind, fault_onset_s, fault_weight, fault_probability, no_fault_probability : of the one fault of ``faults:
        one``, as in ``info``; None without
    fault_alert_s : time from its onset to the first alert that begins after it; None without
    solve_ms_median, solve_ms_p99 : time of a decision [ms]
    infeasible, relaxed : decisions without a command that meets the agent's constraints, and decisions for which it
        weakened one; None for agents that do not count them
    """

    env: str
    sky: str
    faults: str
    agent: str
    seed: int
    status: Status = OK
    message: str = ""
    ended: str = "stopped"
    steps: int = 0
    time_s: float = 0.0
    allotted_s: float | None = None
    distance_m: float = 0.0
    mean_speed_mps: float | None = None
    throughput_mps: float | None = None
    gap_m: float | None = None
    total_return: float = 0.0
    cost: float = 0.0
    costs: dict[str, float] = field(default_factory=dict)
    cost_limit: float | None = None
    cost_limits: dict[str, float] = field(default_factory=dict)
    group_costs: dict[str, float] = field(default_factory=dict)
    success: bool = False
    collision: bool = False
    lane_departure: bool = False
    rms_acceleration_mps2: float | None = None
    rms_jerk_mps3: float | None = None
    rms_lateral_mps2: float | None = None
    mode_shares: dict[str, float] = field(default_factory=dict)
    pl_at_median_m: float | None = None
    pl_ct_median_m: float | None = None
    no_level: float | None = None
    pe_at_median_m: float | None = None
    pe_ct_median_m: float | None = None
    pe_at_p75_m: float | None = None
    pe_ct_p75_m: float | None = None
    pe_at_p95_m: float | None = None
    pe_ct_p95_m: float | None = None
    pe_at_max_m: float | None = None
    pe_ct_max_m: float | None = None
    availability: float | None = None
    alert_share: float | None = None
    alerts: int = 0
    mi_steps: int = 0
    hmi_steps: int = 0
    time_to_alert_s: float | None = None
    time_to_alert_max_s: float | None = None
    missed_alerts: int = 0
    integrity_failures: int | None = None
    continuity: float | None = None
    manoeuvre_continuity: float | None = None
    first_fix_s: float | None = None
    fault_kind: str | None = None
    fault_onset_s: float | None = None
    fault_weight: float | None = None
    fault_probability: float | None = None
    no_fault_probability: float | None = None
    fault_alert_s: float | None = None
    solve_ms_median: float | None = None
    solve_ms_p99: float | None = None
    infeasible: int | None = None
    relaxed: int | None = None

    @property
    def task(self) -> Task:
        """What was driven."""
        return Task(Place(self.env, self.sky, self.faults), self.agent, self.seed)

    @property
    def id(self) -> str:
        """Its name in a folder of results: ``env/sky-faults/agent/seed``."""
        return self.task.id

    @property
    def failed(self) -> bool:
        """Whether the agent failed to do its part."""
        return self.status != OK

    def to_dict(self) -> dict[str, Any]:
        """Plain data that JSON can hold."""
        return dict(finite_or_none(asdict(self)))

    def lasting(self) -> dict[str, Any]:
        """The same without the times that a clock on the wall measured: equal in every run."""
        return {key: value for key, value in self.to_dict().items() if key not in WALL_CLOCK}

    def flat(self) -> dict[str, Any]:
        """One row of a table: ``id`` first, costs by cause, shares of the modes as ``share_rtk``, and so on."""
        data = self.to_dict()
        parts = {name: data.pop(key) for key, name in PARTS.items()}
        named = {name + key: value for name, part in parts.items() for key, value in part.items()}
        return {"id": self.id, **data, **named}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Outcome:
        """The outcome of plain data; what other versions wrote in addition is left out."""
        known = {item.name for item in fields(cls)}
        return cls(**{key: value for key, value in data.items() if key in known})
