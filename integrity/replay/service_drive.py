"""A recorded drive through the navigator ``rtk_reckoning`` with a positioning service.

The navigator's clock ticks every ``dt_s``; an epoch of the recording belongs to the nearest tick, and ticks without one
have no signals. Wheel speed and yaw rate come from the recording, where it has them; between positions of the service
they move the position. Without them each epoch has the position of its own codes and nothing lies in between.

A recording without range rates has no Doppler. Its heading is that which fits the code positions of the last minute to
the path of wheels and gyro (:func:`~.code_epochs.reckoned_steps`); it is given to the navigator as a course that a
compass would measure, whenever it is surer than the navigator's own. There is neither accelerometer nor Doppler to
compare the odometer with, so that its watch is off: wheels count as healthy.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.accuracy import bounding_by_axis, doubt
from lanebound.integrity.assessment.plotting import save, series_figure
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.core.progress import Progress, silent
from lanebound.integrity.navigators.navigator import Measurements, NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.config import RtkReckoningConfig
from lanebound.integrity.navigators.rtk_reckoning.navigator import RtkReckoningNavigator
from lanebound.integrity.navigators.services.table import SERVICES, declared_of, service_named
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.recorded.rinex_observation import read_observations
from lanebound.integrity.recorded.source import interpolated
from lanebound.integrity.replay import write_summary
from lanebound.integrity.replay.baseline import require_one_site, solve_baseline
from lanebound.integrity.replay.baseline_report import read_coordinates
from lanebound.integrity.replay.city import read_city
from lanebound.integrity.replay.code_epochs import WINDOW_S, fit_heading
from lanebound.integrity.replay.datasets import find_pair, navigation_files, observation_files
from lanebound.integrity.replay.reckoning import BridgeConfig, integral, reckon
from lanebound.integrity.replay.service_epochs import ServiceEpochs, epochs_of_drive, epochs_of_receiver
from lanebound.integrity.sensors.augmentation import Corrections
from lanebound.integrity.sensors.gnss import GnssEpoch
from lanebound.integrity.sensors.imu import ImuSample
from lanebound.integrity.sensors.odometer import OdometerSample
from lanebound.integrity.sky.broadcast import Ephemerides, read_navigation
from lanebound.integrity.sky.klobuchar import read_klobuchar
from lanebound.integrity.sky.track import SkyTrack
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import SkyMask

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NO_DOPPLER_DBHZ = 99.0  # lowest C/N0 of range rates, where a recording has none
FAR_M = 2.6e7
UNWATCHED = 1e3  # limit of the odometer's watch that nothing reaches [m/s^2], [s]
LATE_SHARE = 0.3  # of a tick, by which an epoch may miss its own
SUREST_RAD = np.deg2rad(0.5)  # a fitted heading counts as no better
LEAST_M = 30.0  # of a path to which positions are fitted
KNOWN_RAD = np.deg2rad(10.0)  # deviation of the first heading that is taken
NEEDS = {
    "sbas_l1": "messages of SBAS satellites",
    "sbas_dfmc": "messages of SBAS satellites on L5",
    "ppp": "precise orbits and clocks",
    "nrtk": "a virtual station of a network",
}


@dataclass(frozen=True)
class ServiceDrive:
    """T ticks: time [s], position in E, N (T, 2) [m], heading [rad], mode, levels (T, 2) on AT, CT [m], alert,
    available; ``epoch`` (T,) the recorded epoch of a tick, -1 for none; ``begun_s`` of the first position with a known
    heading."""

    config: NavigatorConfig
    epochs: ServiceEpochs
    time_s: Array
    epoch: Ints
    position_en_m: Array
    heading_rad: Array
    mode: Ints
    pl_m: Array
    alert: NDArray[np.bool_]
    available: NDArray[np.bool_]
    begun_s: float

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Ticks (T,) with a recorded epoch, a true position and a position, from the first one with a known heading."""
        e = self.epochs
        there = (self.epoch >= 0) & e.known[self.epoch] & (self.mode != Mode.NONE)
        return np.asarray(there & (self.time_s >= self.begun_s))

    def errors_en_m(self) -> Array:
        """Errors (N, 2) of the judged ticks in E and N [m]."""
        keep = self.judged
        return np.asarray(self.position_en_m[keep] - self.epochs.truth_enu_m[self.epoch[keep], :2])

    def record(self) -> Record:
        """Errors, levels and alerts of the judged ticks, in the track that the navigator believes in.

        Raises
        ------
        InputError
            There is no judged tick.
        """
        keep = self.judged
        if not keep.any():
            raise InputError(
                f"the drive must have epochs with position and truth after {self.begun_s:g} s, has none: "
                "give its truth, or a longer drive"
            )
        track = (track_from_enu_matrix(self.heading_rad[keep]) @ self.errors_en_m()[:, :, None])[..., 0]
        pl = self.pl_m[keep]
        return Record(
            self.time_s[keep], self.mode[keep], track[:, 0], track[:, 1], pl[:, 0], pl[:, 1], self.alert[keep],
            self.available[keep],
        )  # fmt: skip


