"""Power of the speed phase: which form sees which fault."""

from lanebound.integrity.assessment.warning_rates import SpeedPowerConfig, rest_power, speed_power
from lanebound.integrity.monitoring.context.monitor import ContextConfig
from lanebound.integrity.monitoring.context.speed_phase import SpeedPhaseConfig


def test_the_printed_form_never_warns_and_the_wheels_see_steady_faults() -> None:
    found = speed_power(SpeedPowerConfig(runs=400), SpeedPhaseConfig())
    assert all(case["printed"] == 0.0 for case in found.values())
    assert found["no fault, uneven braking"]["trend"] > 0.9
    for case in ("no fault, steady", "no fault, uneven braking"):
        assert found[case]["wheel"] < 0.02
    for case in ("slip of 10 %", "Doppler 1 m/s too fast", "frozen wheels, braking 0.5 m/s2"):
        assert found[case]["wheel"] > 0.95
        assert found[case]["trend"] < 0.02
    slips = [found[f"slip of {share} %"]["wheel"] for share in (2, 5, 10)]
    assert slips == sorted(slips)


def test_the_whole_monitor_sees_wheels_that_froze_at_a_stop() -> None:
    """In every form of the speed phase; without a fault only the form that uneven braking alarms is red."""
    found = rest_power(SpeedPowerConfig(runs=200), ContextConfig())
    for name, share in found.items():
        if "frozen" in name:
            assert min(share.values()) == 1.0, name
    assert found["whole monitor: at rest, no fault"]["wheel"] < 0.02
    assert found["whole monitor: at rest, no fault"]["printed"] == 0.0
