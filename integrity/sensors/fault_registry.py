"""The fault kinds by name: those of the package, and those that a program registers.

Each kind of the package is an effect function and an entry of the table that declares it. Priors of satellites and
systems are commitments of their providers; those of vehicles and roads are chosen.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.presets import nearest, require_registered
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.fault_kinds import FaultKind, FaultMoment, FaultPrior, FaultTarget, Magnitude

__all__ = ["BUILT_IN", "FAULT_TABLE", "KindName", "fault_kind", "fault_kinds", "register_fault", "withdraw_fault"]


Array = NDArray[np.float64]
BURST_FROM_RAD = math.radians(10.0)  # lowest elevation of the satellites of a burst; receivers use those above
MOST_RANK = 100  # of a wrong candidate of integers: the search gets slow
LEAST_FACING = 1e-9  # e.n of a satellite that a facade reflects: beyond rounding


def _satellite_range(effects: FaultEffects, now: FaultMoment) -> None:
    """A satellite clock drifts: code and phase ranges of the satellite are off by the same length."""
    _bias_ranges(effects, now, now.fault.magnitude_m * now.satellites)


def _constellation(effects: FaultEffects, now: FaultMoment) -> None:
    """The frame of a system is displaced by d: each range of line of sight e is off by ``-e.d``."""
    size = now.fault.magnitude_m * now.satellites
    _bias_ranges(effects, now, -size * (now.sky.los_enu[now.sky.index] @ now.fault.direction_enu))


def _bias_ranges(effects: FaultEffects, now: FaultMoment, size_m: NDArray[np.floating[Any]]) -> None:
    """Add range errors, (S,) or (B, S) at full size, to code and phase, and their growth to the Doppler."""
    size = np.broadcast_to(size_m, effects.code_bias_m.shape)[now.rows]
    bias = size * now.level
    effects.code_bias_m[now.rows] += bias
    effects.phase_bias_m[now.rows] += bias
    effects.range_rate_bias_mps[now.rows] += size * now.growth_per_s


def _cycle_slip(effects: FaultEffects, now: FaultMoment) -> None:
    """The ambiguity jumps, once."""
    if now.begins:
        band = now.fault.band
        bands = slice(None) if band is None else slice(band, band + 1)
        effects.slip_cycles[now.rows, :, bands] += now.fault.magnitude_cycles * now.satellites[:, None]


def _reference_coordinates(effects: FaultEffects, now: FaultMoment) -> None:
    effects.reference_enu_m[now.rows] += _displacement_m(now)


def _spoofing(effects: FaultEffects, now: FaultMoment) -> None:
    """The signals describe another position; a drift of that position is a velocity v, which adds ``-e.v``."""
    effects.spoof_enu_m[now.rows] += _displacement_m(now)
    feigned_mps = now.fault.magnitude_m * now.growth_per_s * now.fault.direction_enu
    effects.range_rate_bias_mps[now.rows] -= (now.sky.los_enu @ feigned_mps)[now.sky.index[now.rows]]


def _jamming(effects: FaultEffects, now: FaultMoment) -> None:
    effects.cn0_drop_db[now.rows] += now.magnitude


def _corrections_loss(effects: FaultEffects, now: FaultMoment) -> None:
    effects.corrections_lost[now.rows] = True


def _gyro_bias(effects: FaultEffects, now: FaultMoment) -> None:
    effects.gyro_bias_radps[now.rows] += math.radians(now.fault.magnitude_degps) * now.level


def _wheel_slip(effects: FaultEffects, now: FaultMoment) -> None:
    effects.odometer_scale[now.rows] *= 1.0 + now.magnitude


def _odometer_frozen(effects: FaultEffects, now: FaultMoment) -> None:
    effects.odometer_frozen[now.rows] = True


def _v2v_lie(effects: FaultEffects, now: FaultMoment) -> None:
    effects.v2v_offset_enu_m[now.rows] += _displacement_m(now)
    effects.v2v_pl_scale[now.rows] *= 1.0 + now.fault.magnitude_ratio * now.level


def _wrong_fix(effects: FaultEffects, now: FaultMoment) -> None:
    """Integers are those of a wrong candidate, of its rank by fit, or wrong by the cycles given.

    Positioning subtracts the cycles. It finds the candidate itself, because that depends on the satellites it holds.
    """
    if now.fault.magnitude_rank:
        effects.next_best[now.rows] = now.fault.magnitude_rank, math.radians(now.fault.azimuth_deg)
    effects.integer_error[now.rows] += now.fault.magnitude_cycles * now.satellites[:, None]
    for system, prn, *cycles in now.fault.integers:
        effects.integer_error[now.rows, (now.sky.system == system) & (now.sky.prn == prn)] += np.array(cycles)


def _nlos_burst(effects: FaultEffects, now: FaultMoment) -> None:
    """The lowest satellites on the side of the azimuth arrive by a facade on the other side alone.

    Its normal n points to the azimuth, and the magnitude is twice its distance d, so that the extra path is ``L = 2 d
    (e.n)``: the code has the whole of it, the carrier its change since the onset, the Doppler its rate. A step is a
    drive along the facade; a ramp moves away from it.
    """
    sky, n = now.sky, now.fault.direction_enu
    for k in np.unique(sky.index):
        facing = sky.los_enu[k] @ n
        lit = np.flatnonzero((facing > LEAST_FACING) & sky.above[k] & (sky.elevation_rad[k] > BURST_FROM_RAD))
        struck = lit[np.argsort(sky.elevation_rad[k, lit], kind="stable")][: now.fault.satellites]
        rows = np.arange(sky.batch)[now.rows]
        where = np.ix_(rows[sky.index[rows] == k], struck)
        twice_m = now.fault.magnitude_m * facing[struck]
        effects.code_bias_m[where] += now.level * twice_m
        effects.phase_bias_m[where] += (now.level - now.fault.level(now.fault.start_s)) * twice_m
        effects.range_rate_bias_mps[where] += now.growth_per_s * twice_m
        effects.cn0_drop_db[where] += now.fault.loss_db


def _displacement_m(now: FaultMoment) -> Array:
    """Displacement towards the azimuth of the fault at this time, (3,)."""
    return now.fault.magnitude_m * now.level * now.fault.direction_enu


METRES = Magnitude("m", "magnitude_m")

FAULT_TABLE: tuple[FaultKind, ...] = (
    FaultKind(
        name="satellite_range",
        summary="code and phase ranges of one satellite; a ramp also its Doppler",
        apply=_satellite_range,
        target=FaultTarget.SATELLITE,
        magnitudes=(METRES,),
        needs=("system", "prn"),
        sizes_tried=(0.02, 0.1, 0.5, 5.0, 50.0),
        prior=FaultPrior(per_h=1e-5, median_s=600.0, low=5.0, high=100.0),
        prior_source="GPS SPS PS 2020: 1e-5 per hour and satellite, error above 4.42 URA, ended within the hour",
    ),
    FaultKind(
        name="constellation",
        summary="ranges of one system: they describe a position displaced towards the azimuth; a ramp also its Doppler",
        apply=_constellation,
        target=FaultTarget.SYSTEM,
        magnitudes=(METRES,),
        needs=("system",),
        sizes_tried=(0.1, 0.5, 2.0, 10.0),
        prior=FaultPrior(per_h=1e-4, median_s=600.0, low=5.0, high=100.0, ramp_share=1.0),
        prior_source="ARAIM ADD v3: 1e-4 for Galileo and others (GPS 1e-8), wrong Earth orientation",
    ),
    FaultKind(
        name="cycle_slip",
        summary="carrier phase of one satellite, or of all of a system: one jump, in one band or both",
        apply=_cycle_slip,
        target=FaultTarget.SATELLITE,
        magnitudes=(Magnitude("cycles", "magnitude_cycles", whole=True),),
        profiles=("step",),
        needs=("system",),
        sizes_tried=(1, 3, 10),
        prior=FaultPrior(per_h=0.05, median_s=0.2, low=1, high=10, ramp_share=0.0),
        prior_source="slips a receiver does not notice, per satellite; a few per day of urban driving",
    ),
    FaultKind(
        name="reference_coordinates",
        summary="coordinates of the reference station: RTK positions move towards the azimuth",
        apply=_reference_coordinates,
        target=FaultTarget.STREET,
        magnitudes=(METRES,),
        sizes_tried=(0.05, 0.5, 2.0, 10.0),
        prior=FaultPrior(per_h=1e-5, median_s=3600.0, low=0.05, high=2.0, ramp_share=0.0),
        prior_source="wrong reference coordinates; an operator's error every ten years of a station",
    ),
    FaultKind(
        name="spoofing",
        summary="all satellite signals: they describe a position displaced towards the azimuth; a ramp also a velocity",
        apply=_spoofing,
        target=FaultTarget.STREET,
        magnitudes=(METRES,),
        sizes_tried=(0.5, 2.0, 10.0, 50.0, 200.0),
        prior=FaultPrior(per_h=1e-5, median_s=60.0, low=5.0, high=50.0, ramp_share=1.0),
        prior_source="drag-off; rare outside of known regions",
    ),
    FaultKind(
        name="jamming",
        summary="carrier-to-noise density of all satellite signals: a loss",
        apply=_jamming,
        target=FaultTarget.STREET,
        magnitudes=(Magnitude("dB", "magnitude_db", ge=0.0, signed=False),),
        sizes_tried=(10.0, 20.0, 40.0),
        prior=FaultPrior(per_h=0.2, median_s=10.0, low=5.0, high=40.0, ramp_share=1.0),
        prior_source="privacy jammers; STRIKE3: 1,141 deliberate events at 8 airports in 30 days",
    ),
    FaultKind(
        name="corrections_loss",
        summary="the link to the reference station: no data",
        apply=_corrections_loss,
        profiles=("step",),
        prior=FaultPrior(per_h=2.0, median_s=11.5),
        prior_source="loss of the mobile network; outage length fits S1 section 5",
    ),
    FaultKind(
        name="gyro_bias",
        summary="the yaw gyro: a bias, positive clockwise",
        apply=_gyro_bias,
        magnitudes=(Magnitude("deg/s", "magnitude_degps"),),
        sizes_tried=(0.1, 0.5, 2.0),
        in_blackout=True,
        prior=FaultPrior(per_h=1e-4, median_s=600.0, low=0.1, high=2.0),
        prior_source="jump of a MEMS bias, shock or temperature",
    ),
    FaultKind(
        name="wheel_slip",
        summary="the odometer: 1 + magnitude times the distance",
        apply=_wheel_slip,
        magnitudes=(Magnitude("of speed", "magnitude_ratio", gt=-1.0, signed=False),),
        sizes_tried=(0.02, 0.1, 0.5),
        in_blackout=True,
        prior=FaultPrior(per_h=0.1, median_s=1.0, low=0.05, high=0.5, ramp_share=0.0),
        prior_source="slippery patches beyond the slip of normal driving",
    ),
    FaultKind(
        name="odometer_frozen",
        summary="the odometer: it repeats its last message",
        apply=_odometer_frozen,
        profiles=("step",),
        in_blackout=True,
        prior=FaultPrior(per_h=1e-4, median_s=5.0),
        prior_source="stuck bus message; ASIL B wheel-speed sensors aim at 1e-7 per hour",
    ),
    FaultKind(
        name="v2v_lie",
        summary="the broadcast of a vehicle: its position moves towards the azimuth, its levels grow by the ratio",
        apply=_v2v_lie,
        magnitudes=(METRES, Magnitude("of the level", "magnitude_ratio", gt=-1.0)),
        sizes_tried=(0.5, 2.0, 10.0),
        broadcast=True,
        prior=FaultPrior(per_h=1e-3, median_s=60.0, low=1.0, high=20.0),
        prior_source="wrong or malicious broadcasts; chosen",
    ),
    FaultKind(
        name="wrong_fix",
        summary="RTK fixes wrong integers: the n-th best (rank) of those that move the position to the side of the "
        "azimuth, or the right ones plus cycles (of a satellite, a system or `integers`)",
        apply=_wrong_fix,
        magnitudes=(
            Magnitude("rank", "magnitude_rank", ge=1, le=MOST_RANK, signed=False, whole=True),
            Magnitude("cycles", "magnitude_cycles", whole=True),
        ),
        lists_integers=True,
        profiles=("step",),
        sizes_tried=(1, 2, 5, 20),
        prior=FaultPrior(per_h=0.0, median_s=10.0, low=1, high=20, ramp_share=0.0),
        prior_source="never: the navigator spends a tenth of its risk on them; a city drive by RTKLIB has 6 % of fixes",
    ),
    FaultKind(
        name="nlos_burst",
        summary="the lowest satellites on the side of the azimuth: reflections by a facade alone, unseen by the map; "
        "code, carrier, Doppler and C/N0",
        apply=_nlos_burst,
        magnitudes=(Magnitude("m", "magnitude_m", gt=0.0, signed=False),),
        sizes_tried=(5.0, 20.0, 60.0),
        tried_with=({"loss_db": 2.0}, {"loss_db": 4.0}, {}),
        prior=FaultPrior(per_h=0.0, median_s=10.0, low=5.0, high=60.0),
        prior_source="never: in streets the ray casting gives reflections; several at once are frequent there",
    ),
)
"""Random faults are drawn in this order: a new kind stands at the end, so that those before it stay the same."""


_kinds: dict[str, FaultKind] = {kind.name: kind for kind in FAULT_TABLE}
BUILT_IN = frozenset(_kinds)
"""Names of the kinds of the package."""


def fault_kinds() -> tuple[FaultKind, ...]:
    """All kinds: those of the package, then registered ones in the order of registration."""
    return tuple(_kinds.values())


def fault_kind(name: str) -> FaultKind:
    """The kind of this name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in _kinds:
        raise InputError(f"fault kind must be one of {_names()}, got {name!r}: {nearest(name, _kinds)}")
    return _kinds[name]


