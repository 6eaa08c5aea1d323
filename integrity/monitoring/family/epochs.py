"""One record of code epochs, which every monitor of the family takes: simulated or recorded, many epochs at once."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_in_range, require_shape

__all__ = ["MOST_SYSTEMS", "CodeEpochs"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

MOST_SYSTEMS = 8
UNIT_TOLERANCE = 1e-6
MOST_M = 1e9  # of a code or a carrier, observed minus computed: beyond it squares lose their digits
LEAST_SIGMA_M, MOST_SIGMA_M = 1e-6, 1e6


@dataclass(frozen=True)
class CodeEpochs:
    """E epochs of one or more drives over m satellites, each in a column of its own; nothing here is true state.

    ``y = -e.x + clock of the system + errors`` with x the position in the East-North-Up frame of the drive [m].

    Attributes
    ----------
    time_s : (E,) [s], not descending within a drive.
    y_m : (E, m) observed minus computed codes; any finite value where not used.
    los_enu : (E, m, 3) unit vectors receiver to satellite; any finite value where not used.
    sigma_m : (E, m) standard deviation stated for each code.
    used : (E, m) bool, the code is there.
    system : (m,) clock group of each satellite, 0 to 7.
    cn0_dbhz, elevation_rad : (E, m).
    drive : (E,) number of the drive of each epoch, ascending; methods with memory begin anew where it changes.
    shadowed : (E, m) bool, a map or a detector says that the direct path is blocked; None without either.
    step_enu_m, step_sigma_m : (E, 3) displacement since the epoch before by wheels, gyro or Doppler, and (E,) its
        standard deviation on each axis, inf where unknown; None without such sensors.
    carrier_step_m : (E, m) observed minus computed change of the carrier since the epoch before, of the same form as
        ``y`` with the displacement for x; ``carrier_sigma_m`` (E, m) its standard deviation, independent from step to
        step; ``carrier_kept`` (E, m) bool where the carrier was held. None without.
    fixed_m : (E, m) carriers with resolved integers, of the same form as ``y``; ``fixed_sigma_m`` (E, m) their standard
        deviation, ``fixed_kept`` (E, m) bool where there is one, ``fix_risk`` (E,) probability that an integer is
        wrong. None without.
    """

    time_s: Array
    y_m: Array
    los_enu: Array
    sigma_m: Array
    used: Bools
    system: Ints
    cn0_dbhz: Array
    elevation_rad: Array
    drive: Ints
    shadowed: Bools | None = None
    step_enu_m: Array | None = None
    step_sigma_m: Array | None = None
    carrier_step_m: Array | None = None
    carrier_sigma_m: Array | None = None
    carrier_kept: Bools | None = None
    fixed_m: Array | None = None
    fixed_sigma_m: Array | None = None
    fixed_kept: Bools | None = None
    fix_risk: Array | None = None

    @classmethod
    def of(
        cls,
        y_m: ArrayLike,
        los_enu: ArrayLike,
        sigma_m: ArrayLike = 1.0,
        used: ArrayLike = True,
        system: ArrayLike = 0,
        **more: Any,
    ) -> CodeEpochs:
        """Epochs from the least that a monitor needs; the rest has neutral values (45 dB-Hz, time = number of epoch).

        Raises
        ------
        InputError
            As :meth:`checked`.
        """
        y = np.atleast_2d(np.asarray(y_m, dtype=np.float64))
        shape = y.shape
        los = np.broadcast_to(np.asarray(los_enu, dtype=np.float64), (*shape, 3))
        rest: dict[str, Any] = {
            "time_s": np.arange(shape[0], dtype=np.float64),
            "cn0_dbhz": np.full(shape, 45.0),
            "elevation_rad": np.arcsin(np.clip(los[..., 2], -1.0, 1.0)),
            "drive": np.zeros(shape[0], np.int64),
        } | more
        return cls(
            y_m=y,
            los_enu=los,
            sigma_m=np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), shape),
            used=np.broadcast_to(np.asarray(used, dtype=bool), shape),
            system=np.broadcast_to(np.asarray(system, dtype=np.int64), shape[1:]),
            **rest,
        ).checked()

    @property
    def count(self) -> int:
        """Number of epochs E."""
        return int(self.y_m.shape[0])

    def checked(self) -> CodeEpochs:
        """The record itself.

        Raises
        ------
        InputError
            Shapes that do not fit; times or numbers of drives that go back; systems outside 0 to 7; where used: no unit
            vectors, codes of 1e9 m or more, deviations outside 1e-6 to 1e6 m, elevations outside +-90 degrees, entries
            that are not finite; of steps, carriers and fixes the same where they are known or kept.
        """
        epochs, columns = self.y_m.shape
        for name, shape in _shapes(epochs, columns).items():
            value = getattr(self, name)
            if value is not None:
                require_shape(name, np.asarray(value), shape)
        require_in_range("system", self.system, 0, MOST_SYSTEMS - 1)
        self._check_order()
        used = self.used
        _require_where("y_m", self.y_m, used, -MOST_M, MOST_M)
        _require_where("sigma_m", self.sigma_m, used, LEAST_SIGMA_M, MOST_SIGMA_M)
        _require_where("cn0_dbhz", self.cn0_dbhz, used)
        _require_where("elevation_rad", self.elevation_rad, used, -0.5 * np.pi, 0.5 * np.pi)
        self._check_more()
        seen = used
        for kept in (self.carrier_kept, self.fixed_kept):
            seen = seen if kept is None else seen | kept
        length = np.square(self.los_enu).sum(-1)
        if not (np.abs(length[seen] - 1.0) <= 2.0 * UNIT_TOLERANCE).all():
            raise InputError("los_enu must be unit vectors where used or kept, some are not: normalise them")
        return self

    def _check_order(self) -> None:
        """Times that are finite and do not go back within a drive, and drives one after another."""
        if not np.isfinite(self.time_s).all():
            raise InputError("time_s must be finite, got nan or inf: leave these epochs out")
        if (np.diff(self.drive) < 0).any():
            raise InputError("drive must be ascending, got a lower number after a higher one: sort the epochs by drive")
        back = (np.diff(self.time_s) < 0.0) & (np.diff(self.drive) == 0)
        if back.any():
            k = int(back.argmax()) + 1
            before, now = self.time_s[k - 1], self.time_s[k]
            raise InputError(
                f"time_s must be ascending within a drive, got {now} after {before} at epoch {k}: sort the epochs, or "
                "give the later ones another number of drive"
            )

    def _check_more(self) -> None:
        """Steps, carriers and fixes where they are known or kept."""
        if self.step_enu_m is not None and self.step_sigma_m is not None:
            spread = self.step_sigma_m
            if not (spread >= 0.0).all():  # nor nan
                raise InputError(f"step_sigma_m must be >= 0, got {spread[~(spread >= 0.0)][0]}: inf where unknown")
            known = np.repeat(np.isfinite(spread)[:, None], 3, axis=1)
            _require_where("step_enu_m", self.step_enu_m, known, -MOST_M, MOST_M, "set step_sigma_m to inf")
        for name, size, sigma, kept in (
            ("carrier", "carrier_step_m", "carrier_sigma_m", self.carrier_kept),
            ("fixed", "fixed_m", "fixed_sigma_m", self.fixed_kept),
        ):
            if kept is not None and getattr(self, size) is not None and getattr(self, sigma) is not None:
                remedy = f"clear {name}_kept"
                _require_where(size, getattr(self, size), kept, -MOST_M, MOST_M, remedy)
                _require_where(sigma, getattr(self, sigma), kept, LEAST_SIGMA_M, MOST_SIGMA_M, remedy)
        if self.fix_risk is not None and self.fixed_kept is not None:
            _require_where("fix_risk", self.fix_risk, np.asarray(self.fixed_kept.any(-1)), 0.0, 1.0, "clear fixed_kept")

    def take(self, rows: ArrayLike | slice) -> CodeEpochs:
        """Some of the epochs, by mask, index or slice."""
        which: Any = rows if isinstance(rows, slice) else np.asarray(rows)
        changed = {
            f.name: getattr(self, f.name)[which]
            for f in fields(self)
            if f.name != "system" and getattr(self, f.name) is not None
        }
        return replace(self, **changed)

    def with_codes(self, sigma_m: Array | None = None, used: Bools | None = None) -> CodeEpochs:
        """The same epochs with other deviations or with fewer codes."""
        return replace(
            self, sigma_m=self.sigma_m if sigma_m is None else sigma_m, used=self.used if used is None else used
        )

    def starts(self) -> Bools:
        """First epochs of drives.  (E,)."""
        return np.asarray(np.diff(self.drive, prepend=self.drive[:1] - 1) != 0)


def _shapes(epochs: int, columns: int) -> dict[str, tuple[int, ...]]:
    """Shape of each field."""
    both = (epochs, columns)
    of_epoch = dict.fromkeys(("time_s", "drive", "step_sigma_m", "fix_risk"), (epochs,))
    of_code = dict.fromkeys(
        (
            "y_m",
            "sigma_m",
            "used",
            "cn0_dbhz",
            "elevation_rad",
            "shadowed",
            "carrier_step_m",
            "carrier_sigma_m",
            "carrier_kept",
            "fixed_m",
            "fixed_sigma_m",
            "fixed_kept",
        ),
        both,
    )
    return {**of_epoch, **of_code, "los_enu": (*both, 3), "system": (columns,), "step_enu_m": (epochs, 3)}


def _require_where(
    name: str, value: Array, where: Bools, low: float = -np.inf, high: float = np.inf, remedy: str = "clear used"
) -> None:
    """Refuse entries that are not finite or outside the bounds, where they count."""
    fine = (value >= low) & (value <= high) & np.isfinite(value)
    bad = where & ~fine
    if bad.any():
        at = np.argwhere(bad)[0]
        bounds = "be finite" if np.isinf(low) else f"be finite and in [{low:g}, {high:g}]"
        place = tuple(map(int, at))
        raise InputError(
            f"{name} must {bounds} where it counts, got {value[place]} at {place}: correct it, or {remedy}"
        )
