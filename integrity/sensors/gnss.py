"""Model of a GNSS receiver with a reference station: measurements of each epoch.

Multipath by near objects is an option of the signal model. Its figures are fitted on the first half of a recorded car
(``rtk_cssrlib_4p7km_doy265``: a car on loops of 100 m in an open place, 5.5 m/s in the median, 1 Hz), on what its
carriers and codes leave at the fixed position above 20 degrees, less the mean of each satellite:
docs/results/signals.md.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from scipy.special import ndtri

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.core.streams import Streams
from lanebound.integrity.motion.truth import Truth
from lanebound.integrity.sensors import gnss_kernel as gk
from lanebound.integrity.sensors.arrival_kernel import NOTHING, PATH_RULES
from lanebound.integrity.sensors.augmentation import AugmentationConfig, AugmentationHeld, Corrections, initial_held
from lanebound.integrity.sensors.broadcast import BroadcastConfig, BroadcastState
from lanebound.integrity.sensors.clock import OCXO_H0, OCXO_HM2, TCXO_H0, TCXO_HM2, clock_gains
from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.near_objects_kernel import NEAR, NEAR_RULES
from lanebound.integrity.sensors.observed_kernel import OBSERVED_SIGNAL, OBSERVED_VEHICLE
from lanebound.integrity.sky.scene import material_table, permittivities
from lanebound.integrity.sky.systems import CHIP_M, N_SYSTEMS, SPEED_OF_LIGHT_MPS, WAVELENGTH_M
from lanebound.integrity.sky.view import SkyView
from lanebound.integrity.sky.visibility import RAY_HZ, Reception

__all__ = [
    "AreaSignals",
    "GnssConfig",
    "GnssEpoch",
    "GnssState",
    "NearObjectsConfig",
    "ReflectionDetectorConfig",
    "initial_state",
    "near_rules",
    "observe",
    "undifferenced",
]


class NearObjectsConfig(Config):
    """Multipath of a vehicle's surroundings, for each satellite and band, on top of that of the receiver."""

    kind: Literal["none", "vehicle"] = Field("none", description="none, or the roof of a car and what is beside it")
    phase_m: float = Field(
        0.0029,
        ge=0,
        le=0.02,
        description="carrier, zenith, 1 sigma [m]; a recorded car's 3.5 mm less phase_multipath_m; Joerger and Pervan "
        "2016: 5 mm",
    )
    code_m: float = Field(
        0.09,
        ge=0,
        le=5,
        description="code, zenith, 1 sigma [m]; its 0.175 m less code_multipath_m; Joerger and Pervan 2016: 0.5 m",
    )
    phase_length_m: float = Field(14.0, gt=0, description="path in which the carrier's decays to 1/e [m]; that car")
    code_length_m: float = Field(21.0, gt=0, description="path in which the code's decays to 1/e [m]; that car")
    phase_tau_s: float = Field(100.0, gt=0, description="correlation time of the carrier's at rest [s]; that car")
    code_tau_s: float = Field(25.0, gt=0, description="correlation time of the code's at rest [s]; that car")

    @property
    def fitted(self) -> bool:
        """Whether there are near objects."""
        return self.kind != "none"


