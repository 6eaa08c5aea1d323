"""Where the vehicle is, and how far to trust it: sensing, positioning, monitoring, assessment.

Conventions, declared once and used in every room of this package:

Frames
    ``enu``: local East, North, Up [m]. ``track``: along track AT (forward) and cross track CT (positive to the right).
    ``body``: x forward, y to the right, z down (a yaw rate is positive when the heading turns clockwise).
    ``theta`` / ``heading_rad``: azimuth of motion, clockwise from North [rad].
    ``[AT, CT] = R [E, N]`` with ``R = [[sin t, cos t], [cos t, -sin t]]``, which is its own inverse.
Units
    SI and radians everywhere; degrees only in configuration fields that end in ``_deg``. Names carry unit and frame at
    public boundaries (``pl_at_m``, ``velocity_enu_mps``); kernels use the paper's letters, mapped in their docstrings.
Letters
    ``m`` measurements, ``n`` unknowns, ``G`` (m, n) design matrix, ``Q_y`` (m, m) covariance of the measurements,
    ``W = Q_y^-1``, ``S = (G'WG)^-1 G'W`` (n, m), ``Q(x)`` upper-tail probability of N(0, 1).
    A design row is ``[-e, 1]`` with ``e`` the unit vector from receiver to satellite and the 1 in its clock's column.
Batch rule
    Every kernel takes any leading batch axes. ``B`` counts vehicles, ``S`` satellites, ``K`` sky tables. Satellites out
    of view are masked, never removed.
Outcomes
    Failure is a value: an enumerated verdict, a missing protection level is ``inf``, never NaN.
Randomness
    All draws come from named, seeded streams (:mod:`lanebound.integrity.core.streams`).
Errors
    Bad input raises :class:`~lanebound.integrity.core.errors.InputError` or ``ConfigError``, both ``ValueError``.

The main names are here, and are loaded when they are used:

>>> import numpy as np
>>> from lanebound.integrity import Navigator, NavigatorConfig, truth_between
>>> navigator = Navigator.nominal(NavigatorConfig(), seeds=[1, 2], duration_s=30.0)  # two vehicles, open sky
>>> dt, heading, velocity = 0.1, np.zeros(2), np.tile([0.0, 10.0], (2, 1))  # both drive to the North at 10 m/s
>>> position = np.array([[0.0, 0.0], [3.5, 0.0]])  # East, North [m]: poses of one's own
>>> for k in range(100):
...     before, position = position, position + dt * velocity
...     truth = truth_between((k + 1) * dt, dt, (before, position), (velocity, velocity), (heading, heading))
...     solution = navigator.step(truth)
>>> error = np.abs(solution.position_en_m - position)  # East is across, North along the track
>>> bool((error[:, 1] <= solution.pl_at_m).all() and (error[:, 0] <= solution.pl_ct_m).all())
True
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lanebound.integrity.core.errors import ConfigError, InputError
    from lanebound.integrity.core.streams import Streams
    from lanebound.integrity.monitoring.alerts import AlertReason
    from lanebound.integrity.motion.truth import Truth, truth_between
    from lanebound.integrity.navigators.navigator import (
        Measurements,
        Navigator,
        NavigatorConfig,
        NavigatorState,
        register_navigator,
    )
    from lanebound.integrity.navigators.solution import Solution
    from lanebound.integrity.positioning.modes import Mode, RtkStatus
    from lanebound.integrity.sensors.faults import Fault, FaultSchedule
    from lanebound.integrity.sky.road import Road
    from lanebound.integrity.sky.track import SkyTrack
    from lanebound.integrity.sky.visibility import SkyMask

__all__ = [
    "AlertReason",
    "ConfigError",
    "Fault",
    "FaultSchedule",
    "InputError",
    "Measurements",
    "Mode",
    "Navigator",
    "NavigatorConfig",
    "NavigatorState",
    "Road",
    "RtkStatus",
    "SkyMask",
    "SkyTrack",
    "Solution",
    "Streams",
    "Truth",
    "register_navigator",
    "truth_between",
]

MODULES = {
    "core.errors": ("ConfigError", "InputError"),
    "core.streams": ("Streams",),
    "monitoring.alerts": ("AlertReason",),
    "motion.truth": ("Truth", "truth_between"),
    "navigators.navigator": (
        "Measurements", "Navigator", "NavigatorConfig", "NavigatorState", "register_navigator",
    ),
    "navigators.solution": ("Solution",),
    "positioning.modes": ("Mode", "RtkStatus"),
    "sensors.faults": ("Fault", "FaultSchedule"),
    "sky.road": ("Road",),
    "sky.track": ("SkyTrack",),
    "sky.visibility": ("SkyMask",),
}  # fmt: skip
WHERE = {name: module for module, names in MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{WHERE[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
