"""The fit of the topological matcher's weights: no drive of the results, and the shares that the matcher has."""

from __future__ import annotations

import numpy as np

from lanebound.agents.studies.context_drive import CONNECTIONS, SCALES_M, TRAINING, fit, record
from lanebound.agents.studies.context_study import ContextStudyConfig
from lanebound.integrity.positioning.map_matching.matching import TopologicalConfig


def test_a_recorded_drive_is_matched_by_every_pair_of_weights() -> None:
    study = ContextStudyConfig()
    drive = record("mixed", TRAINING, [TRAINING, TRAINING + 1], 30, study)
    found = fit([drive], study.monitor.matching)
    assert set(found) == {(scale, connection) for scale in SCALES_M for connection in CONNECTIONS}
    own = found[study.monitor.matching.topological.scale_m, study.monitor.matching.topological.connection]
    assert own == {"mixed": drive.share(study.monitor.matching)}
    assert 0.5 < own["mixed"] <= 1.0
    assert drive.driving.shape == (30, 2)


def test_the_fitted_pair_is_the_default_and_training_is_apart_from_the_results() -> None:
    """Largest mean share: 15 m and 0.05 (97.5 %; the earlier 20 m and 0.25: 95.9 %)."""
    weights = TopologicalConfig()
    assert (weights.scale_m, weights.connection) == (15.0, 0.05)
    study = ContextStudyConfig()
    assert study.first_seed + study.seeds < TRAINING
    assert np.ceil(study.seeds / study.batch) < TRAINING