class ReflectionDetectorConfig(Config):
    """A detector that flags signals whose direct path is blocked (S3 Table II), and what the receiver does with them.

    Each signal has a verdict, right with the rates of the kind or by its test (``TESTS``). It lasts ``lasting_s`` on
    average and at most until the tracked path changes from direct to reflected or back: a mistake is no white noise.
    That of ``code_doppler`` is made anew in each epoch, from code and range rate alone.
    """

    kind: Literal["none", "fisheye", "dual_polarisation", "antenna_array", "two_band_cn0", "code_doppler", "given"] = (
        Field(
            "none",
            description="none; a camera of the sky; an antenna for both polarisations; an array, by angle of arrival; "
            "difference of C/N0 between bands; codes that become later than Doppler says; given: by the rates below",
        )
    )
    finds: float | None = Field(None, ge=0, le=1, description="share of reflected signals that are flagged, of given")
    mistakes: float | None = Field(None, ge=0, le=1, description="share of direct signals that are flagged, of given")
    lasting_s: float = Field(2.0, gt=0, description="mean time of a verdict [s]; chosen: metres of driving")
    use: Literal["exclude", "flag"] = Field(
        "exclude",
        description="exclude: the receiver leaves flagged signals out; flag: monitors that use a map read the flags",
    )

    @model_validator(mode="after")
    def _rates_are_given(self) -> Self:
        for name in ("finds", "mistakes"):
            if (getattr(self, name) is None) == (self.kind == "given"):
                wanted = "be a share" if self.kind == "given" else "be left out"
                raise ConfigError(
                    f"{name} must {wanted} for kind {self.kind!r}, got {getattr(self, name)}: kind 'given' takes both"
                )
        return self

    @property
    def rates(self) -> tuple[float, float]:
        """Shares of reflected and of direct signals that are flagged."""
        if self.kind == "given":
            return float(self.finds or 0.0), float(self.mistakes or 0.0)
        return RATES.get(self.kind, (0.0, 0.0))


RATES = {
    "none": (0.0, 0.0),
    # Neural networks segment fisheye images of the sky with a pixel F1 above 99 % (thesis, core.ac.uk/works/150454516).
    "fisheye": (0.99, 0.01),
    # A reflection is flagged where its left-handed part is the stronger one (Jiang and Groves 2014). By the Fresnel
    # coefficients of concrete that is so for 0.61 of the directions between 15 and 70 degrees before a facade
    # (ITU-R P.2040); mistakes are chosen.
    "dual_polarisation": (0.61, 0.01),
}
"""Shares of reflected and of direct signals that a kind of detector flags."""


class _Test(NamedTuple):
    """A code of :mod:`.gnss_kernel`, the error of what is tested (1 sigma), and the threshold over it."""

    code: int
    sigma: float
    limit: float


TESTS = {
    # Direction of arrival against the ephemeris. A calibrated array of four patches; mutual coupling and attitude leave
    # some degrees, chosen. Two-sided, false alarms 0.01 of the verdicts.
    "antenna_array": _Test(gk.BY_ANGLE, math.radians(5.0), -float(ndtri(0.005))),
    # Strode and Groves 2016: two paths interfere differently in each band. Receivers show C/N0 in steps of 1 dB, and
    # the calibration of both bands leaves as much, chosen. Two-sided, false alarms 0.01 of the verdicts.
    "two_band_cn0": _Test(gk.BY_SPLIT, 1.0, -float(ndtri(0.005))),
    # One-sided, false alarms at most 1e-3 of the epochs of a direct signal; sigma is that of late_sigma_m.
    "code_doppler": _Test(gk.BY_JUMP, math.nan, -float(ndtri(1e-3))),
}
"""Kinds that test what they measure, in place of rates."""


def near_rules(config: NearObjectsConfig, dt_s: float) -> Records:
    """The figures as the kernel takes them, (1,) of NEAR_RULES."""
    return one_record(
        NEAR_RULES,
        fitted=config.fitted,
        dt=dt_s,
        code=config.code_m,
        phase=config.phase_m,
        code_rest=math.exp(-dt_s / config.code_tau_s),
        phase_rest=math.exp(-dt_s / config.phase_tau_s),
        code_per_m=1.0 / config.code_length_m,
        phase_per_m=1.0 / config.phase_length_m,
    )


Array = NDArray[np.float64]
MOST_AGE_S = 1e6  # older corrections do not age a signal further


