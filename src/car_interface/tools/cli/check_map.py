"""Checks a table as turn_arb or generic_value_converter would, and shows it.

FILE is a steering calibration in YAML, as turn_arb loads it, or a value map in CSV. Autoware's two
maps are joined to one by --brake brake_map.csv accel_map.csv -o value_map.csv.
"""
from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Iterator, Sequence

from car_interface.common import output, process_setup
from car_interface.common.errors import CarInterfaceError, ConfigError, within
from car_interface.common.lookup_table import LookupTable
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.steering.calibration import WIDE_M, SteeringCalibration
from car_interface.steering.config import load_steering
from car_interface.throttle.converter import ConverterConfig
from car_interface.throttle.value_map import Grid, ValueMap, load_value_map, read_grid
from car_interface.tools.cli.options import finite

STEERING_SUFFIXES = (".yaml", ".yml")
PICTURE_SUFFIXES = (".svg", ".png", ".pdf")
MAP_SUFFIX = ".csv"
BAR = 24  # characters to each side
MAX_COLUMNS, MAX_ROWS = 11, 21
LIMITS = ConverterConfig()  # the defaults of generic_value_converter
LEVEL_MPS2 = 0.005  # a smaller rise may vanish in a CSV with two decimals
PLAIN = "\033[0m"
# Of the terminal's 256 colours: from braking to accelerating.
SHADES = (160, 167, 174, 181, 188, 255, 188, 152, 116, 74, 32)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of check_map."""
    parser.add_argument("file", metavar="FILE", help="a steering calibration (.yaml) or a map of values (.csv)")
    parser.add_argument("-o", "--output", metavar="PICTURE", help="also draw it: " + ", ".join(PICTURE_SUFFIXES)
                        + f"; with --brake also the joined map: {MAP_SUFFIX}")
    parser.add_argument("--brake", metavar="BRAKE_MAP", help="Autoware's brake_map.csv, FILE being its accel_map.csv: "
                        "the two are joined, with the brake's values negative")
    parser.add_argument("--allow-plateaus", action="store_true",
                        help="take a map whose acceleration stays level from one value to the next")
    parser.add_argument("--min-value", type=finite, default=LIMITS.min_value, metavar="VALUE",
                        help=f"generic_value_converter's min_value (default: {LIMITS.min_value:g})")
    parser.add_argument("--max-value", type=finite, default=LIMITS.max_value, metavar="VALUE",
                        help=f"its max_value (default: {LIMITS.max_value:g})")


def run(options: argparse.Namespace) -> int:
    """Load the file as its node would, and show it."""
    is_steering = Path(options.file).suffix.lower() in STEERING_SUFFIXES
    suffix, suffixes = Path(options.output or "").suffix.lower(), PICTURE_SUFFIXES + (MAP_SUFFIX,) * bool(options.brake)
    if options.output and suffix not in suffixes:
        raise CarInterfaceError(f"-o {options.output}: accepted: a name that ends in " + ", ".join(suffixes))
    if options.output:
        output.check(options.output, [options.file, *filter(None, [options.brake])])
    limits = ConverterConfig(options.min_value, options.max_value)
    name, text = options.file, None
    if options.brake:
        name, text = f"{options.file} with {options.brake}", joined_text(options.file, options.brake)
    table = load_steering(name) if is_steering else load_value_map(name, options.allow_plateaus, text)
    if suffix in PICTURE_SUFFIXES:
        from car_interface.tools.report.plots import draw  # matplotlib only for who asks for it
        process_setup.reserve_blas()
        output.write(options.output, draw(table, suffix[1:], name))
    if is_steering:
        lines, notes = steering_picture(table), list(steering_notes(table))
    else:
        with within(name):
            limits = replace(limits, value_map=table)
        lines = map_picture(table, sys.stdout.isatty() and "NO_COLOR" not in os.environ)
        notes = list(map_notes(table, limits))
    node = "turn_arb" if is_steering else "generic_value_converter"
    print("\n".join([f"{name}: {node} takes it", "", *lines, *[""] * bool(notes),
                     *[f"note: {note}" for note in notes]]))
    if suffix == MAP_SUFFIX:
        print("\n" + output.written_text(options.output, output.write(options.output, text, keeps_old=True)))
    elif options.output:
        print(f"\ndrawn in {options.output}")
    return 0


# --- Autoware's two maps ---


def joined_text(accel_path: str, brake_path: str) -> str:
    """Return the CSV of one map that does what Autoware does with its accel_map and its brake_map.

    Autoware uses the brake_map for an acceleration below the accel_map's first row, which is of value 0. A brake is a
    negative value here. The row of value 0 is the accel_map's: between it and the first brake of the brake_map, where
    Autoware holds 0 or brakes from the brake_map's own row of value 0 on, the joined map is linear.

    Raises:
        ConfigError: naming the file that isn't such a map.
    """
    accel, brake = read_grid(accel_path), read_grid(brake_path)
    for path, grid, kind, falls in ((accel_path, accel, "accel_map", False), (brake_path, brake, "brake_map", True)):
        if grid.falls() != falls:
            raise ConfigError(path, None, f"Autoware's {kind}, whose acceleration {'falls' if falls else 'rises'} with "
                              "value", "is another map")
        if grid.values[0] != 0.0:
            raise ConfigError(f"{path}, line 2, column 1", grid.values[0], f"0, with which Autoware's {kind} begins")
    velocities = sorted({*accel.velocities, *brake.velocities})  # no bend of either map is lost
    rows = [(-value, row) for value, row in reversed(_at(brake, velocities)) if value > 0] + _at(accel, velocities)
    lines = ["default," + _numbers(velocities), *(_numbers([value, *row]) for value, row in rows)]
    return "\n".join(lines) + "\n"


def _at(grid: Grid, velocities):
    """Return (value, accelerations at the velocities) for each row."""
    tables = [LookupTable(grid.velocities, row) for row in grid.accelerations]
    return [(value, [table(velocity) for velocity in velocities]) for value, table in zip(grid.values, tables)]


def _numbers(numbers):
    return ",".join(repr(round(number, 9)) for number in numbers)  # without the errors of binary fractions


# --- steering ---


def steering_picture(config: SteeringCalibration) -> list[str]:
    """Return the servo's travel to each side for each turn radius, as lines of text."""
    max_travel = max(abs(duty - config.servo_center) for duty in
                (config.servo_left, config.servo_right, *config.left_duties, *config.right_duties)) or 1

    def bar(duty):
        return "█" * round(BAR * abs(duty - config.servo_center) / max_travel)

    return [(f"servo_left {config.servo_left}, servo_center {config.servo_center}, servo_right {config.servo_right}, "
             f"channel {config.servo_channel}"), "", f"{'radius':>9}  {'left':>6} {'':{BAR}}│{'':{BAR}} right",
            *(f"{radius_m:7g} m  {left:6g} {bar(left):>{BAR}}│{bar(right):<{BAR}} {right:<6g}".rstrip()
              for radius_m, left, right in zip(config.radius_axis_m, config.left_duties, config.right_duties))]


