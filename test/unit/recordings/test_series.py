"""The signals of a recording: what the board output at a time."""
from __future__ import annotations

import numpy as np

from car_interface.recordings.series import Output

NEVER = [-1] * 14
OUTPUT = Output(np.array([1.0, 2.0, 2.5]),
                np.array([[5104, -1, *NEVER], [3808, -1, *NEVER], [3808, 4912, *NEVER]]))


def test_duty_of_a_channel_is_that_of_the_newest_row():
    for channel, t_s, duties in (
            (0, [0.999, 1.0, 1.999, 2.0, 1e9], [-1, 5104, 5104, 3808, 3808]),
            (1, [2.49, 2.5], [-1, 4912]), (15, [9.0], [-1]), (0, [2.0, 0.0, 1.0], [3808, -1, 5104]), (0, [], [])):
        found = OUTPUT.at(channel, np.array(t_s))
        assert found.tolist() == duties and found.dtype.kind == "i"


def test_of_rows_with_the_same_time_the_last_one_counts():
    output = Output(np.array([1.0, 1.0]), np.array([[100] * 16, [200] * 16]))
    assert output.at(3, np.array([1.0])).tolist() == [200]