@dataclass(frozen=True)
class GnssEpoch:
    """Output of a receiver at one epoch; all entries are finite, those of untracked signals are 0.

    ``x`` is the ENU position of the rover relative to the origin of the street, ``e`` the unit vector to the satellite:
    ``code = -e.x + clk[sys, band] + errors``, ``phase = -e.x + clk'[sys, band] + lambda N + errors``,
    ``range_rate = -e.v + drift + errors``.

    Attributes
    ----------
    tracked : (B, S) bool, the code is tracked
    code_m, phase_m : (B, S, 2) rover minus reference single differences by band; a band without tracking is 0, and a
        phase without carrier lock is 0
    range_rate_mps : (B, S) Doppler without the motion of the satellite
    cn0_dbhz : (B, S) carrier-to-noise density
    lock_lost : (B, S) bool, the receiver detected a loss of carrier lock since the previous epoch
    corrections_age_s : (B,) age of the reference data, inf without data
    raw_code_m, raw_phase_m : (B, S, 2) undifferenced, corrected by broadcast ephemerides and models
        (:mod:`.broadcast`): ``-e.x`` relative to the true origin, receiver clock, errors; None unless
        ``gnss.undifferenced``. ``range_rate_mps`` is undifferenced in any case.
    integer_error : (B, S, 2) cycles by which a fault makes the integers wrong that positioning fixes; None: no faults
    next_best : (B, 2) rank of the wrong integers that it accepts instead, and their azimuth
        (:class:`.effects.FaultEffects`); None: no faults
    corrections : what the receiver holds of each provider of ``gnss.augmentation.providers``, by name
    reflected : (B, S) bool, a detector flags the signal as reflected (``gnss.reflection_detector``); None: unknown
    """

    tracked: NDArray[np.bool_]
    code_m: Array
    phase_m: Array
    range_rate_mps: Array
    cn0_dbhz: Array
    lock_lost: NDArray[np.bool_]
    corrections_age_s: Array
    raw_code_m: Array | None = None
    raw_phase_m: Array | None = None
    integer_error: NDArray[np.int64] | None = None
    next_best: Array | None = None
    corrections: Mapping[str, Corrections] | None = None
    reflected: NDArray[np.bool_] | None = None


@dataclass
class AreaSignals:
    """Errors common to all receivers of an area; A is 1, or the number of vehicles if each has its own area.

    memory (A, S) of SLOW (:mod:`.gnss_kernel`), message (A, S) of STATION, the station's newest message, site (A,) of
    SITE, its clock and the error of its coordinates.
    """

    memory: Records
    message: Records
    site: Records


