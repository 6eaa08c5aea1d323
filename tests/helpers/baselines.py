"""A rover and a base as two receivers would record them, from satellites on circular orbits."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
from navigation_texts import record

from lanebound.integrity.core.frames import ecef_from_enu_matrix, ecef_from_geodetic
from lanebound.integrity.recorded.rinex_header import Header
from lanebound.integrity.recorded.rinex_observation import Observations, SystemRows
from lanebound.integrity.sky.broadcast import positions
from lanebound.integrity.sky.ephemeris import Ephemerides
from lanebound.integrity.sky.orbit import ranges_and_sights
from lanebound.integrity.sky.systems import SPEED_OF_LIGHT_MPS, System

WEEK, TOW = 2320, 116_400.0
PLACE = ecef_from_geodetic(np.radians(35.13), np.radians(136.97), 100.0)
AXES = ecef_from_enu_matrix(np.radians(35.13), np.radians(136.97))
LETTER = {System.GPS: "G", System.GALILEO: "E"}
CODES = {"G": ("C1C", "L1C", "S1C", "C2W", "L2W", "S2W"), "E": ("C1C", "L1C", "S1C", "C5Q", "L5Q", "S5Q")}
WAVELENGTH_M = {"G": (1575.42e6, 1227.60e6), "E": (1575.42e6, 1176.45e6)}


def sky(seed: int = 3, wanted: int = 7) -> Ephemerides:
    """``wanted`` satellites of GPS and of Galileo above 15 degrees at the place and time of the session."""
    rng, count = np.random.default_rng(seed), 400
    system = np.repeat([int(System.GPS), int(System.GALILEO)], count // 2)
    zero = np.zeros(count)
    time = WEEK * 604_800.0 + TOW
    table = Ephemerides(
        system=system, prn=np.arange(count) % (count // 2) + 1, toe_s=np.full(count, time), toc_s=np.full(count, time),
        toe_of_week_s=np.full(count, TOW), root_a=np.where(system == System.GPS, 5153.7, 5440.6),
        eccentricity=rng.uniform(0.0, 0.01, count), inclination_rad=np.full(count, 0.97),
        node_rad=rng.uniform(-np.pi, np.pi, count), perigee_rad=rng.uniform(-np.pi, np.pi, count),
        mean_anomaly_rad=rng.uniform(-np.pi, np.pi, count), motion_correction_radps=zero, node_rate_radps=zero - 8e-9,
        inclination_rate_radps=zero, cuc_rad=zero, cus_rad=zero, cic_rad=zero, cis_rad=zero, crc_m=zero, crs_m=zero,
        clock=np.column_stack([rng.uniform(-1e-4, 1e-4, count), rng.uniform(-1e-11, 1e-11, count), zero]),
        group_delay_s=np.zeros((count, 2)), health=np.zeros(count, np.int64), source=np.ones(count, np.int64),
        issue=np.ones(count, np.int64), stopped="", left_out=(),
    )  # fmt: skip
    place = positions(table, [time]).position_ecef_m[0]
    _, sight = ranges_and_sights(place, PLACE)
    above = np.flatnonzero((sight @ AXES)[:, 2] > np.sin(np.radians(15.0)))
    ours = table.satellites[above]
    keep = [np.flatnonzero((table.system == s) & np.isin(table.prn, ours[ours[:, 0] == s][:wanted, 1])) for s in (0, 1)]
    return table.take(np.concatenate(keep))


def receiver(
    table: Ephemerides, time_s: np.ndarray, place_ecef_m: np.ndarray, *, clock_s: float, seed: int,
    code_m: float = 0.3, phase_m: float = 0.002, slips: dict[tuple[int, int], float] | None = None,
    delay_m: np.ndarray | None = None,
) -> Observations:  # fmt: skip
    """What a receiver at places (T, 3) records at times (T,) after TOW by a clock that is off.

    ``slips`` are cycles (1 on both bands each) added to the phase of satellite s from epoch k on, with the receiver's
    indicator set at that epoch: {(s, k): cycles}. ``delay_m`` (n,) is a slant ionosphere on the first band.
    """
    rng, n = np.random.default_rng(seed), len(table.satellites)
    shape = (time_s.size, n)
    seen = WEEK * 604_800.0 + TOW + time_s[:, None] - clock_s  # true times of reception
    travel, distance, clock = np.full(shape, 0.075), np.zeros(shape), np.zeros(shape)
    for _ in range(4):
        states = positions(table, seen * np.ones(shape), travel)
        distance, _ = ranges_and_sights(states.position_ecef_m, place_ecef_m[:, None, :])
        travel, clock = distance / SPEED_OF_LIGHT_MPS, states.clock_s
    whole = distance + SPEED_OF_LIGHT_MPS * (clock_s - clock)
    integers = rng.integers(-100_000, 100_000, (n, 2)) * 1.0
    rows = {}
    for system, letter in LETTER.items():
        own = np.flatnonzero(table.satellites[:, 0] == system)
        columns, lost = np.zeros((*shape, 6)), np.zeros((*shape, 6), np.bool_)
        for band in range(2):
            wavelength = SPEED_OF_LIGHT_MPS / WAVELENGTH_M[letter][band]
            cycles = np.tile(integers[:, band], (time_s.size, 1))
            for (s, k), size in (slips or {}).items():
                cycles[k:, s] += size
                lost[k, s, 3 * band + 1] = True
            late = 0.0 if delay_m is None else delay_m * (WAVELENGTH_M[letter][0] / WAVELENGTH_M[letter][band]) ** 2
            columns[..., 3 * band] = whole + late + rng.normal(0.0, code_m, shape)
            columns[..., 3 * band + 1] = (whole - late + rng.normal(0.0, phase_m, shape)) / wavelength + cycles
            columns[..., 3 * band + 2] = 45.0
        epoch, column = (v.ravel() for v in np.meshgrid(np.arange(time_s.size), own, indexing="ij"))
        rows[letter] = SystemRows(
            CODES[letter], epoch, table.satellites[column, 1], columns[epoch, column], lost[epoch, column],
            np.zeros((epoch.size, 6), np.bool_),
        )  # fmt: skip
    header = Header(3.04, "", "", "", tuple(place_ecef_m[0]), (0.0, 0.0, 0.0), CODES, {}, {}, None, "GPS", 18)
    week = np.full(time_s.size, WEEK, dtype=np.int64)
    return Observations(header, week, TOW + time_s, np.zeros(time_s.size, np.bool_), rows, None)


def slant(table: Ephemerides, vertical_m: np.ndarray) -> np.ndarray:
    """Slant delays (n,) of a thin layer at 350 km for vertical ones, at the place and time of the session."""
    place = positions(table, [WEEK * 604_800.0 + TOW]).position_ecef_m[0]
    sine = (ranges_and_sights(place, PLACE)[1] @ AXES)[:, 2]
    return np.asarray(vertical_m / np.sqrt(1.0 - (6371.0 / 6721.0) ** 2 * (1.0 - sine**2)))


def observation_text(observations: Observations) -> str:
    """The observations as a RINEX 3.04 file."""
    header = {
        "RINEX VERSION / TYPE": "     3.04           OBSERVATION DATA    M",
        "APPROX POSITION XYZ": "".join(f"{v:14.4f}" for v in observations.header.position_ecef_m or ()),
        **{f"{letter}": f"{letter}{len(codes):5d} {' '.join(codes)}" for letter, codes in CODES.items()},
        "TIME OF FIRST OBS": "  2024     6    24     8    20    0.0000000     GPS",
        "END OF HEADER": "",
    }
    labels = {letter: "SYS / # / OBS TYPES" for letter in CODES}
    lines = [f"{text:<60}{labels.get(label, label)}" for label, text in header.items()]
    for k, tow in enumerate(observations.tow_s):
        rows = [(letter, r, i) for letter, r in observations.rows.items() for i in np.flatnonzero(r.epoch == k)]
        time = datetime(1980, 1, 6) + timedelta(weeks=int(observations.week[k]), seconds=float(tow))
        lines.append(f"> {time:%Y %m %d %H %M} {time.second:10.7f}  0{len(rows):3d}")
        for letter, r, i in rows:
            cells = (f"{v:14.3f}{int(lost)} " for v, lost in zip(r.value[i], r.lost[i], strict=True))
            lines.append(f"{letter}{r.satellite[i]:02d}" + "".join(cells))
    return "\n".join(lines) + "\n"


def navigation_text(table: Ephemerides) -> str:
    """The messages as a RINEX 3.04 navigation file; numbers are 1 to 99 within a system."""
    lines = [
        f"{'     3.04           N: GNSS NAV DATA    M: MIXED':<60}RINEX VERSION / TYPE",
        " " * 60 + "END OF HEADER",
    ]
    for i in range(len(table.system)):
        time = datetime(1980, 1, 6) + timedelta(seconds=float(table.toc_s[i]))
        elements = {
            "crs": 0.0, "delta_n": 0.0, "m0": table.mean_anomaly_rad[i], "cuc": 0.0, "e": table.eccentricity[i],
            "cus": 0.0, "sqrt_a": table.root_a[i], "toe_sow": table.toe_of_week_s[i], "cic": 0.0,
            "omega0": table.node_rad[i], "cis": 0.0, "i0": table.inclination_rad[i], "crc": 0.0,
            "omega": table.perigee_rad[i], "omega_dot": table.node_rate_radps[i], "idot": 0.0,
        }  # fmt: skip
        name = f"{LETTER[System(int(table.system[i]))]}{table.prn[i]:02d}"
        lines.append(record(name, f"{time:%Y %m %d %H %M %S}", tuple(table.clock[i]), elements, 0.0).rstrip())
    return "\n".join(lines) + "\n"


__all__ = ["AXES", "PLACE", "navigation_text", "observation_text", "receiver", "sky", "slant"]