def register_fault(kind: FaultKind) -> FaultKind:
    """Add a kind, which faults, schedules, environments, random faults and the fault campaign take from then on.

    A process registers its kinds itself: call this at the top level of a module. The fault campaign registers them in
    its worker processes.

    Returns
    -------
    The kind.

    Raises
    ------
    InputError
        Another kind has this name.
    """
    if _kinds.setdefault(kind.name, kind) != kind:
        raise InputError(
            f"the name of a fault kind must be new, got {kind.name!r}: choose another name, or call "
            f"withdraw_fault({kind.name!r}) before"
        )
    return kind


def withdraw_fault(name: str) -> None:
    """Remove a registered kind.

    Raises
    ------
    InputError
        There is none of this name, or it is a kind of the package.
    """
    if name in BUILT_IN:
        raise InputError(f"a kind of the package cannot be removed, got {name!r}: remove registered kinds alone")
    require_registered("fault kind", name, [kind for kind in _kinds if kind not in BUILT_IN])
    del _kinds[name]


def _names() -> str:
    *head, last = (f"'{name}'" for name in _kinds)
    return f"{', '.join(head)} or {last}"


def _registered(name: Any) -> Any:
    if not isinstance(name, str) or name not in _kinds:
        raise PydanticCustomError("enum", "Input should be {expected}", {"expected": _names()})
    return name


KindName = Annotated[str, BeforeValidator(_registered)]
"""Name of a registered kind, as a field of a configuration."""
