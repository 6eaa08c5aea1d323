"""``lanebound replay``, ``rtk``, ``record-sky`` and ``fit-imu``: recorded drives, and static logs of accelerometers."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from lanebound.agents.cli.options import AsJson, Assignments, changes
from lanebound.agents.cli.output import print_json, print_table, resumable, wait_for, with_bar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lanebound.agents.checkpointing.runner import OnProgress
    from lanebound.integrity.core.progress import Progress

T = TypeVar("T")
CITY_WORDS = (
    "overbound: bounds of the errors by C/N0, fitted on the training part; danish: the same, re-weighted by the data; "
    "gaussian: the receiver's own variances, taken for noise around 0; gaussian_epoch: the same without a window. "
    "training, after: before and after the fitting ends; unshared: windows that hold no signal of training."
)
RESULTS = (".json", ".csv", ".png")
MANIFEST = ("run.json",)
HIGH_RISK = 0.01  # at which a level says little: no higher one is advised


def replay(
    dataset: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET", help="Folder: smartLoc, comma2k19, inertial log with a .pos, or a RINEX pair."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the figures and for replay.json or rtk.json.")],
    service: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME]", help="Run it through a navigator with these services: spp, dgps."),
    ] = None,
    navigator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A filter on vehicle models in place of the method of the data set: filter, or a preset as imm_s4.",
        ),
    ] = None,
    context: Annotated[
        Path | None,
        typer.Option(metavar="MAP.geojson", help="Judge position, speed and road on this map by the context monitor."),
    ] = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Replay a recorded drive: positions, protection levels, exclusions and alerts against the truth.

    smartLoc: a city by code, wheel speed and yaw rate. comma2k19: dead reckoning in artificial outages.
    NAME.csv of an IMU with NAME.csv.tag, which counts its bytes, and one .pos of RTKLIB with velocities (rows of Q 1
    and 2; llh, xyz or enu; GPST, UTC or JST): the same by gyros and accelerometers. A RINEX pair: RTK. Its files are
    distinguished by their names (rover, base) or by which receiver moves. docs/navigation.md says where to get the
    recordings.

    With --service the drive runs through the navigator of simulated drives: spp on smartLoc and RINEX, dgps with the
    base of a RINEX pair; others need corrections that no recording holds. --set then changes the navigator, such as
    services.spp.smoothing_s=100.

    With --context the context monitor judges the drive on a road map in GeoJSON, such as an export of OpenStreetMap; a
    phase that the recording does not allow is skipped, and named. --set then changes the monitor, such as
    matching.kind=hidden_markov or map_errors.missing=0.1.

    Keys for --set, of smartLoc: every, first, training_share, solution.*, alerts.*; of comma2k19: every_s, longest_s,
    heading_error_deg, bridge.*; of an inertial log: longest_s, every_s, rest_s, calibration_s, settle_s,
    acceleration_bias_mps2, pitch_drift_degps, bridge.*; of RINEX: static, bands, ionosphere_ppm, troposphere_ppm,
    rtk.*, fde.*, risk.*; with --navigator: navigator.*, fix_slow_m, fix_fast_m, wheel_scale.

    Example: lanebound replay data/smartloc_berlin_potsdamer --out out/berlin
    """
    _limit_blas_threads()
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.replay.datasets import kind_of, replay_folder

    methods = {"--service": service, "--navigator": navigator, "--context": context}
    given = [f"{option} {value}" for option, value in methods.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"one of {', '.join(methods)} may be given, got {' and '.join(given)}: leave out the others")
    names = [name.strip() for name in service.split(",")] if service is not None else []
    kind = "RTK solution" if kind_of(dataset) == "rinex" else "replayed drive"
    kind = "context monitor" if context else "drive on a service" if names else kind
    found, written = _solve(
        out, kind, lambda report: replay_folder(dataset, out, changes(assignments), report, names, navigator, context)
    )
    if as_json:
        print_json(found)
        return
    _PRINTERS[found["dataset"]](found)
    _print_files(found.get("stopped"), written, found.get("doubt"))


