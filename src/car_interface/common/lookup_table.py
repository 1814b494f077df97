"""One-dimensional lookup tables: linear between breakpoints, saturated at both ends.

A table is checked when it is made, so that a lookup can't fail.
"""
from __future__ import annotations

import math
from bisect import bisect_right
from typing import Sequence

from car_interface.common.errors import require


class LookupTable:
    """A piecewise linear function, given by its breakpoints.

    Args:
        axis: breakpoints, at least two, finite, strictly increasing.
        values: the function's value at each of them, finite; any order, repeats allowed.
        axis_name, values_name: the parameters' names, for the error message.

    Raises:
        ConfigError: naming the parameter and the invalid element.
    """

    def __init__(self, axis: Sequence[float], values: Sequence[float], axis_name="axis", values_name="values"):
        check_axis(axis, axis_name)
        require(len(values) == len(axis), values_name, list(values),
                f"{len(axis)} numbers, one for each element of {axis_name}")
        for index, value in enumerate(values):
            require(math.isfinite(value), f"{values_name}[{index}]", value, "a finite number")
        self.axis = tuple(float(x) for x in axis)
        self.values = tuple(float(y) for y in values)

    def __call__(self, x: float) -> float:
        """Return the value at ``x``: interpolated within the axis, the end value beyond it. ``x`` must not be NaN."""
        axis, values = self.axis, self.values
        above = bisect_right(axis, x)
        if above == 0:
            return values[0]
        if above == len(axis):
            return values[-1]
        x0, y0 = axis[above - 1], values[above - 1]
        return y0 + (x - x0) / (axis[above] - x0) * (values[above] - y0)


def check_axis(axis: Sequence[float], name: str) -> None:
    """Raise ConfigError unless ``axis`` has at least two finite, strictly increasing elements."""
    require(len(axis) >= 2, name, list(axis), "at least two increasing numbers")
    for index, x in enumerate(axis):
        require(math.isfinite(x), f"{name}[{index}]", x, "a finite number")
        require(not index or x > axis[index - 1], f"{name}[{index}]", x,
                f"more than the element before it, {axis[index - 1]!r}")
    require(math.isfinite(axis[-1] - axis[0]), name, list(axis), "a span that is a finite number")


def round_half_away(x: float) -> int:
    """Return the nearest integer, halves away from zero as C's ``lround``; Python's ``round`` goes to even."""
    whole = math.floor(abs(x))
    if abs(x) - whole >= 0.5:  # exact; x + 0.5 would itself be rounded, and make 1 of 0.49999999999999994
        whole += 1
    return whole if x >= 0 else -whole