def require_possible(names: Sequence[str], station: bool, where: str) -> None:
    """Refuse services whose data no recording of this kind holds.

    Raises
    ------
    ConfigError
        A service is unknown, or needs what the recording does not have.
    """
    for service in map(service_named, names):
        name = service.name
        if name == "rtk":
            raise ConfigError(
                "--service rtk is the replay of a pair without this option: leave it out, or take dgps or spp"
            )
        need = NEEDS.get("nrtk" if service.fixes else service.provider or "")
        if need is not None:
            raise ConfigError(
                f"--service {name} needs {need}, which {where} does not hold: take spp, or dgps where a base is "
                "recorded, or drive a simulation with this service"
            )
        if service.provider == "dgps" and not station:
            raise ConfigError(
                f"--service {name} needs the observations of a base, which {where} does not hold: take spp, or a pair"
            )
        if service.combined:
            raise ConfigError(
                f"--service {name} needs two bands, and recordings are used on the first one: take spp or dgps"
            )


def config_of(
    epochs: ServiceEpochs, names: Sequence[str], dt_s: float, changes: Mapping[str, Any] | None = None
) -> RtkReckoningConfig:
    """The navigator's configuration for a recording, with ``changes`` on top.

    Raises
    ------
    ConfigError
        A change is invalid, is of a service that is not used, or asks for carrier smoothing without a carrier.
    """
    c = BridgeConfig()
    base: dict[str, Any] = {
        "service": list(names),
        "dt_s": dt_s,
        "modes": [] if epochs.odometry is None else ["imu_odometer"],
        "gnss": {"undifferenced": True},
        "positioning": {
            "doppler": {"cn0_min_dbhz": NO_DOPPLER_DBHZ},
            "heading": {
                "angle_random_walk_rad": float(np.deg2rad(c.heading_walk_deg_per_sqrt_s)),
                "bias_initial_radps": float(np.deg2rad(c.heading_drift_degps)),
            },
            "dead_reckoning": {
                "odometer_sigma_mps": c.speed_sigma_mps, "odometer_scale": c.speed_scale,
                "heading_bias_deg": c.heading_bias_deg,
                "watch": {"accelerometer_bias_mps2": UNWATCHED, "stuck_s": UNWATCHED},
            },
        },
    }  # fmt: skip
    if epochs.odometry is None:  # nothing moves a position, so that each epoch needs its own
        base["services"] = {s.name: {"interval_s": 0.0} for s in map(service_named, names) if s.declared is None}
    config = RtkReckoningConfig.build(base, changes)
    _require_used((changes or {}).get("services"), [service_named(name).name for name in config.service])
    for service in map(service_named, config.service):
        declared = declared_of(config, service)
        if declared.smoothing_s > 0.0 and not epochs.has_carrier:
            raise ConfigError(
                f"services.{service.name}.smoothing_s must be 0 where no carrier is recorded, got "
                f"{declared.smoothing_s:g}: codes cannot be smoothed there"
            )
    return config


