"""Records of code epochs: what is refused, with name, bound, value and remedy, and what does not count."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from code_geometry import quiet, with_everything

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import FAMILY, monitor_named
from lanebound.integrity.monitoring.family.monitor import watch

FITTED = {"classes": {"laws": [{"sigma_m": 2.0}]}}


def spoilt(name: str, at: Any, value: float) -> CodeEpochs:
    """Epochs with everything and one entry changed."""
    e = with_everything(quiet(6, 9, 1, 3))
    changed = np.array(getattr(e, name), copy=True)
    changed[at] = value
    return replace(e, **{name: changed})


@pytest.mark.parametrize(
    ("name", "at", "value", "words"),
    [
        ("y_m", (2, 3), np.nan, r"y_m must be finite and in \[-1e\+09, 1e\+09\] where it counts, got nan at \(2, 3\)"),
        ("y_m", (2, 3), 1e300, r"got 1e\+300 at \(2, 3\): correct it, or clear used"),
        ("sigma_m", (2, 3), -1.0, r"sigma_m must be finite and in \[1e-06, 1e\+06\]"),
        ("sigma_m", (2, 3), 1e200, "sigma_m must be finite"),
        ("cn0_dbhz", (2, 3), np.inf, "cn0_dbhz must be finite where it counts, got inf"),
        ("elevation_rad", (2, 3), -9.0, "elevation_rad must be finite and in"),
        ("los_enu", (2, 3, 0), np.nan, "los_enu must be unit vectors"),
        ("time_s", 2, np.nan, "time_s must be finite, got nan"),
        ("time_s", 2, -50.0, "time_s must be ascending within a drive, got -50.0 after 1.0 at epoch 2: sort"),
        ("drive", 2, 7, "drive must be ascending"),
        ("step_enu_m", (2, 0), np.nan, "step_enu_m must be finite .* or set step_sigma_m to inf"),
        ("step_sigma_m", 2, -5.0, "step_sigma_m must be >= 0, got -5.0: inf where unknown"),
        ("step_sigma_m", 2, np.nan, "step_sigma_m must be >= 0, got nan"),
        ("carrier_step_m", (2, 3), np.nan, "carrier_step_m must be finite .* or clear carrier_kept"),
        ("carrier_sigma_m", (2, 3), -1.0, "carrier_sigma_m must be finite"),
        ("carrier_sigma_m", (2, 3), 0.0, "carrier_sigma_m must be finite"),
        ("fixed_m", (2, 3), np.nan, "fixed_m must be finite .* or clear fixed_kept"),
        ("fixed_sigma_m", (2, 3), -1.0, "fixed_sigma_m must be finite"),
        ("fix_risk", 2, np.nan, r"fix_risk must be finite and in \[0, 1\]"),
        ("fix_risk", 2, -1.0, r"fix_risk must be finite and in \[0, 1\]"),
    ],
)
def test_what_cannot_be_used_is_refused(name: str, at: Any, value: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        spoilt(name, at, value).checked()
    with pytest.raises(InputError, match=words):
        watch(spoilt(name, at, value), monitor_named("residual").config(), 1e-3)


@pytest.mark.parametrize("kind", FAMILY)
def test_what_does_not_count_may_be_anything(kind: str) -> None:
    """Entries that are not used, kept or known are nan: no verdict has one, and none changes."""
    e = with_everything(quiet(6, 9, 1, 3))
    off = np.zeros(e.y_m.shape, bool)
    off[:, 7], off[3, 2] = True, True
    spread = e.step_sigma_m.copy()
    spread[4] = np.inf
    clean = replace(e, used=~off, carrier_kept=~off, fixed_kept=~off, step_sigma_m=spread)
    hidden = {name: np.where(off, np.nan, getattr(e, name)) for name in (
        "y_m", "sigma_m", "cn0_dbhz", "carrier_step_m", "carrier_sigma_m", "fixed_m", "fixed_sigma_m",
    )}  # fmt: skip
    step = e.step_enu_m.copy()
    step[4] = np.nan
    config = monitor_named(kind).config(FITTED if "fit" in monitor_named(kind).needs else {})
    whole, bare = (watch(given, config, [1e-2, 1e-5]) for given in (clean, replace(clean, step_enu_m=step, **hidden)))
    np.testing.assert_array_equal(whole.hpl_m, bare.hpl_m)
    np.testing.assert_array_equal(whole.position_enu_m, bare.position_enu_m)
    np.testing.assert_array_equal(whole.outcome, bare.outcome)


def test_times_may_be_alike_and_begin_anew_with_a_drive() -> None:
    e = quiet(6, 9, 1, 3)
    replace(e, time_s=np.zeros(6)).checked()
    replace(e, time_s=np.array([5.0, 6.0, 7.0, 0.0, 1.0, 2.0]), drive=np.repeat([0, 1], 3)).checked()