def rtk(
    rover: Annotated[
        Path, typer.Option(metavar="FILE.obs", help="RINEX 2, 3 or 4 observations of the rover, plain or gzip.")
    ],
    base: Annotated[Path, typer.Option(metavar="FILE.obs", help="RINEX 2, 3 or 4 observations of the base.")],
    nav: Annotated[
        list[Path],
        typer.Option(metavar="FILE.nav", help="RINEX 2, 3 or 4 navigation messages; several files are merged."),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for solution.csv and rtk.json.")],
    base_position: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Antenna of the base in m, or LAT,LON,H in deg and m, or a file of them; by default marker and "
            "ANTENNA: DELTA H/E/N of its header.",
        ),
    ] = None,
    rover_position: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="True antenna of a rover that stands, to count errors.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="True positions of a rover that moves: a table with columns 'GPS TOW (s)', 'ECEF X (m)', "
            "'ECEF Y (m)', 'ECEF Z (m)'.",
        ),
    ] = None,
    static: Annotated[
        bool, typer.Option("--static", help="The rover stands: one position for all epochs helps to find integers.")
    ] = False,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """RTK of any two receivers, static or moving: fixed positions with protection levels, epoch by epoch.

    Positions are the rover's antenna reference point; its header's ANTENNA: DELTA H/E/N leads there from its marker.

    Example: lanebound rtk --rover rover.obs --base base.obs --nav base.nav --out out/rtk
    """
    _limit_blas_threads()
    from lanebound.integrity.core.errors import InputError
    from lanebound.integrity.replay.baseline import BaselineConfig
    from lanebound.integrity.replay.baseline_report import read_coordinates, run_baseline

    files = ("--rover", rover), ("--base", base), *(("--nav", path) for path in nav), ("--truth", truth)
    for option, path in files:
        if path is not None and not path.is_file():
            raise InputError(f"{option} must be a file that exists, got {path}: correct the path")
    config = BaselineConfig.build(None, changes(assignments, static=static or None))
    at_base, at_rover = (None if text is None else read_coordinates(text) for text in (base_position, rover_position))
    found, written = _solve(
        out,
        "RTK solution",
        lambda report: run_baseline(
            rover,
            base,
            nav,
            out,
            base_ecef_m=at_base,
            rover_ecef_m=at_rover,
            truth=truth,
            config=config,
            progress=report,
        ),
    )
    if as_json:
        print_json(found)
        return
    print_rtk(found)
    _print_files(found["stopped"], written, found.get("doubt"))


def _solve(out: Path, kind: str, work: Callable[[Progress], T]) -> T:
    """The result of ``work``, which writes into a folder of its kind and reports the epochs that are solved."""
    from lanebound.agents.checkpointing.folder import ResultFolder

    start = time.time()
    ResultFolder(out, kind).claim()
    with resumable(lambda: _written_text(out, start)):
        return with_bar("epochs", lambda on_progress: work(_epochs(on_progress)))


def _written_text(out: Path, start_s: float) -> str:
    """Which results an interrupted run has already written into its folder since ``start_s`` [s of the clock]."""
    files = [path for path in sorted(out.glob("*.*")) if path.suffix in RESULTS and path.name not in MANIFEST]
    new = [path.name for path in files if path.stat().st_mtime >= start_s - 1.0]
    return f"{', '.join(new)} is written in {out}; later files are missing" if new else "nothing is kept"


