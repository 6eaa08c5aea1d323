"""Monitor ``interference``: satellites far too strong are excluded; a loss of C/N0 raises levels and alerts.

An example: jamming that begins before the drive, grows slowly or removes all signals is not detected.
"""

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import one_record, record
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.rtk_reckoning.extension_kernel import exclude_satellite, raise_alert, raise_level
from lanebound.integrity.navigators.rtk_reckoning.extra_stages import Point, register_stages
from lanebound.integrity.positioning.codes_kernel import RTK

LOUDEST_DBHZ, TOLERATED_DB, AVERAGE_S = 57.0, 6.0, 30.0
STATE = record(usual="C/N0 of a tracked satellite, averaged, 0: not yet known [dB-Hz]")


@jit
def exclude(first: int, last: int, epoch: Any, own: Any) -> None:
    """Exclude satellites that are stronger than any can be."""
    for v in range(first, last):
        for s in range(epoch.signals.shape[1]):
            if epoch.signals[v, s].cn0 > LOUDEST_DBHZ:
                exclude_satellite(epoch, v, s)


@jit
def bound(first: int, last: int, epoch: Any, own: Any) -> None:
    """``PL = K sigma 10^(loss / 20)`` of the RTK position, as noise grows with the loss of C/N0; alert beyond 6 dB."""
    signals, share = epoch.signals, epoch.parameters[0].dt / AVERAGE_S
    for v in range(first, last):
        w, mine, count, total = epoch.work[v], own.state[v], 0, 0.0
        for s in range(signals.shape[1]):
            if signals[v, s].tracked:
                count += 1
                total += signals[v, s].cn0
        if count == 0:
            continue
        if mine.usual == 0.0:
            mine.usual = total / count
        loss = mine.usual - total / count
        if loss > TOLERATED_DB:
            raise_alert(w, own.code)
        else:
            mine.usual -= share * loss
        if w.mode == RTK and loss > 0.0:
            for case in range(epoch.tables.cases.shape[0]):
                for axis in range(2):
                    k_md = epoch.tables.cases[case].k_dead[axis]
                    raise_level(epoch, v, case, axis, k_md * w.fixed.sigma[axis] * 10.0 ** (loss / 20.0))


REASON = AlertReason.register("interference", "the signals lose strength; expect errors of all satellites at once")
register_stages(
    "interference",
    "jamming and false signals, by C/N0",
    ("cn0", "tracked"),
    {Point.MEASURED: exclude, Point.BOUNDED: bound},
    one_record(STATE, usual=0.0),
    REASON,
)
