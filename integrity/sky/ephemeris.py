"""Broadcast ephemerides as columns: Keplerian elements, harmonic corrections and clock terms of the messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sky.systems import System

__all__ = ["Ephemerides"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BEIDOU_GEO = (*range(1, 6), *range(59, 64))  # BDS-SIS-ICD-2.1 table 5-10, BDS-SIS-ICD-B1I-3.0 table 4-1


@dataclass(frozen=True)
class Ephemerides:
    """N broadcast messages, one row for each; all arrays are (N,) unless stated otherwise.

    Attributes
    ----------
    system, prn : satellite that sent the message
    toe_s, toc_s : reference times of the orbit and of the clock [s, GPS time since 1980-01-06]
    toe_of_week_s : reference time of the orbit in the week of the system [s]; reference of the node's longitude
    root_a, eccentricity, inclination_rad, node_rad, perigee_rad, mean_anomaly_rad : at ``toe_s``; root_a in m^(1/2)
    motion_correction_radps, node_rate_radps, inclination_rate_radps
    cuc_rad, cus_rad, cic_rad, cis_rad, crc_m, crs_m : harmonic corrections of latitude, inclination and radius
    clock : (N, 3) offset [s], drift [s/s] and drift rate [s/s^2]
    group_delay_s : (N, 2) as broadcast: TGD and 0 (GPS, QZSS), E5a/E1 and E5b/E1 (Galileo), TGD1 and TGD2 (BeiDou)
    health : health word, see :attr:`healthy`
    source : data source word; for Galileo bit 0 or 2 is I/NAV and bit 1 is F/NAV
    issue : issue of data
    stopped : the place where a truncated file ended, empty for a complete file
    left_out : one line for each omitted message, with the reason
    """

    system: Ints
    prn: Ints
    toe_s: Array
    toc_s: Array
    toe_of_week_s: Array
    root_a: Array
    eccentricity: Array
    inclination_rad: Array
    node_rad: Array
    perigee_rad: Array
    mean_anomaly_rad: Array
    motion_correction_radps: Array
    node_rate_radps: Array
    inclination_rate_radps: Array
    cuc_rad: Array
    cus_rad: Array
    cic_rad: Array
    cis_rad: Array
    crc_m: Array
    crs_m: Array
    clock: Array
    group_delay_s: Array
    health: Ints
    source: Ints
    issue: Ints
    stopped: str = ""
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.system.size)

    @property
    def satellites(self) -> Ints:
        """Satellites with one or more messages: (S, 2) rows of system and prn in ascending order."""
        if not len(self):
            return np.zeros((0, 2), np.int64)
        return np.unique(np.stack([self.system, self.prn], -1), axis=0)

    @property
    def healthy(self) -> NDArray[np.bool_]:
        """Whether the health word of each message marks the satellite as healthy.  (N,).

        The last bit of the QZSS word is ignored. It concerns a single signal and is set while L1 C/A is transmitted
        instead of it: LEX in IS-QZSS 1.x, L1 C/B since IS-QZSS-PNT-004.
        """
        return np.asarray(np.where(self.system == System.QZSS, self.health & ~1, self.health) == 0)

    @property
    def geostationary(self) -> NDArray[np.bool_]:
        """Whether the elements refer to BeiDou's inclined frame for geostationary satellites.  (N,)."""
        return np.asarray((self.system == System.BEIDOU) & np.isin(self.prn, BEIDOU_GEO))

    @classmethod
    def merged(cls, tables: Sequence[Ephemerides]) -> Ephemerides:
        """The messages of one or more tables, in their order.

        A message that two files contain is listed twice, which changes no position.
        """
        if not tables:
            raise InputError("navigation must have one file at least, got none: pass that of the day")
        columns = {
            f.name: np.concatenate([getattr(table, f.name) for table in tables])
            for f in fields(cls)
            if isinstance(getattr(tables[0], f.name), np.ndarray)
        }
        stopped = "; ".join(table.stopped for table in tables if table.stopped)
        return cls(**columns, stopped=stopped, left_out=tuple(line for table in tables for line in table.left_out))

    def take(self, rows: NDArray[np.bool_] | Ints) -> Ephemerides:
        """The messages that a mask or an index array selects."""
        columns = ((f.name, getattr(self, f.name)) for f in fields(self))
        chosen: dict[str, Any] = {name: column[rows] for name, column in columns if isinstance(column, np.ndarray)}
        return replace(self, **chosen)