def _limit_blas_threads() -> None:
    """Let linear algebra use one thread, unless the user says otherwise: its matrices are small, and threads that wait
    for one another occupy processors. The libraries read the variables once, when they are loaded."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _epochs(on_progress: OnProgress) -> Progress:
    """Reports epochs that are done, and their number, as progress."""
    from lanebound.agents.checkpointing.runner import Counter, RunProgress

    counter = Counter(on_progress, RunProgress(0))

    def report(done: int, of: int) -> None:
        counter.progress.of = of
        counter(done)

    return report


def record_sky(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a smartLoc drive with its truth.")],
    out: Annotated[
        Path, typer.Option(metavar="FILE.csv", help="The recorded sky, to be named as an environment's sky.")
    ],
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Write the sky along a recorded drive: received satellites by place, and their delays, for environments.

    Example: lanebound record-sky data/smartloc_berlin_potsdamer --out berlin.csv
    """
    from lanebound.integrity.core.errors import ConfigError
    from lanebound.integrity.replay.city import read_city
    from lanebound.integrity.replay.sky_record import SkyRecordConfig, summary
    from lanebound.integrity.replay.sky_record import record_sky as make

    if out.suffix != ".csv":
        raise ConfigError(f"--out must end in .csv, by which a recorded sky is known, got {out}: name it so")
    config = SkyRecordConfig.build(None, changes(assignments))
    with resumable(lambda: "nothing is kept"):
        drive = wait_for(lambda: read_city(dataset))
        recording = make(drive, config)
        recording.save(out)
    found = summary(recording)
    if as_json:
        print_json(found)
        return
    _print_sky(found)
    _print_files(drive.notes, [out])


def _print_sky(found: dict[str, Any]) -> None:

    rows = [("length m", found["length_m"]), ("satellites", found["satellites"]), ("rows", found["rows"])]
    rows += [(f"{kind}, share of rows", share) for kind, share in found["shares"].items()]
    rows += [("late signals, median m", found["late_median_m"]), ("late signals, 95 % m", found["late_95_m"])]
    rows += [
        ("a satellite left out: rows foretold", found["foretold"]),
        ("the same, guessed blindly", found["guessed"]),
    ]
    print_table("Recorded sky", ("", "value"), rows)


def _print_files(stopped: Any, written: list[Path], doubt: str | None = None) -> None:
    """Print a doubt of the levels, which inputs ended early, and the written files."""
    if doubt:
        typer.echo(f"warning: {doubt}", err=True)
    early = stopped if isinstance(stopped, dict) else {"file": stopped} if stopped else {}
    for name, reason in early.items():
        typer.echo(f"note: {name}: {reason}", err=True)
    for path in written:
        typer.echo(str(path))


def _print_city(found: dict[str, Any]) -> None:

    rows = []
    for name, solution in found["solutions"].items():
        for part in ("training", "after_training", "unshared"):
            for axis in ("at", "ct") if part in solution else ():
                counted = solution[part]["all_modes"][axis]
                rows.append([
                    name, part.removesuffix("_training"), axis, counted["epochs"],
                    solution[part]["accuracy"]["all"][axis]["rmse_m"], counted["pl_median_m"], counted["exceeded"],
                    f"{counted['rate_low']:.2g} to {counted['rate_high']:.2g}",
                ])  # fmt: skip
    head = ("solution", "part", "axis", "epochs", "RMSE m", "median PL m", "above PL", "exact 95 % interval")
    print_table(f"Errors above protection levels at risk {found['risk']:g}", head, rows)
    typer.echo(CITY_WORDS)
    if found["left_out_at_gaps"]:
        typer.echo(f"{found['left_out_at_gaps']} epochs are left out: their windows touch a gap of wheels and gyro.")
    _print_agreement(found)
    typer.echo(found["caution"])


def _print_outages(found: dict[str, Any]) -> None:

    head = ("age s", "axis", "outages", "median error m", "largest m", "median PL m", "above PL")
    rows = [
        [row["age_s"], axis, row["outages"], row[axis]["median_m"], row[axis]["max_m"], row[axis]["pl_median_m"],
         row[axis]["exceeded"]]
        for row in found["by_age"] for axis in ("at", "ct")
    ]  # fmt: skip
    print_table("Dead reckoning in artificial outages", head, rows)
    if found["left_out_at_gaps"]:
        typer.echo(f"{found['left_out_at_gaps']} further outages are left out: they touch a gap of a sensor.")
    _print_agreement(found)
    typer.echo(found["caution"])


def _print_agreement(found: dict[str, Any]) -> None:
    """Print how the sensors follow the reference."""
    for name, of in found.get("agreement", {}).items():
        tested = "" if of["tested"] else "; the drive shows too little of it to test unit and sign"
        lag = _lag_text(of["lag_s"], of["corrected"])
        typer.echo(
            f"{name} on the reference: slope {of['slope']:.3g}, correlation {of['correlation']:.2f}{lag}{tested}"
        )


