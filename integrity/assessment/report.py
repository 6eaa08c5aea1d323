"""Assessment of a drive in one call."""

from __future__ import annotations

from typing import Any

from lanebound.integrity.assessment.accuracy import accuracy_by_mode, mode_share
from lanebound.integrity.assessment.availability import availability_by_mode, find_outages, integrity_available
from lanebound.integrity.assessment.bounding import bounding_by_mode
from lanebound.integrity.assessment.events import find_events
from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.assessment.stanford import count_zones
from lanebound.integrity.positioning.modes import Mode

__all__ = ["assess"]


def assess(record: Record, al_at_m: float, al_ct_m: float, time_to_alert_s: float = 1.0) -> dict[str, Any]:
    """Compute all statistics of a record as JSON data: shares, accuracy, bounding, availability, events, zones."""
    limits = zip(AXES, (al_at_m, al_ct_m), strict=True)
    return {
        "epochs": record.epochs,
        "alert_limit": {"at_m": al_at_m, "ct_m": al_ct_m},
        "mode_share": mode_share(record),
        "accuracy": accuracy_by_mode(record),
        "bounding": bounding_by_mode(record),
        "availability": availability_by_mode(record, al_at_m, al_ct_m),
        "integrity_outages": find_outages(integrity_available(record, al_at_m, al_ct_m), record.time_s).summary(),
        "rtk_outages": find_outages(record.mode == Mode.RTK, record.time_s).summary(),
        "events": find_events(record, al_at_m, al_ct_m, time_to_alert_s).summary(),
        "stanford": {axis: count_zones(record, axis, al).to_dict() for axis, al in limits},
    }
