"""``lanebound fit-imu``: the warm-up error of accelerometers from a static log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lanebound.agents.cli.options import AsJson

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["fit_imu"]

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
    from lanebound.agents.cli.output import print_json, print_table
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