def _lag_text(lag_s: float | None, corrected: bool) -> str:
    """What is known of a lag, and done about it."""
    from lanebound.integrity.replay.sensor_checks import SLIP_S

    if lag_s is None:
        return "; lag not tested, the drive shows too little motion: levels do not cover one"
    uncovered = ", not corrected: levels do not cover it" if abs(lag_s) >= SLIP_S else ""
    return f", lag {lag_s:.2f} s{', corrected' if corrected else uncovered}"


def _print_service(found: dict[str, Any]) -> None:

    rows = [(key, found[key]) for key in ("epochs", "judged", "reference")]
    rows += [(f"epochs by {mode}", count) for mode, count in found["modes"].items()]
    for key, name in (("horizontal", "error"), ("horizontal_of_service", "error of the service")):
        if found.get(key):
            rows += [(f"{name}, {part} m", found[key][f"{part}_m"]) for part in ("median", "p95", "max")]
    rows += [(key, found[key]) for key in ("available", "no_level", "no_position") if key in found]
    print_table(f"Drive on {', '.join(found['service'])}", ("", "value"), rows)
    if found["no_level"] > 0.0:
        count, none = (round(found[key] * found["epochs"]) for key in ("no_level", "no_position"))
        typer.echo(
            f"{count} of {found['epochs']} epochs have no finite level at risk {found['risk']:g}, {none} of them no "
            f"position either{_higher_risk(found['risk'])}"
        )
    if "at" in found:
        head = ("axis", "n", "above PL", "exact 95 % interval", "median PL m")
        levels = [
            [a, of["epochs"], of["exceeded"], f"{of['rate_low']:.2g} to {of['rate_high']:.2g}", of["pl_median_m"]]
            for a, of in ((axis, found[axis]) for axis in ("at", "ct"))
        ]
        print_table(f"Errors above protection levels at risk {found['risk']:g}", head, levels)
        typer.echo(found["caution"])


def _higher_risk(risk: float) -> str:
    """Advice to try ten times a risk; none where the risk is already high."""
    return f"; a higher risk has more levels: --set risk.integrity_risk={10.0 * risk:g}" if risk < HIGH_RISK else ""


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f} %"


def _print_context(found: dict[str, Any]) -> None:

    rows = [(key, found[key]) for key in ("recording", "epochs", "located", "matched")]
    rows += [(f"map, {key}", value) for key, value in found["roads"].items()]
    rows += [(f"{light} s", seconds) for light, seconds in found["light_s"].items()]
    rows += [(f"epochs {reason}", count) for reason, count in found["reasons"].items()]
    rows += [(f"HPL {key}", value) for key, value in found.get("level", {}).items()]
    rows += [(f"error {key}", value) for key, value in found.get("error", {}).items()]
    rows += [(f"map, {what}", count) for what, count in found["left_out"].items() if count]
    print_table("Context monitor", ("", "value"), rows)
    for phase, reason in found["skipped"].items():
        typer.echo(f"{phase} phase skipped: {reason}.")
    for note in found["notes"]:
        typer.echo(f"note: {note}.")
    if "rates" not in found:
        return
    head = ("rule", "points", "wrong", "false alarms", "missed", "OCDR")
    counts = [(name, c) for name, c in found["rates"].items() if isinstance(c, dict)]
    print_table("Warnings against the reference", head, [
        (name, c["points"], c["wrong"], c["false_alarms"], c["missed"], _share(c["ocdr"])) for name, c in counts
    ])  # fmt: skip
    typer.echo(found["caution"])


