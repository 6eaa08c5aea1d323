"""Drives of the study of services: what a vehicle has in an epoch, and the convergence of PPP at rest.

HDOP is that of the satellites of the service that are tracked above its mask, with the clocks of its systems; and that
of those in the line of sight alone, which is closer to a receiver that loses weak signals. A service is ``corrected``
while the corrections that the vehicle holds are not older than their time-outs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.checkpointing.runner import Advance, ignore
from lanebound.agents.studies.street_drives import StreetDrivesConfig, drive_of, mask_of, navigator_of
from lanebound.envs.sky import SkyLevel
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.motion.truth import Truth, truth_between
from lanebound.integrity.navigators.navigator import Measurements, Navigator, NavigatorConfig, NavigatorState
from lanebound.integrity.navigators.services.table import declared_of, service_named
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.sky.systems import System
from lanebound.integrity.sky.visibility import SignalPath, SkyMask

__all__ = [
    "HOURS",
    "ServiceMoment",
    "ServiceStreet",
    "approach",
    "converge",
    "drive_service_street",
    "hdop",
    "streets_of",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

APPROACH_MPS, BRAKING_S = 10.0, 5.0
HOUR_S, WEEK_S = 3600, 604_800
HOURS = 24
NO_DOP = 1e3
DOP_EVERY_S = 1.0  # satellites hardly move in a second, and a car passes a few metres


class ServiceMoment(NamedTuple):
    """An epoch of B vehicles: error (B, 2) along and across the track [m], solution, HDOP (B,) of what is tracked and
    of what is in the line of sight, corrected (B,). HDOP is NaN but once a second."""

    error_m: Array
    solution: Solution
    hdop: Array
    hdop_direct: Array
    corrected: Bools


@dataclass(frozen=True)
class ServiceStreet:
    """A street that is built and driven once, for all services that drive there.

    Attributes
    ----------
    sky, number : preset of the sky, number of the street
    mask : what its buildings leave of the sky
    truths : true motion in each epoch, the same under every sky
    arrived : what vehicles know when they arrive from an open sky, by their configuration and the length of the way;
        shared by the skies of a number
    """

    sky: str
    number: int
    mask: SkyMask
    truths: list[Truth]
    arrived: dict[tuple[NavigatorConfig, float], NavigatorState]


def streets_of(config: StreetDrivesConfig, number: int) -> Iterator[ServiceStreet]:
    """Street ``number`` under each sky."""
    dt_s = config.navigator.dt_s
    truths = list(islice(drive_of(config, number, dt_s), round(config.span_s / dt_s)))
    arrived: dict[tuple[NavigatorConfig, float], NavigatorState] = {}
    for sky in config.skies:
        yield ServiceStreet(sky, number, mask_of(config, sky, number), truths, arrived)


def drive_service_street(
    config: StreetDrivesConfig, street: ServiceStreet, approach_s: float = 0.0
) -> Iterator[ServiceMoment]:
    """The epochs of a street after the warm-up, for the first service of the navigator.

    ``config`` is that of the street but for the navigator, which has the same epochs. ``approach_s``: length of a
    straight drive under an open sky before the street, in which PPP converges [s].
    """
    longer = config.replace(warm_up_s=config.warm_up_s + approach_s)
    navigator, truths = navigator_of(longer, street.sky, street.number, street.mask), street.truths
    if approach_s > 0.0:
        _arrive(navigator, longer, street, approach_s)
        truths = [replace(truth, time_s=truth.time_s + approach_s) for truth in truths]
    first, sampled = (round(time_s / navigator.config.dt_s) for time_s in (config.warm_up_s, DOP_EVERY_S))
    missing = np.full(config.vehicles, np.nan)
    for k, truth in enumerate(truths):
        measured = navigator.measure(truth)
        solution = navigator.locate(measured)
        if k < first:
            continue
        error, every, ours = solution.position_en_m - truth.position_enu_m[:, :2], missing, missing
        turned = np.einsum("bij,bj->bi", track_from_enu_matrix(truth.heading_rad), error)
        if (k - first) % sampled == 0:
            direct = navigator.mask.look(truth.arc_m, truth.lane, measured.sky).path == SignalPath.LOS
            every, ours = (hdop(navigator.config, measured, among) for among in (np.ones_like(direct), direct))
        yield ServiceMoment(turned, solution, every, ours, corrected(navigator.config, measured))


def _arrive(navigator: Navigator, config: StreetDrivesConfig, street: ServiceStreet, approach_s: float) -> None:
    """Let the vehicles arrive where the drive begins, from an approach under an open sky with an unbroken link.

    The link that they find in the street is that of a vehicle that is switched on there.
    """
    fitted = SkyLevel.named(street.sky).navigator(config.navigator)  # with the instruments of the sky
    afield = config.replace(navigator=fitted.replace(corrections=config.navigator.corrections.to_dict()))
    key = afield.navigator, approach_s
    if key not in street.arrived:
        other = navigator_of(afield, "open", street.number, SkyMask.open())
        for truth in approach(street.truths[0], approach_s, other.config.dt_s):
            other.step(truth)
        street.arrived[key] = other.snapshot()
    network, links = navigator.state.area.network, navigator.state.corrections
    navigator.restore(street.arrived[key])
    state = navigator.state
    state.area.network = replace(network, epoch=state.area.network.epoch)
    state.corrections = links


def approach(start: Truth, length_s: float, dt_s: float) -> Iterator[Truth]:
    """A straight drive that ends with the pose and speed at which another one starts."""
    epochs, heading = round(length_s / dt_s), start.heading_rad
    forward = np.stack([np.sin(heading), np.cos(heading)], -1)
    final = np.einsum("bi,bi->b", start.velocity_enu_mps[:, :2], forward)
    left_s = dt_s * np.arange(epochs, -1, -1)  # until the end, (T + 1,)
    speed = final + (APPROACH_MPS - final) * np.minimum(left_s / BRAKING_S, 1.0)[:, None]
    way = np.concatenate([[np.zeros_like(final)], np.cumsum(0.5 * dt_s * (speed[1:] + speed[:-1]), axis=0)])
    place = start.position_enu_m[:, :2] - dt_s * start.velocity_enu_mps[:, :2] + (way - way[-1])[..., None] * forward
    velocity = speed[..., None] * forward
    for k in range(epochs):
        yield truth_between(
            dt_s * (k + 1), dt_s, (place[k], place[k + 1]), (velocity[k], velocity[k + 1]), (heading, heading),
            start.arc_m, start.lane,
        )  # fmt: skip


def hdop(config: Any, m: Measurements, among: Bools) -> Array:
    """HDOP of those satellites of the first service that are among some (B, S), (B,); NO_DOP where they are too few."""
    service = service_named(config.service[0])
    systems, mask_deg = tuple(System.__members__), config.positioning.rtk.elevation_mask_deg
    if not service.fixes:
        declared = declared_of(config, service)
        systems, mask_deg = declared.systems, declared.elevation_mask_deg
    numbers = [int(System[name]) for name in systems]
    los = m.sky.los_enu[m.sky.index]
    used = m.gnss.tracked & among & np.isin(m.sky.system, numbers) & (los[..., 2] > np.sin(np.deg2rad(mask_deg)))
    clocks = (m.sky.system[:, None] == np.array(numbers)).astype(np.float64)
    design = np.concatenate([-los, np.broadcast_to(clocks, (*los.shape[:2], len(numbers)))], -1) * used[..., None]
    normal = np.swapaxes(design, 1, 2) @ design
    absent = np.einsum("bii->bi", normal) == 0.0  # clocks of systems without a satellite
    absent[:, :3] = False  # without any satellite there is no HDOP
    normal = normal + np.where(absent[:, :, None], np.eye(normal.shape[1]), 0.0)
    out = np.full(len(used), NO_DOP)
    good = np.linalg.cond(normal) < 1e10
    if good.any():
        cofactor = np.linalg.inv(normal[good])
        out[good] = np.sqrt(cofactor[:, 0, 0] + cofactor[:, 1, 1])
    return out


def corrected(config: Any, m: Measurements) -> Bools:
    """Whether the first service has what it needs of its provider, (B,); True without a provider."""
    service = service_named(config.service[0])
    if service.provider is None or m.gnss.corrections is None:
        return np.isfinite(m.gnss.corrections_age_s) if service.fixes else np.ones(len(m.gnss.tracked), np.bool_)
    held, declared = m.gnss.corrections[service.provider], declared_of(config, service)
    in_time = held.age_s <= declared.max_age_s
    return in_time & (held.zenith_age_s <= declared.zenith_max_age_s) if held.has_zenith else in_time


def converge(
    seed: int, hour: int, vehicles: int, minutes: int, every_s: int = 60, advance: Advance = ignore
) -> dict[str, list[float]]:
    """PPP of vehicles that stand under an open sky, by the minute since they were switched on.

    Returns lists by ``every_s``: the error on an axis (rms) and the largest on both axes [m], the median level of the
    larger axis [m], the share of vehicles with a position of PPP, and of errors beyond a level.
    """
    base = NavigatorConfig.preset("services/ppp").replace(dt_s=1.0, service=["ppp"])
    config = base.replace(sky={"week_second_s": (base.sky.week_second_s + HOUR_S * hour) % WEEK_S})
    seeds = [int(s) for s in np.random.SeedSequence([seed, hour]).generate_state(vehicles)]
    epochs = 60 * minutes
    navigator = Navigator.nominal(config, seeds=seeds, duration_s=epochs + 60.0)
    zero, still = np.zeros((vehicles, 2)), np.zeros(vehicles)
    navigator.place(zero, still, 30.0, 0.01)
    out: dict[str, list[float]] = {key: [] for key in ("rms_m", "largest_m", "level_m", "ppp", "beyond")}
    recent = np.zeros(vehicles, np.bool_)
    for k in range(epochs):
        solution = navigator.step(truth_between(k + 1.0, 1.0, (zero, zero), (zero, zero), (still, still)))
        recent |= solution.mode == Mode.PPP
        if (k + 1) % every_s == 0:
            error, level = np.abs(solution.position_en_m), np.stack([solution.pl_ct_m, solution.pl_at_m], -1)
            out["rms_m"].append(float(np.sqrt(np.mean(np.square(error)))))
            out["largest_m"].append(float(error.max()))
            out["level_m"].append(float(np.median(level.max(-1))))
            out["ppp"].append(float(recent.mean()))
            out["beyond"].append(float((error > level).any(-1).mean()))
            recent[:] = False
        advance((k + 1) / epochs)
    return out