class GnssConfig(Config):
    """True properties of the receiver and its signals (the positioning configuration has separate assumed bounds).

    Values described as differenced are for rover minus station. The station contributes the ``station_`` values, but at
    most half of the variance, which is the share of two equal receivers as assumed by RTKLIB (``varerr`` in rtkpos.c
    doubles the variance of one receiver). The part of the station depends only on the elevation, because the station
    has an open sky. The rover contributes the rest of the stated variance.
    """

    bands: tuple[Literal[0, 1, 2], ...] = Field(
        (0, 1), min_length=1, max_length=2, description="bands tracked: L1, L2, L5"
    )
    cn0_zenith_dbhz: float = Field(48.0, description="C/N0 at the zenith in the open [dB-Hz]; patch antenna")
    cn0_horizon_dbhz: float = Field(38.0, description="C/N0 at the horizon in the open [dB-Hz]")
    cn0_sigma_db: float = Field(1.0, ge=0, description="slow fading, 1 sigma [dB]; doubled and more below trees")
    cn0_tau_s: float = Field(2.0, gt=0, description="correlation time of fading [s]; metres of driving")
    foliage_loss_db: float = Field(8.0, ge=0, description="mean loss of a tree [dB]; roadside fades of 6 to 10 dB")
    reflection_loss_db: float = Field(
        12.4, ge=0, description="mean loss of a reflection [dB]; Berlin, 43.8 against 31.4"
    )
    track_min_dbhz: float = Field(22.0, ge=0, description="code tracking threshold [dB-Hz]")
    phase_min_dbhz: float = Field(32.0, ge=0, description="carrier tracking threshold [dB-Hz]")
    correlator_chips: float = Field(
        0.1, gt=0, le=1, description="spacing of early and late correlator [chips]; narrow correlator, van Dierendonck"
    )
    code_loop_hz: float = Field(1.0, gt=0, description="bandwidth of the carrier-aided code loop [Hz]")
    carrier_loop_hz: float = Field(15.0, gt=0, description="bandwidth of the carrier loop [Hz]; Kaplan: 10 to 18 Hz")
    cn0_loop_hz: float = Field(1.0, gt=0, description="bandwidth of the C/N0 estimate [Hz]")
    lock_window_s: float = Field(
        0.1,
        ge=0.02,
        description="time constant of the lock detector of the carrier [s]; chosen: receivers publish none, software "
        "receivers have 0.02 to 0.5 s",
    )
    cross_polar: float = Field(
        0.4, ge=0, le=1, description="voltage response to left-handed signals over right-handed [-]; patch, 8 dB"
    )
    keep_lock: float = Field(
        0.5,
        ge=0,
        le=1,
        description="probability that the carrier loop keeps lock, unnoticed, when another arrival becomes stronger "
        "[-]; chosen: no published figure is known",
    )
    code_delay_s: float = Field(0.2, ge=0, description="time to reacquire the code [s]")
    phase_delay_s: float = Field(1.0, ge=0, description="time to reacquire the carrier [s]")
    code_sigma_m: float = Field(0.15, ge=0, description="white code noise, zenith, one band, differenced [m]")
    phase_sigma_m: float = Field(0.003, ge=0, description="white phase noise, zenith, one band, differenced [m]")
    range_rate_sigma_mps: float = Field(0.08, ge=0, description="range-rate error, zenith [m/s]; S1: 10 cm/s of speed")
    range_rate_tau_s: float = Field(0.54, gt=0, description="correlation time of the range-rate error [s]")
    code_multipath_m: float = Field(0.15, ge=0, description="code multipath in line of sight, zenith, 1 sigma [m]")
    phase_multipath_m: float = Field(0.002, ge=0, description="phase multipath, zenith, 1 sigma [m]")
    multipath_tau_s: float = Field(3.0, gt=0, description="correlation time of multipath [s]; metres of driving")
    multipath_per_m: float = Field(
        0.0,
        ge=0,
        description="faster decay in motion: this value times the speed is added to 1/tau [1/m]; 0.1: facades of 10 m",
    )
    station_code_m: float = Field(
        0.1, ge=0, description="the station's part of code_sigma_m [m]; chosen: a survey receiver"
    )
    station_phase_m: float = Field(0.002, ge=0, description="the station's part of phase_sigma_m [m]; chosen as well")
    station_code_multipath_m: float = Field(
        0.1, ge=0, description="the station's part of code_multipath_m [m]; chosen: survey antenna on a roof"
    )
    station_phase_multipath_m: float = Field(
        0.001, ge=0, description="the station's part of phase_multipath_m [m]; chosen as well"
    )
    station_multipath_tau_s: float = Field(
        120.0, gt=0, description="correlation time of station multipath [s]; chosen: only satellites move"
    )
    baseline_km: float = Field(3.0, ge=0, description="distance to the reference station [km]; S1: a few kilometres")
    iono_ppm: float = Field(
        0.5, ge=0, description="differential ionosphere, 1 sigma [mm/km]; quiet days at mid-latitudes"
    )
    iono_tau_s: float = Field(600.0, gt=0, description="correlation time of the ionosphere [s]")
    tropo_ppm: float = Field(
        0.4,
        ge=0,
        description="differential troposphere at the zenith after a model, 1 sigma [mm/km]; equal heights, up to 1 ppm",
    )
    tropo_tau_s: float = Field(
        1800.0, gt=0, description="correlation time of the troposphere [s]; 900-2700 s, Joerger and Pervan 2016"
    )
    orbit_ppm: float = Field(
        0.05, ge=0, description="broadcast orbits, differenced [mm/km]; 1 m error over 20,000 km of range"
    )
    age_rate_mps: float = Field(
        0.0015, ge=0, description="growth of a satellite's error with the age [m/s]; 5e-12 s/s clocks"
    )
    age_tau_s: float = Field(300.0, gt=0, description="correlation time of age_rate_mps [s]")
    slips_per_h: float = Field(0.5, ge=0, description="slips of one satellite at 40 dB-Hz [1/h]")
    slip_decade_db: float = Field(5.0, gt=0, description="loss of C/N0 that makes slips ten times as frequent [dB]")
    unannounced: float = Field(0.1, ge=0, le=1, description="share of slips that the receiver does not detect [-]")
    half_share: float = Field(0.2, ge=0, le=1, description="share of half-cycle slips [-]")
    half_cycle_resolve_s: float = Field(
        6.0,
        ge=0,
        description="time until a half cycle is corrected [s]; one subframe, whose preamble gives the sign, IS-GPS-200",
    )
    clock_m: float = Field(100.0, ge=0, description="delays of each system, band and observable, 1 sigma [m]")
    drift_mps: float = Field(
        100.0,
        ge=0,
        description="receiver clock drift at the start, 1 sigma [m/s]; 0.3 ppm; a TCXO is within 0.5 to 2 ppm",
    )
    clock_h0: float = Field(TCXO_H0, ge=0, description="white frequency noise of the receiver's clock [s]; TCXO")
    clock_hm2: float = Field(TCXO_HM2, ge=0, description="frequency random walk of its clock, h-2 [Hz]; TCXO")
    station_clock_h0: float = Field(OCXO_H0, ge=0, description="white frequency noise of the station's clock [s]; OCXO")
    station_clock_hm2: float = Field(OCXO_HM2, ge=0, description="frequency random walk of its clock, h-2 [Hz]; OCXO")
    reference_offset_m: float = Field(
        0.0,
        ge=0,
        description="horizontal error of the reference coordinates, in a random direction [m]; datum, antenna",
    )

    undifferenced: bool = Field(
        False, description="compute undifferenced observables too, for services without a station"
    )
    broadcast: BroadcastConfig = Field(BroadcastConfig(), description="their errors after broadcast corrections")
    augmentation: AugmentationConfig = Field(AugmentationConfig(), description="providers of corrections for services")
    near_objects: NearObjectsConfig = Field(
        NearObjectsConfig(), description="multipath of the vehicle's roof and what is beside it"
    )
    reflection_detector: ReflectionDetectorConfig = Field(
        ReflectionDetectorConfig(), description="flags signals that arrive by reflection alone; none by default"
    )

    @field_validator("bands")
    @classmethod
    def _bands_differ(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(value)) < len(value):
            raise ValueError(f"bands must differ, got {list(value)}: name each one once")
        return value

    @property
    def late_sigma_m(self) -> float:
        """Deviation of a code less its sum of range rates from the mean over LATE_FORGET_S, zenith [m].

        White noise counts once, as the mean has little of it; multipath twice, as it may have turned since. Errors of
        range rates add up while the mean lasts, ``sigma^2 tau T`` of a Gauss-Markov process, and the white frequency
        noise of both clocks, ``c^2 h0 T / 4``.
        """
        summed = self.range_rate_sigma_mps**2 * self.range_rate_tau_s * gk.LATE_FORGET_S
        summed += SPEED_OF_LIGHT_MPS**2 * (self.clock_h0 + self.station_clock_h0) * gk.LATE_FORGET_S / 4.0
        return math.sqrt(self.code_sigma_m**2 + 2.0 * self.code_multipath_m**2 + summed)

    @model_validator(mode="after")
    def _detector_has_its_bands(self) -> Self:
        kind = self.reflection_detector.kind
        if kind == "two_band_cn0" and len(self.bands) < gk.BANDS:
            raise ConfigError(
                f"reflection_detector.kind must not be {kind!r} with one band, got bands {list(self.bands)}: add a band"
            )
        return self

    @property
    def station_parts(self) -> dict[str, float]:
        """1-sigma of the station's part of code, phase and their multipath [m], by field of GNSS_RULES."""
        half = math.sqrt(0.5)
        return {
            "station_code": min(self.station_code_m, half * self.code_sigma_m),
            "station_phase": min(self.station_phase_m, half * self.phase_sigma_m),
            "station_code_multipath": min(self.station_code_multipath_m, half * self.code_multipath_m),
            "station_phase_multipath": min(self.station_phase_multipath_m, half * self.phase_multipath_m),
        }


