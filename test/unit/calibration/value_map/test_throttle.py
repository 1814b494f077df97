"""The inverse of the converter's table."""
from __future__ import annotations

import numpy as np

from car_interface.calibration.value_map.throttle import load_throttle


def throttle_file(tmp_path, text):
    path = tmp_path / "throttle.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_duties_become_values_by_the_throttles_table_the_other_way_round(tmp_path):
    path = throttle_file(tmp_path, "servo: {channel: 2, value_axis: [-1, 0, 4], duty_table: [6000, 5000, 3000], "
                                   "neutral: 5000}\ncommand_timeout: 0.3\n")
    table = load_throttle(str(path))
    assert table.neutral == 0.0
    assert table.values(np.array([6000, 5500, 5000, 4000, 3000])).tolist() == [-1, -0.5, 0, 2, 4]
    assert table.values(np.array([6016, 2984])).tolist() == [-1, 4]  # the board's rounding
    assert np.isnan(table.values(np.array([6100, 2900, 0]))).all()
