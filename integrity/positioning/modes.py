"""How a position was obtained: the modes of S1 figure 1, the services of S2 Table 1, and those that users add; and why
RTK holds at an epoch, or why not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from lanebound.integrity.core.advice import Advice
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.positioning import codes_kernel as codes

__all__ = ["Mode", "RtkStatus"]


class RtkStatus(Advice):
    """Outcome of one RTK epoch; ``code`` is what arrays carry."""

    FIXED = codes.FIXED, "ambiguities fixed and the fixed position passed its tests"
    NO_CORRECTIONS = codes.NO_CORRECTIONS, "the reference data are missing or too old: wait for the link"
    TOO_FEW = codes.TOO_FEW, "too few satellites with carrier lock: wait for a better view of the sky"
    NOT_CONVERGED = codes.NOT_CONVERGED, "the risk of a wrong fix is above its limit: wait for more satellites"
    RATIO_FAILED = codes.RATIO_FAILED, "the second best integers fit nearly as well: wait for the next epoch"
    FAULT = codes.FAULT, "the fixed position failed its fault test: wait for the next epoch"
    SEARCH_FAILED = codes.SEARCH_FAILED, "the integer search did not finish: the float solution is too loose"


class _ModeTable(type):
    """Lets the class be used as the table of its members, in the order of their codes."""

    members: dict[int, Mode]

    def __iter__(cls) -> Iterator[Mode]:
        return iter(list(cls.members.values()))

    def __len__(cls) -> int:
        return len(cls.members)


class Mode(int, metaclass=_ModeTable):
    """Source of the position of an epoch (S1 Fig. 1); ``CODE`` is the metre-level start-up fix before any RTK.

    A mode is the integer code that arrays hold. ``key`` is its name in tables and JSON, for instance ``imu_odometer``,
    ``label`` its name in figures and printed tables, for instance ``IMU + odometer``.
    """

    NONE: ClassVar[Mode]
    RTK: ClassVar[Mode]
    DOPPLER: ClassVar[Mode]
    IMU_ODOMETER: ClassVar[Mode]
    CODE: ClassVar[Mode]
    SPP: ClassVar[Mode]
    DGPS: ClassVar[Mode]
    SBAS_L1: ClassVar[Mode]
    SBAS_DFMC: ClassVar[Mode]
    PPP: ClassVar[Mode]
    NRTK: ClassVar[Mode]

    key: str
    label: str
    serves: bool

    def __new__(cls, code: int) -> Mode:
        found = cls.members.get(int(code))
        if found is None:
            raise ValueError(f"mode must be one of {[int(m) for m in cls]}, got {code}: register it first")
        return found

    @classmethod
    def register(cls, key: str, label: str, serves: bool = False) -> Mode:
        """Add a mode, with the next code; the same mode when the key is known already.

        ``serves`` marks the mode of a positioning service other than RTK from one station.

        Raises
        ------
        InputError
            The key is known with another label.
        """
        for mode in cls:
            if mode.key == key:
                if mode.label != label:
                    raise InputError(f"label of mode {key!r} must be {mode.label!r}, got {label!r}: choose another key")
                return mode
        mode = int.__new__(cls, len(cls))  # codes are rows of tables, so they leave no gap
        mode.key, mode.label, mode.serves = key, label, serves
        cls.members[int(mode)] = mode
        return mode

    @classmethod
    def withdraw(cls, mode: Mode) -> None:
        """Take back the mode that was registered last.

        Raises
        ------
        InputError
            It is a mode of this package, or another one was registered after it.
        """
        if int(mode) <= codes.NRTK or int(mode) != len(cls) - 1:
            raise InputError(f"mode must be the one registered last, got {mode.key!r}: withdraw in reverse order")
        del cls.members[int(mode)]

    @classmethod
    def named(cls, key: str) -> Mode:
        """The mode of a key, or InputError."""
        for mode in cls:
            if mode.key == key:
                return mode
        known = ", ".join(mode.key for mode in cls)
        raise InputError(f"mode must be one of {known}, got {key!r}: import the module that registers it")

    @property
    def is_service(self) -> bool:
        """Whether the position is that of a positioning service other than RTK from one station."""
        return self.serves

    @property
    def value(self) -> int:
        """The code as a plain integer."""
        return int(self)

    @property
    def name(self) -> str:
        """The key in capitals, as the name of a constant."""
        return self.key.upper()

    def __repr__(self) -> str:
        return f"Mode.{self.name}"

    __str__ = int.__repr__

    def __reduce__(self) -> tuple[Any, ...]:
        return Mode.named, (self.key,)


Mode.members = {}
BUILT_IN = {
    codes.NONE: ("none", "no solution"),
    codes.RTK: ("rtk", "RTK"),
    codes.DOPPLER: ("doppler", "Doppler"),
    codes.IMU_ODOMETER: ("imu_odometer", "IMU + odometer"),
    codes.CODE: ("code", "code"),
    codes.SPP: ("spp", "SPP"),
    codes.DGPS: ("dgps", "DGPS"),
    codes.SBAS_L1: ("sbas_l1", "SBAS L1"),
    codes.SBAS_DFMC: ("sbas_dfmc", "SBAS DFMC"),
    codes.PPP: ("ppp", "PPP"),
    codes.NRTK: ("nrtk", "network RTK"),
}
for _code in sorted(BUILT_IN):
    _mode = Mode.register(*BUILT_IN[_code], serves=codes.SPP <= _code <= codes.NRTK)
    setattr(Mode, BUILT_IN[_code][0].upper(), _mode)
