"""Where the sonars saw something."""
from __future__ import annotations

import numpy as np
import pytest

from written_recordings import SPEED_MPS


def test_sonar_hits_are_where_the_car_was(seen):
    x_m, y_m = seen.sonars.echoes.places()
    assert seen.sonars.echoes.count == 3 and np.abs(y_m).max() < 0.02
    # At 10.2 s it has driven for 5.2 s.
    assert x_m.min() == pytest.approx(5.2 * SPEED_MPS + 0.42 + 0.8, abs=0.1)
    assert (seen.sonars.nearest_m, seen.sonars.nearest_sonar) == (pytest.approx(0.8), "front_middle")
