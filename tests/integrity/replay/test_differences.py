"""Single differences: what is left of them at the true position is the clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from baselines import AXES, PLACE, receiver, sky

from lanebound.integrity.replay.differences import arc_of, matched, reduce_epoch, troposphere_m
from lanebound.integrity.replay.signal_choice import choose_signals


def test_at_the_true_position_only_clock_and_whole_cycles_remain() -> None:
    table, time = sky(), np.arange(3.0)
    offset = np.array([400.0, -250.0, 30.0])
    rover_place, base_place = PLACE + AXES @ offset, PLACE
    options = {"code_m": 0.0, "phase_m": 0.0}
    rover = receiver(table, time, np.tile(rover_place, (3, 1)), clock_s=4e-4, seed=1, **options)
    base = receiver(table, time, np.tile(base_place, (3, 1)), clock_s=-2e-4, seed=2, **options)
    choice = choose_signals(rover, base)
    arcs = [arc_of(o, choice.rover, choice, table) for o in (rover, base)]
    for nominal in (rover_place, rover_place + AXES @ np.array([0.4, -0.3, 0.5])):
        found = reduce_epoch(arcs[0], arcs[1], 1, 1, nominal, base_place)
        assert found.tracked[:, :2].all()
        elevation = np.arcsin(found.sight_enu[:, 2])
        air = troposphere_m(rover_place, elevation) - troposphere_m(base_place, elevation)
        left = found.code_m[:, 0] + found.sight_enu @ offset + air  # the simulated air is empty
        assert np.ptp(left) < 5e-3  # the rover has a horizon of its own: 7e-5 rad of 23 m per rad at 17 degrees
        cycles = ((found.phase_m - found.code_m) / choice.wavelength_m[table.satellites[:, 0]])[:, :2]
        apart = cycles[:7] - cycles[0]
        np.testing.assert_allclose(apart, np.round(apart), atol=1e-2)


def test_epochs_are_matched_with_the_newest_before() -> None:
    table = sky()
    rover = receiver(table, np.arange(0.0, 3.0, 0.2), np.tile(PLACE, (15, 1)), clock_s=0.0, seed=1)
    base = receiver(table, np.arange(1.0, 3.0), np.tile(PLACE, (2, 1)), clock_s=0.0, seed=2)
    ours, theirs, age = matched(rover, base, 30.0)
    assert ours.tolist() == list(range(5, 15))
    assert theirs.tolist() == [0] * 5 + [1] * 5
    np.testing.assert_allclose(age, np.tile(np.arange(5) * 0.2, 2), atol=1e-9)
    assert matched(rover, base, 0.25)[0].tolist() == [5, 6, 10, 11]
    early = replace(rover, tow_s=rover.tow_s - 0.004)  # its clock is behind that of the base by some milliseconds
    assert [found.tolist() for found in matched(early, base, 30.0)[:2]] == [ours.tolist(), theirs.tolist()]
    assert matched(early, base, 30.0)[2].min() == 0.0


def test_the_troposphere_is_what_it_is_known_to_be() -> None:
    zenith = troposphere_m(PLACE, np.array([np.pi / 2.0]))[0]
    assert 2.2 < zenith < 2.5  # 2.3 m dry and a decimetre wet at sea level
    low = troposphere_m(PLACE, np.array([np.radians(10.0)]))[0]
    assert 5.0 < low / zenith < 6.0  # 1 / sin 10 degrees is 5.76
    high = troposphere_m(PLACE * (1.0 + 1000.0 / np.linalg.norm(PLACE)), np.array([np.pi / 2.0]))[0]
    assert 0.2 < zenith - high < 0.4


def test_each_band_of_each_receiver_is_judged_by_its_own_strength() -> None:
    table, time = sky(), np.arange(2.0)
    rover, base = (receiver(table, time, np.tile(PLACE, (2, 1)), clock_s=0.0, seed=k) for k in (1, 2))
    rows = base.rows["G"]
    rows.value[rows.satellite == rows.satellite[0], 5] = 18.0  # semi-codeless, at the base alone
    choice = choose_signals(rover, base)
    arcs = [arc_of(o, choice.rover, choice, table) for o in (rover, base)]
    weak = int(np.flatnonzero((table.satellites == [0, rows.satellite[0]]).all(1))[0])
    for least, tracked in ((0.0, True), (30.0, False)):
        found = reduce_epoch(arcs[0], arcs[1], 0, 0, PLACE, PLACE, least)
        assert found.tracked[weak, :2].tolist() == [True, tracked]
        assert np.delete(found.tracked[:, :2], weak, 0).all()
    # the mean variance of a signal of 55 dB-Hz, which are 45 of a semi-codeless one, and one of 28
    assert abs(found.cn0_dbhz[weak, 1] + 10.0 * np.log10((10**-5.5 + 10**-2.8) / 2.0)) < 1e-9
    assert np.allclose(found.cn0_dbhz[:, 0], 45.0)


def test_observations_of_qzss_meet_their_messages() -> None:
    table, time = sky(), np.arange(2.0)
    as_qzss = np.where(table.system == 0, 4, table.system)
    table = replace(table, system=as_qzss, prn=np.where(as_qzss == 4, 192 + table.prn % 10, table.prn))
    rover = receiver(replace(table, system=np.where(as_qzss == 4, 0, as_qzss)), time, np.tile(PLACE, (2, 1)),
                     clock_s=0.0, seed=1)  # fmt: skip
    rover = replace(rover, rows={"J": rover.rows["G"], "E": rover.rows["E"]})
    choice = choose_signals(rover, rover)
    arc = arc_of(rover, choice.rover, choice, table)
    assert (arc.code_m[0, table.satellites[:, 0] == 4, :2] > 0.0).all()