@lru_cache(maxsize=64)
def gnss_parameters(config: GnssConfig, dt_s: float) -> Records:
    """The figures of the receiver as the kernel takes them, (1,) of GNSS_RULES."""
    c, slip_cn0, slip_rate = config, 40.0, config.slips_per_h / 3600.0
    clock_11, clock_21, clock_22 = clock_gains(c.clock_h0, c.clock_hm2, dt_s)
    bands, test = len(c.bands), TESTS.get(c.reflection_detector.kind)
    wavelength, dispersion, chip = np.zeros((3, N_SYSTEMS, gk.BANDS))
    chip[:, :bands] = CHIP_M[:, list(c.bands)]
    wavelength[:, :bands] = WAVELENGTH_M[:, list(c.bands)]
    dispersion[:, :bands] = (wavelength[:, :bands] / wavelength[:, :1]) ** 2
    return one_record(
        gk.GNSS_RULES,
        dt=dt_s,
        bands=bands,
        cn0_zenith=c.cn0_zenith_dbhz,
        cn0_horizon=c.cn0_horizon_dbhz,
        cn0_sigma=c.cn0_sigma_db,
        cn0_decay=np.exp(-dt_s / c.cn0_tau_s),
        cn0_gain=np.sqrt(-np.expm1(-2.0 * dt_s / c.cn0_tau_s)),
        track_min=c.track_min_dbhz,
        least_snr=gk.COHERENT_S * math.exp(gk.LN10 * 0.1 * c.phase_min_dbhz),
        lock_intervals=c.lock_window_s / gk.COHERENT_S,
        code_delay=c.code_delay_s - 1e-9,
        phase_delay=c.phase_delay_s - 1e-9,
        code_sigma=c.code_sigma_m,
        phase_sigma=c.phase_sigma_m,
        rate_sigma=c.range_rate_sigma_mps,
        rate_decay=np.exp(-dt_s / c.range_rate_tau_s),
        rate_gain=np.sqrt(-np.expm1(-2.0 * dt_s / c.range_rate_tau_s)),
        code_multipath=c.code_multipath_m,
        phase_multipath=c.phase_multipath_m,
        multipath_decay=np.exp(-dt_s / c.multipath_tau_s),
        multipath_per_m=c.multipath_per_m,
        iono_sigma=1e-3 * c.iono_ppm * c.baseline_km,
        age_rate=c.age_rate_mps,
        tropo_sigma=1e-3 * c.tropo_ppm * c.baseline_km,
        orbit_sigma=1e-3 * c.orbit_ppm * c.baseline_km,
        slip_rate=slip_rate,
        slip_cn0=slip_cn0,
        slip_decade=c.slip_decade_db,
        unannounced=c.unannounced,
        half_share=c.half_share,
        half_resolve=c.half_cycle_resolve_s + 1e-9,
        clock_11=clock_11,
        clock_21=clock_21,
        clock_22=clock_22,
        wavelength=wavelength,
        dispersion=dispersion,
        chip=chip,
        paths=_path_parameters(c, dt_s),
        near=near_rules(c.near_objects, dt_s),
        detects=test.code if test else gk.BY_RATES if c.reflection_detector.kind != "none" else gk.NEVER,
        excludes=c.reflection_detector.use == "exclude",
        finds=c.reflection_detector.rates[0],
        mistakes=c.reflection_detector.rates[1],
        detector_sigma=0.0 if test is None else c.late_sigma_m if test.code == gk.BY_JUMP else test.sigma,
        detector_limit=test.limit if test else 0.0,
        renews=-math.expm1(-dt_s / c.reflection_detector.lasting_s),
        **c.station_parts,
    )


