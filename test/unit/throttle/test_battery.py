"""When a battery is low, and when it stops the planner: stories of voltages half a second apart."""

import math

import pytest

from car_interface.common import causes
from car_interface.throttle.battery import SEE_WHO, BatteryConfig, BatteryWatch

S = 1_000_000_000
START = 1000 * S
CONFIG = BatteryConfig(warn_below_v=7.0, stop_below_v=6.6, recovery_v=0.5, timeout_s=5.0)
FULL, LOW, EMPTY = 8.0, 6.8, 6.4
NAN, INF = math.nan, math.inf
WELL = ""


class Battery:
    def __init__(self, config=CONFIG):
        self.watch, self.now = BatteryWatch(config), START

    def has(self, voltage, seconds=2.5):
        """A voltage every half second for so long; None = silence. Returns the cause at the end."""
        for _ in range(round(2 * seconds)):
            self.now += S // 2
            if voltage is not None:
                self.watch.update(voltage, self.now)
        return self.watch.status(self.now).cause


@pytest.mark.parametrize("story, cause", [
    ([(FULL, 2.5)], WELL),
    ([(LOW, 2.0)], WELL),
    ([(LOW, 2.5)], causes.BATTERY_LOW),
    ([(EMPTY, 2.5)], causes.BATTERY_EMPTY),
    ([(EMPTY, 2.0), (LOW, 0.5)], causes.BATTERY_LOW),
    ([(EMPTY, 2.0), (FULL, 0.5), (EMPTY, 2.0)], WELL),
    ([(7.0, 9.0)], WELL),
    ([(EMPTY, 2.5), (7.0, 9.0)], causes.BATTERY_EMPTY),
    ([(EMPTY, 2.5), (7.1, 2.0)], causes.BATTERY_EMPTY),
    ([(EMPTY, 2.5), (7.1, 2.5)], causes.BATTERY_LOW),
    ([(EMPTY, 2.5), (FULL, 2.5)], WELL),
    ([(FULL, 2.5), (None, 5.0)], WELL),
    ([(FULL, 2.5), (None, 5.5)], causes.BATTERY_STALE),
], ids=["full", "a_start_s_fall_of_two_seconds", "low_for_longer", "empty", "low_counts_from_the_first_below_its_limit",
        "falls_with_a_rise_between_them", "at_the_limit", "risen_by_less_than_recovery_once_the_car_stands",
        "risen_for_two_seconds_only", "risen_enough_for_the_stop_alone", "changed_for_a_full_one",
        "silent_for_its_timeout", "silent_for_longer"])
def test_limit_holds_after_more_than_two_seconds_beyond_it(story, cause):
    battery = Battery()
    assert [battery.has(*part) for part in story][-1] == cause
    assert battery.watch.is_empty == (cause == causes.BATTERY_EMPTY)


@pytest.mark.parametrize("bad, lasts_s, words", [
    *((odd, 0.5, f"battery_state's voltage is {odd:g}, none that a battery has") for odd in (NAN, INF, -INF, 0.0, -6)),
    pytest.param(None, 60.0, "battery_state silent for 10.00 s: the voltage isn't known", id="silence")])
def test_voltage_that_is_none_never_begins_a_stop_nor_ends_one_and_is_reported(bad, lasts_s, words):
    battery = Battery()
    battery.has(FULL if bad is None else bad, 0.5)
    cause = causes.BATTERY_STALE if bad is None else causes.BATTERY_NOT_FINITE
    assert battery.has(bad, 10.0) == cause and not battery.watch.is_empty
    battery.has(EMPTY, 2.0)
    battery.has(bad, lasts_s)
    battery.has(EMPTY, 2.0)
    assert not battery.watch.is_empty
    assert battery.has(EMPTY, 0.5) == causes.BATTERY_EMPTY
    assert battery.has(bad, 10.0) == causes.BATTERY_EMPTY
    assert battery.watch.status(battery.now).text == (
        f"the battery has 6.40 V after it fell below stop_below, 6.6 V: no planner drives before it has 7.1 V; {words}")


@pytest.mark.parametrize("config, cause", [(BatteryConfig(), WELL), (BatteryConfig(warn_below_v=7.0), WELL),
                                           (BatteryConfig(stop_below_v=6.6), causes.BATTERY_STALE)])
def test_voltage_that_never_came_is_reported_only_where_a_stop_waits_for_it(config, cause):
    status = Battery(config).watch.status(START)
    assert (status.cause, status.text.partition(":")[0]) == (cause, "battery_state was never heard")


def test_limits_of_0_are_off():
    battery = Battery(BatteryConfig())
    assert battery.has(0.01, 9.0) == WELL and battery.watch.status(battery.now) == ("", "0.01 V")


@pytest.mark.parametrize("voltages, silent_s, remedy", [
    ([FULL] * 6, 0, ""), ([LOW] * 6, 0, "Charge or change the battery"),
    ([EMPTY] * 6, 0, "Charge or change the battery"),
    ([math.nan] * 6, 0, SEE_WHO),
    ([FULL] * 6, 6, f"{SEE_WHO}, and whether it does so less often than battery/timeout")], ids=str)
def test_whatever_is_wrong_with_a_battery_has_a_remedy(voltages, silent_s, remedy):
    battery = Battery()
    for voltage in voltages:
        battery.has(voltage, 0.5)
    battery.has(None, silent_s)
    assert battery.watch.status(battery.now).remedy == remedy
