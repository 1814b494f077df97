"""The check that the simulator's configurations share."""
from __future__ import annotations

import pytest

from car_interface.common.errors import ConfigError
from car_interface.sim.checks import require


def test_valid_value_is_accepted():
    assert require(True, "lag_s", 0.1, "more than 0") is None


@pytest.mark.parametrize("value, found", [(0.0, "is 0.0"), ("fast", "is 'fast'"), ((1, 2), "is (1, 2)"),
                                          (None, "is missing")])
def test_invalid_value_is_refused_with_its_name_and_what_is_accepted(value, found):
    with pytest.raises(ConfigError) as caught:
        require(False, "lag_s", value, "more than 0")
    assert str(caught.value) == f"lag_s {found}; accepted: more than 0"
    assert (caught.value.name, caught.value.value, caught.value.accepted) == ("lag_s", value, "more than 0")