def _path_parameters(c: GnssConfig, dt_s: float) -> Records:
    """Figures of propagation and loops, (1,) of PATH_RULES."""
    materials = material_table()
    return one_record(
        PATH_RULES,
        permittivity=permittivities(materials, RAY_HZ),
        roughness=materials["roughness_m"],
        cross_polar=c.cross_polar,
        reflection_loss=c.reflection_loss_db,
        foliage_loss=c.foliage_loss_db,
        spacing=c.correlator_chips,
        code_loop=c.code_loop_hz,
        carrier_loop=c.carrier_loop_hz,
        fade_gain=-np.expm1(-2.0 * np.pi * c.cn0_loop_hz * dt_s),
        lock_gain=-np.expm1(-dt_s / c.lock_window_s),
        keep_lock=c.keep_lock,
    )


@dataclass
class GnssState:
    """True state of the signals between epochs, which positioning must not use.

    signals (B, S) of SIGNAL and vehicles (B,) of RECEIVER (:mod:`.gnss_kernel`); augmentation: messages of providers
    that are held, None without providers.
    """

    signals: Records
    vehicles: Records
    augmentation: AugmentationHeld | None = None

    def copy(self) -> GnssState:
        """An independent copy."""
        return copy.deepcopy(self)


def initial_state(config: GnssConfig, sky: SkyView, streams: Streams) -> GnssState:
    """Stationary error processes, random integers and clocks; the receiver has just been switched on."""
    n_sat = len(sky.system)
    z = streams.normal("gnss", n_sat, 5 + gk.BANDS)
    signals = np.zeros((streams.batch, n_sat), gk.SIGNAL)
    signals["cn0"], signals["code_multipath"], signals["phase_multipath"] = z[..., 0], z[..., 1], z[..., 2:4]
    signals["rate"] = z[..., 4]
    signals["ambiguity"] = 2.0 * np.floor(1000.0 * z[..., 5:])
    signals["tracked"]["arrival"] = NOTHING
    if config.near_objects.fitted:
        signals["near"] = near_draws(streams, n_sat)
    vehicles, clock = np.zeros(streams.batch, gk.RECEIVER), streams.normal("clock", N_SYSTEMS * 2 * gk.BANDS + 1)
    delays = config.clock_m * clock[:, :-1].reshape(-1, N_SYSTEMS, 2 * gk.BANDS)
    vehicles["code_delay"], vehicles["phase_delay"] = delays[..., : gk.BANDS], delays[..., gk.BANDS :]
    vehicles["drift"] = config.drift_mps * clock[:, -1]
    held = initial_held(config.augmentation, n_sat, streams.batch) if config.augmentation.providers else None
    return GnssState(signals, vehicles, held)