def _require_used(changed: Any, chosen: Sequence[str]) -> None:
    """Refuse changes of services that the drive does not use: they would have no effect."""
    names = changed if isinstance(changed, Mapping) else {}
    unused = next((name for name in names if name in SERVICES and name not in chosen), None)
    if unused is not None:
        raise ConfigError(
            f"services.{unused} must be of a service that is used, {', '.join(chosen)}: add {unused} to --service, or "
            "leave it out"
        )


def drive_service(epochs: ServiceEpochs, config: RtkReckoningConfig, progress: Progress = silent) -> ServiceDrive:
    """Drive a recording; ``progress`` is called with the number of ticks that are done and the total number.

    Raises
    ------
    InputError
        Epochs do not fit the ticks of the navigator.
    """
    require_possible(config.service, epochs.station is not None, "the recording")
    tick = np.rint(epochs.time_s / config.dt_s).astype(np.int64)
    off = float(np.abs(epochs.time_s - tick * config.dt_s).max())
    if off > LATE_SHARE * config.dt_s or (np.diff(tick) < 1).any():
        raise InputError(
            f"dt_s must divide the time between epochs, got {config.dt_s:g} s and epochs up to {off:.3f} s off: "
            "set dt_s to it"
        )
    count = int(tick[-1]) + 1
    at = np.full(count, -1)
    at[tick] = np.arange(tick.size)
    run, time = _Run(epochs, config, count), np.asarray(config.dt_s * np.arange(count), np.float64)
    out = ServiceDrive(
        config, epochs, time, at, np.zeros((count, 2)), np.zeros(count),
        np.full(count, int(Mode.NONE)), np.full((count, 2), np.inf), np.ones(count, np.bool_),
        np.zeros(count, np.bool_), 0.0,
    )  # fmt: skip
    for n in range(count):
        run.advance(n, int(at[n]), out)
        progress(n + 1, count)
    return replace(out, begun_s=run.begun_s)


