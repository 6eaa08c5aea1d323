"""Small recordings written by the tests, damage done to them, and the folder of real ones."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lanebound.integrity.core.errors import InputError

SMARTLOC = (
    "odom3 0 5.0 0 0 0 0 -0.01 0.0025 0.0009 0.0009 4e-06 4e-06 4e-06\n"
    "pseudorange3 0 19949087.65 25 14567933.9 2809850.9 21875628.0 12 1 85.1 49\n"
    "pseudorange3 0 19713469.01 64 18145814.9 11532054.1 13684003.6 320 4 58.1 40\n"
    "odom3 0.2 5.1 0 0 0 0 -0.02 0.0025 0.0009 0.0009 4e-06 4e-06 4e-06\n"
    "pseudorange3 0.2 19949090.11 25 14567933.9 2809850.9 21875628.0 12 1 85.1 50\n"
)
SMARTLOC_TRUTH = "point3 0 3785108.1 899901.4 5037234.4\npoint3 0.2 3785106.6 899901.7 5037235.4\n"
RAW_HEAD = (
    "GPSWeek [weeks];GPSSecondsOfWeek [s];Longitude (GT Lon) [deg];Latitude (GT Lat) [deg];"
    "Height above ellipsoid (GT Height) [m];Heading (0° = East, counterclockwise) - (GT Heading) [rad];"
    "Velocity (GT Velocity) [m/s];Yaw-Rate (GT Yaw-rate) [rad/s];Pseudorange measurement (prMes) [m];"
    "Carrier phase measurement (cpMes) [cycles];Doppler measurement (doMes) [Hz];GNSS identifier (gnssId) [];"
    "Satellite identifier (svId) [];Frequency slot - only Glonass (freqId) [];"
    "Carrier-to-noise density ratio (cno) [dbHz];"
    "Estimated pseudorange measurement standard deviation (prStdev) [m];NLOS (0 == no, 1 == yes, # == No Information)"
)
RAW = (
    f"{RAW_HEAD}\n"
    "1900;126641.5;13.37;52.50;76.0;1.24;5.7;0.001;19834597.8;104231506.0;222.1;GPS;12;0;50;0.32;0\n"
    "1900;126641.5;13.37;52.50;76.0;1.24;5.7;0.001;19784715.1;105797774.1;2219.3;Glonass;20;9;39;2.56;1\n"
    "1900;126641.7;13.37;52.50;76.0;1.24;5.7;0.001;19784715.1;105797774.1;2219.3;SBAS;120;0;39;2.56;#\n"
)
RTK_SOLUTION = (
    "% program   : RTKPOST\n"
    "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m) ... age(s)  ratio\n"
    "2270 194670.000   35.165360868  136.881409540    41.4082   1  16 "
    "  0.0049   0.0046   0.0102   0.0028   0.0018  -0.0033   0.03    6.4\n"
    "2270 194670.200   35.165360869  136.881409516    41.4086   2   9 "
    "  0.0049   0.0046   0.0103   0.0028   0.0018  -0.0033   0.22    1.2\n"
)
RTK_REFERENCE = (
    "GPS TOW (s),GPS Week,Latitude (deg),ECEF X (m),ECEF Y (m),ECEF Z (m),Roll (deg)\n"
    "194670.0, 2270, 35.16536109, -3810228.582, 3567868.547, 3652903.300,  0.329\n"
    "194670.2, 2270, 35.16536109, -3810228.582, 3567868.547, 3652903.300,  0.331\n"
)


def rinex_line(text: str, label: str) -> str:
    return f"{text:<60}{label}\n"


def rinex_header(**changes: str) -> str:
    lines = {
        "RINEX VERSION / TYPE": "     3.04           OBSERVATION DATA    M",
        "APPROX POSITION XYZ": " -3817680.9841  3562840.0688  3650158.4543",
        "SYS / # / OBS TYPES": "G    4 C1C L1C C2W L2W",
        "TIME OF FIRST OBS": "  2024     6    24     8    20    0.0000000     GPS",
        "END OF HEADER": "",
    } | changes
    return "".join(rinex_line(text, label) for label, text in lines.items())


def rinex_satellite(name: str, *values: float, lost: int = 0) -> str:
    cells = "".join(f"{value:14.3f}{lost or ' '} " if value else " " * 16 for value in values)
    return f"{name}{cells}".rstrip() + "\n"


def rinex_epoch(second: float, *satellites: str, flag: int = 0) -> str:
    return f"> 2024 06 24 08 20 {second:10.7f}  {flag}{len(satellites):3d}\n" + "".join(satellites)


RINEX = (
    rinex_header()
    + rinex_epoch(0.0, rinex_satellite("G05", 2e7, 1e8, 2e7, 8e7), rinex_satellite("G07", 2.1e7, 1.1e8))
    + rinex_epoch(1.0, rinex_satellite("G05", 2e7, 1e8, 2e7, 8e7, lost=1))
)

SKY = (
    "# length_m=20.00\n"
    "satellite,arc_m,azimuth_deg,elevation_deg,path,excess_m,cn0_dbhz\n"
    "G01,2.50,270.00,40.00,blocked,0.00,0.0\n"
    "G01,12.50,270.00,40.00,los,0.00,46.0\n"
    "G02,2.50,90.00,40.00,reflected,35.25,31.0\n"
    "G02,12.50,90.00,40.00,foliage,0.00,36.5\n"
)


def comma_folder(folder: Path, n: int = 8) -> Path:
    """A segment that goes straight North at 10 m/s."""
    rng = np.random.default_rng(1)
    time_s = np.arange(n) * 0.05
    start = np.array([-2712087.5, -4261670.1, 3881014.5])
    arrays = {
        "global_pose/frame_times": time_s,
        "global_pose/frame_positions": start + time_s[:, None] * [2.9, 4.0, 6.2],
        "global_pose/frame_velocities": np.tile([2.9, 4.0, 6.2], (n, 1)),
        "global_pose/frame_orientations": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        "CAN/speed/t": time_s, "CAN/speed/value": np.full((n, 1), 8.0),
        "CAN/wheel_speed/t": time_s, "CAN/wheel_speed/value": np.full((n, 4), 8.0),
        "IMU/accelerometer/t": time_s, "IMU/accelerometer/value": np.asfortranarray(rng.normal(size=(n, 3))),
        "IMU/gyro/t": time_s, "IMU/gyro/value": np.zeros((n, 3)),
    }  # fmt: skip
    for name, array in arrays.items():
        path = folder / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, array)
    return folder


def survives(read: Callable[[], Any], processor_s: float = 20.0, megabytes: float = 256.0) -> Any:
    """What ``read`` returns, or None after an InputError that says something; fails on anything else, or too much."""
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    message, found = "a result needs none to be understood", None
    try:
        found = read()
    except InputError as error:
        message = str(error)
    assert len(message) > 20
    assert time.process_time() - start < processor_s
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1024 * megabytes
    return found


def real(name: str) -> Path:
    """A folder of real recordings, from LANEBOUND_DATA; skips the test where there is none."""
    root = os.environ.get("LANEBOUND_DATA", "")
    path = Path(root) / name
    if not root or not path.exists():
        pytest.skip(f"LANEBOUND_DATA holds no {name}")
    return path
