from fractions import Fraction

import numpy as np
import pytest

from lanebound.integrity.core.errors import (
    ConfigError,
    InputError,
    require_finite,
    require_in_range,
    require_probability,
    require_shape,
)


def test_both_errors_are_value_errors():
    assert issubclass(ConfigError, InputError)
    assert issubclass(InputError, ValueError)


@pytest.mark.parametrize("value", [3, 2.5, [1, 2], np.array([[1, 2]], dtype=np.int32), np.float32(0.5), []])
def test_finite_values_come_back_as_float64(value):
    found = require_finite("x_m", value)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, np.asarray(value, dtype=np.float64))


def test_float64_arrays_are_not_copied():
    array = np.ones(3)
    assert require_finite("x_m", array) is array


@pytest.mark.parametrize(
    ("value", "place"),
    [
        (np.nan, r"got x_m = nan"),
        (-np.inf, r"got x_m = -inf"),
        ([0.0, np.inf, np.nan], r"got x_m\[1\] = inf"),
        ([[0.0, 1.0], [2.0, np.nan]], r"got x_m\[1, 1\] = nan"),
    ],
)
def test_the_first_bad_entry_is_named(value, place):
    with pytest.raises(InputError, match=place):
        require_finite("x_m", value)


@pytest.mark.parametrize("value", ["east", [[1.0], [1.0, 2.0]], {"a": 1}])
def test_what_is_not_numeric_is_refused_with_its_type(value):
    with pytest.raises(InputError, match=f"x_m must be numeric, got {type(value).__name__}"):
        require_finite("x_m", value)


@pytest.mark.parametrize(
    "value", ["1.5", b"2", ["1", "2"], [1.0, "2"], np.array(["3"]), np.array([1, "2"], dtype=object), 1j, [1 + 0j]]
)
def test_text_and_complex_numbers_are_not_read_as_numbers(value):
    with pytest.raises(InputError, match=f"x_m must be numeric, got {type(value).__name__}.*: pass an array of num"):
        require_finite("x_m", value)
    with pytest.raises(InputError, match="x_m must be numeric"):
        require_in_range("x_m", value, 0.0, 9.0)


def test_objects_that_are_numbers_pass():
    np.testing.assert_array_equal(require_finite("x_m", np.array([1, Fraction(1, 2)], dtype=object)), [1.0, 0.5])


@pytest.mark.parametrize("trailing", [(), (3,), (2, 3), (None, 3), (2, None), (4, 2, 3)])
def test_fitting_shapes_pass(trailing):
    require_shape("a", np.zeros((4, 2, 3)), trailing)


@pytest.mark.parametrize("trailing", [(2,), (3, 3), (None, 2), (None, 4, 2, 3)])
def test_other_shapes_are_refused_with_the_wanted_one(trailing):
    wanted = ", ".join("any" if w is None else str(w) for w in trailing)
    with pytest.raises(InputError, match=rf"a must have shape \(\.\.\., {wanted}\), got \(4, 2, 3\)"):
        require_shape("a", np.zeros((4, 2, 3)), trailing)


@pytest.mark.parametrize(("low_open", "high_open"), [(False, False), (True, False), (False, True), (True, True)])
def test_the_ends_of_a_range_belong_to_it_unless_open(low_open, high_open):
    for value, is_open in ((-1.0, low_open), (2.0, high_open)):
        if is_open:
            with pytest.raises(InputError, match="must lie in"):
                require_in_range("x", value, -1.0, 2.0, low_open=low_open, high_open=high_open)
        else:
            assert require_in_range("x", value, -1.0, 2.0, low_open=low_open, high_open=high_open) == value
    assert require_in_range("x", 0.5, -1.0, 2.0, low_open=low_open, high_open=high_open) == 0.5


def test_a_value_out_of_range_is_named_with_the_interval():
    with pytest.raises(InputError, match=r"x must lie in \(0\.0, 2\.0\], got 2\.5"):
        require_in_range("x", [1.0, 2.5, -1.0], 0.0, 2.0, low_open=True)
    with pytest.raises(InputError, match="must be finite"):
        require_in_range("x", [1.0, np.nan], 0.0, 2.0)


def test_a_probability_lies_strictly_inside_the_unit_interval():
    assert require_probability("risk", np.float64(1e-8)) == 1e-8
    for value in (0.0, 1.0, -1e-9, 1.1):
        with pytest.raises(InputError, match=r"risk must lie in \(0\.0, 1\.0\)"):
            require_probability("risk", value)