class _Run:
    """The navigator of one drive, and what it is given."""

    def __init__(self, epochs: ServiceEpochs, config: RtkReckoningConfig, count: int) -> None:
        self.epochs, self.config = epochs, config
        satellites = len(epochs.system)
        far = np.tile(np.array([0.0, 0.0, FAR_M]), (2, satellites, 1))
        duration = config.dt_s * count
        self.track = SkyTrack(0.0, duration, far, np.zeros_like(far), 0.0, epochs.system, epochs.prn)
        self.navigator = RtkReckoningNavigator(config, self.track, SkyMask.open(), [0])
        self.nothing = np.zeros((1, satellites), np.bool_)
        self.los = np.zeros((1, satellites, 3))
        self.los[..., 2] = 1.0
        self.steered, self.begun_s = False, np.inf if epochs.odometry is not None else 0.0
        self._prepare_odometry(np.asarray(config.dt_s * np.arange(count + 1) - config.dt_s, np.float64))
        if epochs.odometry is None:
            self.navigator.align(np.zeros(1), SUREST_RAD)  # axes of the levels: along North, across East

    def _prepare_odometry(self, edge_s: Array) -> None:
        """Mean speed (T,), turn (T,) and path of the ticks between edges (T + 1,)."""
        o = self.epochs.odometry
        count = edge_s.size - 1
        self.speed, self.turn = np.zeros((2, count))
        self.way, self.path_heading = np.zeros((count, 2)), np.zeros(count)
        if o is None:
            return
        path = reckon(o.time_s, o.speed_mps, -o.yaw_rate_left_radps)
        now = edge_s[1:]
        heading = np.interp(edge_s, path.time_s, path.heading_rad)
        distance = np.interp(edge_s, path.time_s, integral(o.time_s, o.speed_mps))
        self.turn, self.speed = np.diff(heading), np.diff(distance) / self.config.dt_s
        self.path_heading = heading[1:]
        self.way = interpolated(now, path.time_s, path.position_m)

    def advance(self, n: int, k: int, out: ServiceDrive) -> None:
        """One tick: measurements of recorded epoch k (-1: none), solution, and the heading for the next tick."""
        solution = self.navigator.locate(self._measurements(n, k))
        out.position_en_m[n], out.heading_rad[n] = solution.position_en_m[0], solution.heading_rad[0]
        out.mode[n], out.pl_m[n] = solution.mode[0], (solution.pl_at_m[0], solution.pl_ct_m[0])
        out.alert[n], out.available[n] = solution.alert[0], solution.available[0]
        if self.steered and solution.since_rtk_s[0] <= self.config.dt_s:  # a position found here, not moved here
            self.begun_s = min(self.begun_s, out.time_s[n])
        if self.epochs.odometry is not None and k >= 0:
            self._steer(n, k)

    def _steer(self, n: int, k: int) -> None:
        """Give the navigator the heading that fits the positions of the codes, where that is surer."""
        rough = self.epochs.rough_en_m
        assert rough is not None  # comes with the odometry
        first = int(np.searchsorted(self.epochs.time_s, self.epochs.time_s[k] - WINDOW_S))
        path = self.way[np.rint(self.epochs.time_s[first : k + 1] / self.config.dt_s).astype(np.int64)]
        if not float(np.hypot(*(path - path[0]).T).max()) > LEAST_M:
            return
        turn, spread = fit_heading(self.epochs.time_s[first : k + 1], path, rough[first : k + 1])
        sigma = max(spread, SUREST_RAD)
        own = float(np.sqrt(self.navigator.state.belief.vehicles["heading"]["p_hh"][0]))
        if sigma < min(own, KNOWN_RAD):
            self.navigator.align(np.array([self.path_heading[n] + turn]), sigma)
            self.steered = True

    def _measurements(self, n: int, k: int) -> Measurements:
        """What the instruments say at tick n."""
        e, none = self.epochs, np.zeros((1, len(self.epochs.system)))
        there = self.nothing if k < 0 else e.tracked[k : k + 1]
        los = self.los if k < 0 else e.los_enu[k : k + 1]
        pair = np.zeros((*none.shape, 2))
        code, phase = pair.copy(), pair.copy()
        if k >= 0:
            code[0, :, 0], phase[0, :, 0] = e.code_m[k], e.phase_m[k]
        gnss = GnssEpoch(
            tracked=np.ascontiguousarray(there), code_m=pair, phase_m=pair, range_rate_mps=none,
            cn0_dbhz=none if k < 0 else np.ascontiguousarray(e.cn0_dbhz[k : k + 1]),
            lock_lost=self.nothing if k < 0 else np.ascontiguousarray(e.lost[k : k + 1]),
            corrections_age_s=np.array([np.inf]), raw_code_m=code, raw_phase_m=phase,
            corrections=self._corrections(k),
        )  # fmt: skip
        elevation = np.arcsin(np.clip(los[..., 2], -1.0, 1.0))
        azimuth = np.mod(np.arctan2(los[..., 0], los[..., 1]), 2.0 * np.pi)
        sky = SkyView(
            np.ascontiguousarray(los), elevation, azimuth, none + FAR_M, none, elevation > 0.0, e.system, e.prn,
            np.zeros(1, np.int64),
        )  # fmt: skip
        speed = self.speed[n : n + 1].copy()
        turn = np.zeros((1, 3))
        turn[0, 2] = self.turn[n]
        imu, odometer = ImuSample(turn, np.zeros((1, 3))), OdometerSample(self.config.dt_s * speed, speed)
        return Measurements(n * self.config.dt_s, sky, gnss, imu, odometer)

    def _corrections(self, k: int) -> dict[str, Corrections] | None:
        """What a receiver holds of the station; None without one."""
        if self.epochs.station is None or "dgps" not in self.config.service:
            return None
        s, shape = self.epochs.station, (1, len(self.epochs.system))
        declared = self.config.gnss.augmentation.dgps.declared_m
        held = np.zeros(shape) if k < 0 else s.satellite_m[k : k + 1].copy()
        age = np.array([np.inf]) if k < 0 else s.age_s[k : k + 1].copy()
        known = np.zeros(shape[1], np.bool_) if k < 0 else s.known[k]
        found = Corrections(
            satellite_m=held, zenith_m=np.zeros(shape), declared_m=np.where(known, declared, np.inf),
            zenith_declared_m=0.0, has_zenith=True, age_s=age, zenith_age_s=age,
        )  # fmt: skip
        return {"dgps": found}