def _print_filter(found: dict[str, Any]) -> None:

    rows = [(key, found[key]) for key in ("epochs", "with_truth", "with_level", "first_level_s")]
    rows += [(f"positions {key}", value) for key, value in found["positions"].items()]
    for name in ("horizontal_m", "positions_m"):
        rows += [(f"{name} {key}", value) for key, value in (found[name] or {}).items()]
    rows += [(f"trust level {key}", value) for key, value in found["trust"].items()]
    used = ", ".join(found["sensors"])
    print_table(f"{found['filter']} of {found['navigator']} on {found['recording']}: {used}", ("", "value"), rows)
    levels = [
        [risk, axis, c["epochs"], c["exceeded"], f"{c['rate_low']:.2g} to {c['rate_high']:.2g}", c["pl_median_m"]]
        for risk, axes in found["levels"].items()
        for axis, c in axes.items()
    ]
    print_table("Levels", ("risk", "axis", "epochs", "above PL", "exact 95 % interval", "median PL m"), levels)
    _print_agreement(found)
    typer.echo(f"The recording lacks: {'; '.join(found['lacking'])}.")
    typer.echo(found["caution"])


def _print_inertial(found: dict[str, Any]) -> None:

    print_table("The sensor in the vehicle", ("", "value"), list(found["calibration"].items()))
    _print_outages(found)


MOST_HALVES = 0.2  # share of phases that may be off by half a cycle


def print_rtk(found: dict[str, Any]) -> None:
    """Print statistics, notes on the inputs, and errors where the true position is known."""

    keys = (
        "epochs", "fixed", "fixed_share", "first_fix_s", "satellites_median", "excluded", "wrong_fix_risk_max",
        "base_from_header_m", "base_from_codes_m", "rover_from_codes_m",
    )  # fmt: skip
    rows = [(key, found[key]) for key in keys if key in found] + [
        (f"epochs {name}", n) for name, n in found["status"].items() if n
    ]
    print_table("RTK", ("", "value"), rows)
    _print_rtk_notes(found)
    errors = found.get("errors", {})
    if errors:
        head = (
            "epochs", "axis", "n", "horizontal m: median", "95 %", "largest", "above PL", "exact 95 % interval",
            "median PL m",
        )  # fmt: skip
        print_table("Errors", head, [row for name in errors for row in _bounding_rows(name, errors[name])])
        typer.echo(found["caution"])


def _print_rtk_notes(found: dict[str, Any]) -> None:
    """Print why epochs are not fixed, and what seems wrong with the inputs."""
    from lanebound.integrity.positioning.modes import RtkStatus

    place = ",".join(f"{value:.3f}" for value in found["base_antenna_ecef_m"])
    typer.echo(
        f"Positions and levels are relative to the base at {place}, from {found['base_antenna_from']}: an error of it "
        "is an error of every position, and in no level"
    )
    for name, count in found["status"].items():
        if count and name == "not_converged":
            typer.echo(f"not_converged: {found['not_converged']['what']}")
        elif count and name != "fixed":
            typer.echo(f"{name}: {RtkStatus[name.upper()].value}")
    _print_place_notes(found)
    for name, share in found["half_cycle_share"].items():
        if share > MOST_HALVES:
            typer.echo(
                f"note: {100.0 * share:.0f} % of the phases of the {name} may be off by half a cycle by their flags, "
                "and are not used",
                err=True,
            )


def _print_place_notes(found: dict[str, Any]) -> None:
    """Print where given positions do not fit the codes of a receiver, or the fixed baseline."""
    from lanebound.integrity.replay.code_places import NEAR_M

    given = found["positions_given_by"]
    remedy = "correct" if found["base_antenna_from"] == given["base"] else "give"
    places = (
        ("base", f"positions may be wrong by as much, {remedy} {given['base']} of its antenna"),
        ("rover", f"errors may be wrong by as much, correct {given['rover']} of its antenna"),
    )
    for name, what in places:
        away = found.get(f"{name}_from_codes_m") or 0.0
        if away > NEAR_M:
            typer.echo(
                f"note: the {name} is {away:.0f} m from where its own codes put it, which are good to about 10 m: "
                f"{what}",
                err=True,
            )
    fit = found.get("fixed_baseline")
    if fit is not None and fit["likely"] is not None:
        typer.echo(f"note: the fixed baseline is {fit['off_m']:.2f} m from that of the two positions: {_likely(found)}",
                   err=True)  # fmt: skip


