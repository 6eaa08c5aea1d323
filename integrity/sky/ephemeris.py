"""Broadcast ephemerides as columns: the Keplerian elements, harmonic corrections and clocks that satellites send."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sky.systems import System

__all__ = ["Ephemerides"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BEIDOU_GEO = (*range(1, 6), *range(59, 64))  # BDS-SIS-ICD-2.1 table 5-10, BDS-SIS-ICD-B1I-3.0 table 4-1


@dataclass(frozen=True)
class Ephemerides:
    """Messages of satellites, one row for each, every array (N,) unless said otherwise.

    Attributes
    ----------
    system, prn : the satellite that the message is of
    toe_s, toc_s : reference times of the orbit and of the clock [s, GPS time since 1980-01-06]
    toe_of_week_s : reference time of the orbit in the system's own week [s]; the node's longitude counts from there
    root_a, eccentricity, inclination_rad, node_rad, perigee_rad, mean_anomaly_rad : at ``toe_s``; root_a in m^(1/2)
    motion_correction_radps, node_rate_radps, inclination_rate_radps
    cuc_rad, cus_rad, cic_rad, cis_rad, crc_m, crs_m : harmonic corrections of latitude, inclination and radius
    clock : (N, 3) offset [s], drift [s/s] and its rate [s/s^2]
    group_delay_s : (N, 2) as sent: TGD and 0 (GPS, QZSS), E5a/E1 and E5b/E1 (Galileo), TGD1 and TGD2 (BeiDou)
    health : health word, see :attr:`healthy`
    source : word on the message's type, for Galileo bit 0 or 2 I/NAV and bit 1 F/NAV
    issue : issue of data
    stopped : where reading a file cut short ended, empty for a whole one
    left_out : why messages were left out, one line each
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
        """The satellites there are messages of, (S, 2) rows of system and prn in ascending order."""
        if not len(self):
            return np.zeros((0, 2), np.int64)
        return np.unique(np.stack([self.system, self.prn], -1), axis=0)

    @property
    def healthy(self) -> NDArray[np.bool_]:
        """Whether the satellites say that they are well.  (N,).

        The last bit of QZSS's word is of one signal alone, which is set while L1 C/A is sent in its place: LEX in
        IS-QZSS 1.x, L1 C/B since IS-QZSS-PNT-004.
        """
        return np.asarray(np.where(self.system == System.QZSS, self.health & ~1, self.health) == 0)

    @property
    def geostationary(self) -> NDArray[np.bool_]:
        """Whether the elements are in BeiDou's inclined frame for geostationary satellites.  (N,)."""
        return np.asarray((self.system == System.BEIDOU) & np.isin(self.prn, BEIDOU_GEO))

    def take(self, rows: NDArray[np.bool_] | Ints) -> Ephemerides:
        """Some of the messages, by mask or by index."""
        columns = ((f.name, getattr(self, f.name)) for f in fields(self))
        chosen: dict[str, Any] = {name: column[rows] for name, column in columns if isinstance(column, np.ndarray)}
        return replace(self, **chosen)