SMARTLOC_DT_S = 0.1  # its epochs are 0.2 and 0.3 s apart
HEAD = (
    "time_s", "mode", "status", "east_m", "north_m", "heading_rad", "pl_at_m", "pl_ct_m", "alert", "error_e_m",
    "error_n_m",
)  # fmt: skip
LEVEL, NO_LEVEL, NO_POSITION = "level", "no level", "no position"
CAUTION = (
    "epochs of one drive are not independent: adjacent epochs share satellites and reflections. The exact intervals "
    "are therefore too narrow"
)


def write_service(
    folder: Path, kind: str, names: Sequence[str], out: Path, changes: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> tuple[dict[str, Any], list[Path]]:  # fmt: skip
    """Drive a recording with services in their order of preference; writes ``service.json``, ``service.csv`` and, with
    a known truth, ``series.png`` into ``out``.

    Parameters
    ----------
    kind : of the recording, as :func:`~.datasets.kind_of` finds it
    changes : overrides of the navigator's configuration

    Raises
    ------
    ConfigError
        A service needs what the recording does not hold, or a change is invalid.
    InputError
        The recording cannot be used for services.
    """
    epochs, dt_s, stopped = read_service_epochs(folder, kind, names)
    config = config_of(epochs, names, dt_s, changes)
    drive = drive_service(epochs, config, progress)
    summary = {
        "dataset": "service", "recording": kind, "service": list(config.service), "stopped": stopped,
        **summarise_service(drive),
    }  # fmt: skip
    written = [out / "service.json", out / "service.csv"]
    write_summary(written[0], summary)
    _write_rows(drive, written[1])
    if drive.judged.any():
        limits = config.alert.limits
        figure = series_figure(
            drive.record(), risk=config.risk.integrity_risk, al_at_m=limits.al_at_m, al_ct_m=limits.al_ct_m
        )
        written.append(save(figure, out / "series.png"))
    return summary, written


def read_service_epochs(
    folder: Path, kind: str, names: Sequence[str]
) -> tuple[ServiceEpochs, float, dict[str, str] | None]:
    """The epochs of a recording, the time between ticks of a navigator [s], and which files end early.

    Raises
    ------
    ConfigError, InputError
        As :func:`write_service`.
    """
    if kind == "comma2k19":
        raise InputError(
            f"--service needs satellite positions, which the pseudoranges in {folder} come without: take a smartLoc "
            "drive or RINEX files with their navigation"
        )
    if kind == "smartloc":
        require_possible(names, False, "a smartLoc drive")
        drive = read_city(folder)
        return epochs_of_drive(drive), SMARTLOC_DT_S, drive.notes or None
    return _rinex_epochs(folder, names)


def _rinex_epochs(folder: Path, names: Sequence[str]) -> tuple[ServiceEpochs, float, dict[str, str] | None]:
    """One receiver alone, or the rover of a pair; the truth is its given position, else fixed RTK positions."""
    alone = len(observation_files(folder)) == 1
    require_possible(names, not alone, "this recording")
    rover_file, base_file, navigation = (
        (observation_files(folder)[0], None, navigation_files(folder)) if alone else find_pair(folder).paths
    )
    rover, base = read_observations(rover_file), None if base_file is None else read_observations(base_file)
    table, ionosphere = Ephemerides.merged([read_navigation(path) for path in navigation]), read_klobuchar(navigation)
    if ionosphere is None:
        raise InputError(
            f"a navigation file in {folder} must have the ionospheric figures GPSA and GPSB in its header, none has: "
            "services on one band need them; download the navigation of the day with its header"
        )
    places = {name: folder / f"{name}_position.txt" for name in ("rover", "base")}
    given = {name: read_coordinates(str(path)) if path.is_file() else None for name, path in places.items()}
    truth, station = None, None
    if base is not None:
        place = base.header.antenna_ecef_m if given["base"] is None else given["base"]
        if place is not None:
            require_one_site(base, given["base"] is not None)
            station = base, place
    if given["rover"] is not None:
        truth = dict.fromkeys(range(rover.epochs), given["rover"]), "given position of the rover"
    elif base is not None:
        solved = solve_baseline(rover, base, table, None if station is None else station[1])
        tow = {round(t, 3): k for k, t in enumerate(rover.tow_s.tolist())}
        found = {tow[round(float(solved.tow_s[k]), 3)]: solved.ecef_m[k] for k in np.flatnonzero(solved.fixed)}
        truth = found, "fixed RTK positions of the pair"
    notes = {"rover": rover.note, "base": "" if base is None else base.note, "navigation": table.stopped}
    epochs = epochs_of_receiver(rover, table, ionosphere, station, truth)
    dt_s = round(float(np.median(np.diff(epochs.time_s))), 3) if rover.epochs > 1 else 1.0
    return epochs, dt_s, {name: note for name, note in notes.items() if note} or None


def summarise_service(drive: ServiceDrive) -> dict[str, Any]:
    """Statistics of a drive as JSON data: errors, levels and shares of the epochs that are judged.

    ``no_level`` and ``modes`` are of all recorded epochs, exceedances of those that have levels.
    """
    epochs, keep = drive.epochs, drive.judged
    there = drive.epoch >= 0
    status = [status_of(drive, int(n)) for n in np.flatnonzero(there)]
    found: dict[str, Any] = {
        "risk": drive.config.risk.integrity_risk, "reference": epochs.reference, "epochs": int(there.sum()),
        "judged": int(keep.sum()), "begun_s": drive.begun_s if np.isfinite(drive.begun_s) else None,
        "no_level": 1.0 - status.count(LEVEL) / len(status), "no_position": status.count(NO_POSITION) / len(status),
        "modes": {m.key: int((drive.mode[there] == int(m)).sum()) for m in Mode if (drive.mode[there] == int(m)).any()},
    }  # fmt: skip
    if not keep.any():
        return found
    record, errors = drive.record(), np.hypot(*drive.errors_en_m().T)
    service = np.array([Mode(int(m)).is_service for m in record.mode])
    figures: dict[str, Any] = {
        "horizontal": _quantiles(errors),
        "horizontal_of_service": _quantiles(errors[service]) if service.any() else None,
        "available": float(record.available.mean()),
        "alert": float(record.alert.mean()),
        "caution": CAUTION,
    }
    level = np.isfinite(record.pl("at") + record.pl("ct"))
    if level.any():  # without one there is nothing to exceed
        error, pl = record.by_epoch()
        figures["doubt"] = doubt(drive.config.risk.integrity_risk, error[level], pl[level], "epochs")
        figures |= bounding_by_axis(error[level], pl[level])
    return found | figures


def status_of(drive: ServiceDrive, n: int) -> str:
    """Whether tick n has a position with a level, one without, or none."""
    if drive.mode[n] == Mode.NONE:
        return NO_POSITION
    return LEVEL if np.isfinite(drive.pl_m[n]).all() else NO_LEVEL


def _quantiles(error_m: Array) -> dict[str, float]:
    """Median, 95 % and largest of errors (N,) [m]."""
    median, most = np.quantile(error_m, [0.5, 0.95])
    return {
        "epochs": int(error_m.size), "median_m": float(median), "p95_m": float(most), "max_m": float(error_m.max())
    }  # fmt: skip


def _write_rows(drive: ServiceDrive, path: Path) -> None:
    """One row for each recorded epoch; empty cells for what is not known."""
    judged = drive.judged
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEAD)
        for n in np.flatnonzero(drive.epoch >= 0):
            there, levels = drive.mode[n] != Mode.NONE, drive.pl_m[n]
            error = drive.position_en_m[n] - drive.epochs.truth_enu_m[drive.epoch[n], :2]
            writer.writerow([
                f"{drive.time_s[n]:.3f}", Mode(int(drive.mode[n])).key, status_of(drive, int(n)),
                *(f"{v:.3f}" if there else "" for v in drive.position_en_m[n]), f"{drive.heading_rad[n]:.5f}",
                *(f"{v:.3f}" if np.isfinite(v) else "" for v in levels), int(drive.alert[n]),
                *(f"{v:.3f}" if judged[n] else "" for v in error),
            ])  # fmt: skip
