"""Every kind of the family on the same epochs: it runs, in batches of any size alike, and never gives NaN."""

from __future__ import annotations

import numpy as np
import pytest
from code_geometry import quiet, with_everything

from lanebound.integrity.core.errors import ConfigError, InputError
from lanebound.integrity.monitoring.family import monitor as monitor_module
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.kinds import FAMILY, applicable, monitor_named
from lanebound.integrity.monitoring.family.monitor import MEMORY, watch
from lanebound.integrity.monitoring.family.outcome import MonitorOutcome

RISKS = [1e-2, 1e-5]
FITTED = {"classes": {"laws": [{"sigma_m": 2.0}]}}


def hostile() -> CodeEpochs:
    """Epochs without codes, with too few, with one spare, in one plane, and with absurd errors."""
    e = quiet(12, 10, 2, 41)
    used, y, los = np.ones(e.y_m.shape, bool), e.y_m.copy(), e.los_enu.copy()
    used[0], used[1, 3:], used[2, 6:] = False, False, False
    los[3] = los[3, :1]
    y[4, 2], y[5, :6] = 1e7, 1e5 * np.arange(6)
    return with_everything(CodeEpochs(**{**vars(e), "used": used, "y_m": y, "los_enu": los}))


@pytest.mark.parametrize("name", FAMILY)
def test_a_kind_gives_an_outcome_for_every_epoch(name: str) -> None:
    kind = monitor_named(name)
    config = kind.config(FITTED if "fit" in kind.needs else {})
    for epochs in (with_everything(quiet(25, 10, 2, 40)), hostile()):
        found = watch(epochs, config, RISKS)
        assert np.isfinite(found.position_enu_m).all()
        assert not np.isnan(found.hpl_m).any()
        assert not np.isnan(found.vpl_m).any()
        assert (found.hpl_m >= 0.0).all()
        assert (found.hpl_m[:, 1] >= found.hpl_m[:, 0]).all()
        assert np.isinf(found.hpl_m[~found.usable]).all()
        assert set(np.unique(found.outcome)) <= {m.code for m in MonitorOutcome}
    assert not found.excluded[0].any()


@pytest.mark.parametrize("name", [k for k, v in FAMILY.items() if v.config(FITTED).level not in MEMORY])
def test_snapshot_kinds_treat_epochs_apart(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = monitor_named(name)
    config = kind.config(FITTED if "fit" in kind.needs else {})
    e = hostile()
    whole = watch(e, config, RISKS)
    monkeypatch.setattr(monitor_module, "AT_ONCE", 5)
    parts = watch(e, config, RISKS)
    np.testing.assert_array_equal(whole.hpl_m, parts.hpl_m)
    np.testing.assert_array_equal(whole.position_enu_m, parts.position_enu_m)
    np.testing.assert_array_equal(whole.excluded, parts.excluded)


def test_kinds_apply_where_their_needs_are_met() -> None:
    plain, whole = quiet(2), with_everything(quiet(2))
    names = {kind.name for kind in applicable(plain)}
    assert {"residual", "ibpl", "araim"} <= names
    assert not names & {"kipl", "rraim_range", "map_exclude", "classes", "eraim"}
    assert {kind.name for kind in applicable(whole, fitted=True)} == set(FAMILY)


def test_mistakes_are_named() -> None:
    with pytest.raises(ConfigError, match="did you mean"):
        monitor_named("residuall")
    with pytest.raises(ConfigError, match="classes is required"):
        monitor_named("classes").config()
    for laws in ({"laws": [{"sigma_m": 1.0, "bias_m": 0.5}]}, {"laws": [{"sigma_m": 1.0}], "sides": "late"}):
        for kind in ("classes", "classes_normal"):
            with pytest.raises(ConfigError, match="paired or one-sided laws"):
                monitor_named(kind).config({"classes": laws})
    with pytest.raises(ConfigError, match="igg3_k1 must be > igg3_k0"):
        monitor_named("igg3").config({"igg3_k1": 1.0})
    with pytest.raises(InputError, match="risks must lie in"):
        watch(quiet(1), monitor_named("residual").config(), 0.0)
    for kind in FAMILY.values():
        assert kind.source, kind.name
        assert kind.promise, kind.name