def _likely(found: dict[str, Any]) -> str:
    fit, given = found["fixed_baseline"], found["positions_given_by"]
    if fit["likely"] == "swapped":
        return (
            f"they are probably swapped, exchanged they are {fit['off_swapped_m']:.2f} m from it; exchange "
            f"{given['base']} and {given['rover']}, or the files of rover and base"
        )
    return (
        f"one of them is probably wrong by as much, check {given['rover']} and that of the base, from "
        f"{found['base_antenna_from']}; less likely, integers are wrong"
    )


def _bounding_rows(name: str, found: dict[str, Any]) -> list[list[Any]]:
    return [
        [
            name, axis, found[axis]["epochs"], *(found.get(f"horizontal_{key}_m") for key in ("median", "95", "max")),
            found[axis]["exceeded"],
            f"{found[axis]['rate_low']:.2g} to {found[axis]['rate_high']:.2g}", found[axis]["pl_median_m"],
        ]
        for axis in ("at", "ct")
    ]  # fmt: skip


_PRINTERS = {
    "context": _print_context, "service": _print_service, "filter": _print_filter, "smartloc": _print_city,
    "comma2k19": _print_outages, "imu_log": _print_inertial, "rinex": print_rtk,
}  # fmt: skip


AFTER_S = 60.0  # of the drifts, S4 section II-C5


def fit_imu(
    log: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="CSV with a head: time since switch-on [s], then accelerations [m/s^2]."),
    ],
    as_json: AsJson = False,
) -> None:
    """Fit C1 (1 - exp(-t / tau)) + C2 to each acceleration of a static log, without gravity (S4 section II-C5).

    The drifts are the position after the first 60 s from rest, with the error as it is and with the fitted law removed.
    Sigmas are those of white noise. A log that does not show a warm-up is fitted by a constant, and the reason printed:
    S4's sensor needs some 1,000 s.

    Set the result with --set navigator.imu.mems_exponential=true and navigator.imu.mems_c1_mps2, mems_c2_mps2,
    mems_tau_s.

    Example: lanebound fit-imu static.csv
    """
    from lanebound.integrity.sensors.inertial_law import PUBLISHED, read_static_log

    time_s, columns, note = read_static_log(log)
    if note:
        typer.echo(f"note: {log}: {note}", err=True)
    found = {name: _fitted(time_s, column) for name, column in columns.items()}
    if as_json:
        print_json(found)
        return
    keys = (
        "c1_mps2",
        "c1_sigma_mps2",
        "c2_mps2",
        "c2_sigma_mps2",
        "tau_s",
        "tau_sigma_s",
        "mean_mps2",
        "std_mps2",
        "drift_before_m",
        "drift_after_m",
    )
    rows = [(key, *(f"{values[key]:.5g}" if values[key] is not None else "-" for values in found.values()))
            for key in keys]  # fmt: skip
    print_table("Error of accelerometers", ("", *found), rows)
    for name, values in found.items():
        if values["constant"] is not None:
            typer.echo(f"{name}: a constant is fitted; {values['constant']}.")
    typer.echo(f"S4: C1 -0.0043, C2 -0.007, tau 500; it states 55 m of drift before and 0.7 m after. Its law drifts by "
               f"{abs(float(PUBLISHED.drift_m(AFTER_S))):.1f} m in 60 s.")  # fmt: skip


def _fitted(time_s: NDArray[np.float64], column: NDArray[np.float64]) -> dict[str, Any]:
    from lanebound.integrity.sensors.inertial_law import drift_m, fit_inertial_law

    fit = fit_inertial_law(time_s, column)
    law, shown = fit.law, fit.reason is None
    left, long = column - law.error_mps2(time_s), time_s[-1] - time_s[0] >= AFTER_S
    return {
        "c1_mps2": law.c1_mps2, "c1_sigma_mps2": fit.sigma[0] if shown else None,
        "c2_mps2": law.c2_mps2, "c2_sigma_mps2": fit.sigma[1], "tau_s": law.tau_s if shown else None,
        "tau_sigma_s": fit.sigma[2] if shown else None, "constant": fit.reason, "mean_mps2": float(left.mean()),
        "std_mps2": float(left.std()), "drift_before_m": drift_m(time_s, column, AFTER_S) if long else None,
        "drift_after_m": drift_m(time_s, left, AFTER_S) if long else None,
    }  # fmt: skip