def observe(
    config: GnssConfig,
    state: GnssState,
    sky: SkyView,
    reception: Reception,
    truth: Truth,
    age_s: Array,
    message: Records,
    effects: FaultEffects,
    streams: Streams,
    area: AreaSignals,
) -> GnssEpoch:
    """Compute the output of the receiver at the end of the epoch; ``state`` advances in place.

    Parameters
    ----------
    reception : propagation of each signal, (B, S)
    truth : position and velocity of the antenna
    age_s : (B,) age of the reference data
    message : (B, S) of STATION, the station's own errors in these data
    area : what this epoch brings to all receivers of an area

    The number of draws from streams "gnss", "clock" and "near_objects" is fixed; it does not depend on the satellites
    in view.

    Raises
    ------
    InputError
        When truth, sky, reception, streams and area disagree on the number of vehicles or satellites.
    """
    batch, n_sat = truth.batch, len(sky.system)
    if not streams.batch == sky.batch == batch or reception.path.shape != (batch, n_sat):
        raise InputError(
            f"truth holds {batch} vehicles, sky {sky.batch}, streams {streams.batch}, "
            f"reception {reception.path.shape}: make all the same batch"
        )
    if area.memory.shape[0] not in (1, batch) or area.memory.shape[1] != n_sat:
        raise InputError(
            f"area must hold 1 or {batch} areas and {n_sat} satellites, got {area.memory.shape}: make both agree"
        )
    if message.shape != (batch, n_sat):
        raise InputError(f"message must have shape {(batch, n_sat)}, got {message.shape}: one for each vehicle")
    draws = gk.ReceiverDraws(
        streams.normal("gnss", n_sat, gk.NORMALS.itemsize // 8).view(gk.NORMALS)[..., 0],
        streams.uniform("gnss", n_sat, gk.UNIFORMS.itemsize // 8).view(gk.UNIFORMS)[..., 0],
        near_draws(streams, n_sat) if config.near_objects.fitted else np.zeros((batch, n_sat), NEAR),
        streams.normal("clock", 2),
    )
    signals, vehicles = np.empty((batch, n_sat), OBSERVED_SIGNAL), np.zeros(batch, OBSERVED_VEHICLE)
    vehicles["sight"], vehicles["age"], vehicles["next_best"] = sky.index, age_s, effects.next_best
    gk.observe(
        gnss_parameters(config, truth.dt_s), area.site, area.memory,
        gk.Receiver(state.vehicles, state.signals, message), draws, sky.rows, reception.records, truth.records,
        gk.Effects(effects.signals, effects.vehicles), gk.Sensed(signals, vehicles),
    )  # fmt: skip
    return gnss_epoch(signals, vehicles)


def undifferenced(
    config: GnssConfig,
    rules: Records,
    epoch: GnssEpoch,
    sky: SkyView,
    held: Records,
    effects: FaultEffects,
    area: AreaSignals,
    broadcast: BroadcastState,
) -> GnssEpoch:
    """Add the undifferenced observables of an epoch, for S satellites and B vehicles.

    Parameters
    ----------
    rules : of GNSS_RULES, with which the epoch was observed
    held : (B, S) of STATION, the station's own errors in the data that each vehicle holds
    area, broadcast : of one area or of B
    """
    los, batch, r = sky.los_enu[sky.index], epoch.tracked.shape[0], rules[0]
    row, sine = np.arange(batch) % area.memory.shape[0], np.where(epoch.tracked, los[..., 2], 1.0)
    alike, iono = config.broadcast.delays(broadcast, sine, row)
    offset = area.site["reference"][row] + effects.reference_enu_m
    alike += np.einsum("bsk,bk->bs", los, offset) + area.site["offset"][row, None]
    aged = np.isfinite(epoch.corrections_age_s) & (epoch.corrections_age_s < MOST_AGE_S)
    age_s = np.where(aged, epoch.corrections_age_s, 0.0)
    alike -= r["age_rate"] * age_s[:, None] * area.memory["age"][row]
    iono = iono[..., None] * r["dispersion"][sky.system]
    root = np.sqrt(0.5 * (1.0 + 1.0 / np.square(sine)))[..., None]
    of_code = r["station_code_multipath"] * held["code_multipath"][..., None] + r["station_code"] * held["code"]
    of_phase = r["station_phase_multipath"] * held["phase_multipath"] + r["station_phase"] * held["phase"]
    code = epoch.code_m + alike[..., None] + iono + root * of_code
    phase = epoch.phase_m + alike[..., None] - iono + root * of_phase
    there = epoch.tracked[..., None] & (np.arange(gk.BANDS) < r["bands"])
    return replace(epoch, raw_code_m=np.where(there, code, 0.0), raw_phase_m=np.where(epoch.phase_m != 0.0, phase, 0.0))


def near_draws(streams: Streams, satellites: int) -> Records:
    """Standard normals of near objects, (B, S) of NEAR."""
    return streams.normal("near_objects", satellites, NEAR.itemsize // 8).view(NEAR)[..., 0]


def gnss_epoch(signals: Records, vehicles: Records) -> GnssEpoch:
    """The output of receivers whose arrays are fields of (B, S) of OBSERVED_SIGNAL and (B,) of OBSERVED_VEHICLE."""
    return GnssEpoch(
        signals["tracked"], signals["code"], signals["phase"], signals["range_rate"], signals["cn0"],
        signals["lock_lost"], vehicles["age"], integer_error=signals["integer_error"], next_best=vehicles["next_best"],
        reflected=signals["reflected"],
    )  # fmt: skip