def steering_notes(config: SteeringCalibration) -> Iterator[str]:
    """Yield what turn_arb accepts and an owner may still want to know."""
    for side, table, end in (("left", config.left_duties, config.servo_left),
                             ("right", config.right_duties, config.servo_right)):
        towards_center = 1 if config.servo_center > end else -1
        steps = list(zip(config.radius_axis_m, config.radius_axis_m[1:], table, table[1:]))
        for radius_m, wider_m, tight, wide in steps:
            if (wide - tight) * towards_center < 0:
                yield (f"to the {side} the duty goes back from {tight:g} to {wide:g} where the turn gets wider, "
                       f"{radius_m:g} to {wider_m:g} m")
        same = [f"{radius_m:g} and {wider_m:g} m" for radius_m, wider_m, tight, wide in steps
                if round(tight / DUTY_PER_COUNT) == round(wide / DUTY_PER_COUNT)]
        if same:
            yield (f"to the {side} the servo board can't tell apart ({DUTY_PER_COUNT} duty are one count): "
                   f"{', '.join(same)}")
        if (table[0] - end) * towards_center < 0:
            yield f"to the {side} the table goes to {table[0]:g}, beyond servo_{side} {end}"
    if config.radius_axis_m[-1] < WIDE_M:
        yield f"a planner that asks for wider turns gets {config.radius_axis_m[-1]:g} m: nothing here goes straight on"


# --- maps ---


def map_picture(table: ValueMap, colour: bool = False) -> list[str]:
    """Return the accelerations as lines of text: value upwards, velocity to the right; of a large map only some."""
    rows, columns = _some(table.values, MAX_ROWS), _some(table.velocities, MAX_COLUMNS)
    cells = [[table.acceleration_at(value, velocity) for velocity in columns] for value in rows]
    largest = max(max(map(abs, row)) for row in cells) or 1.0
    values, velocities = table.values, table.velocities
    return [(f"acceleration in m/s²; {len(values)} values, {values[0]:g} to {values[-1]:g}; "
             f"{len(velocities)} velocities, {velocities[0]:g} to {velocities[-1]:g} m/s"), "",
            *(f"{value:8.4g} │" + "".join(_cell(number, largest, colour) for number in row)
              for value, row in zip(reversed(rows), reversed(cells))),
            f"{'value':>8} └" + "─" * (7 * len(columns)),
            f"{'m/s':>8}  " + "".join(f"{velocity:6.3g} " for velocity in columns)]


def map_notes(table: ValueMap, limits: ConverterConfig = LIMITS) -> Iterator[str]:
    """Yield what generic_value_converter accepts and an owner may still want to know."""
    values, velocities = table.values, table.velocities
    smallest, velocity, low, high = min(
        (table.acceleration_at(high, velocity) - table.acceleration_at(low, velocity), velocity, low, high)
        for low, high in zip(values, values[1:]) for velocity in velocities)
    if smallest < LEVEL_MPS2:
        yield (f"from value {low:g} to {high:g} at {velocity:g} m/s acceleration rises by only {smallest:.2g} m/s²: "
               "a small error there is a large one in the value")
    held = []
    for velocity in (velocities[0], velocities[-1]):
        lowest, highest = (table.acceleration_at(value, velocity) for value in (values[0], values[-1]))
        if lowest <= 0 <= highest:
            held.append(f"{table.value_at(0.0, velocity):.3g} at {velocity:g} m/s")
        else:
            yield f"at {velocity:g} m/s it has no value for 0 m/s², only for {lowest:g} to {highest:g}"
    if held:
        yield f"0 m/s² takes the value {' and '.join(held)}"
    if values[0] < limits.min_value or values[-1] > limits.max_value:
        yield (f"its values, {values[0]:g} to {values[-1]:g}, lie partly outside: generic_value_converter clamps to "
               f"min_value {limits.min_value:g} … max_value {limits.max_value:g}")


def _cell(number, largest, colour):
    text = f"{number:6.2f}"
    if not colour:
        return text + " "
    shade = SHADES[round((number / largest + 1) / 2 * (len(SHADES) - 1))]
    return f"\033[48;5;{shade};38;5;16m{text} {PLAIN}"


def _some(axis: Sequence[float], count: int) -> list[float]:
    """Return an axis, or, if it is longer, ``count`` of its numbers with both ends."""
    if len(axis) <= count:
        return list(axis)
    return [axis[round(index * (len(axis) - 1) / (count - 1))] for index in range(count)]
