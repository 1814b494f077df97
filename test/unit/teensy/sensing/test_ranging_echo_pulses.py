"""How long an echo pulse lasted, by the time since the report before: 16 bits of µs have no more than 65.5 ms."""

import pytest

from car_interface.teensy.sensing.ranging import EchoPulses

WALL_US, NONE_US, CLONE_US = 5_810, 37_987, 199_987
FAILED_MS = 29.443  # of a sonar that does not answer


class Reports:
    """Reports in the firmware's rhythm."""

    def __init__(self, wait_ms=50, begins_ms=300.0, first_us=WALL_US):
        self.pulses, self.wait_ms, self.known_wait_ms = EchoPulses(), wait_ms, wait_ms
        self._now_ms = begins_ms
        self.first = self._report(first_us)

    def next(self, *echoes_us, failed=0):
        """The lengths that are found of echoes, each after so many failed pings."""
        found = []
        for echo_us in echoes_us:
            self._now_ms += self.wait_ms + 1.2 + failed * FAILED_MS
            found.append(self._report(echo_us))
        return found

    def _report(self, echo_us):
        self._now_ms += echo_us / 1000
        return self.pulses.unwrap_us(echo_us % 2 ** 16, int(self._now_ms) % 2 ** 32, self.known_wait_ms)


@pytest.mark.parametrize("echo_us", [1, WALL_US, NONE_US, 65_000, 66_000, 131_500, CLONE_US, 1_234_567, 2_000_000])
@pytest.mark.parametrize("wait_ms", [0, 50, 1000])
def test_length_is_found_of_any_echo_whoever_did_not_answer_before(echo_us, wait_ms):
    for failed in range(6):
        reports = Reports(wait_ms)
        assert reports.next(WALL_US, NONE_US, WALL_US) == [WALL_US, NONE_US, WALL_US]
        found = reports.next(echo_us, failed=failed)[0]
        # Two grids of 29.4 and 65.5 ms: a pulse of seconds has more than one length, of which none is short.
        assert found == echo_us or echo_us > 10 ** 6 and found > 10 ** 6, failed
        assert reports.next(WALL_US) == [WALL_US]


def test_all_clones_and_no_wall_anywhere_are_no_longer_wait():
    reports = Reports(first_us=CLONE_US)
    assert reports.first is None
    assert set(reports.next(*[CLONE_US] * 20)) == {CLONE_US}


@pytest.mark.parametrize("wait_ms", [47, 200])
def test_wait_that_nobody_told_is_noticed_after_a_round(wait_ms):
    reports = Reports(wait_ms)
    reports.known_wait_ms = 50
    assert reports.next(*[WALL_US] * 20)[8:] == [WALL_US] * 12
    assert reports.next(CLONE_US, WALL_US, 70_000, WALL_US) == [CLONE_US, WALL_US, 70_000, WALL_US]


def test_two_reports_of_eight_without_a_failed_ping_before_show_the_wait():
    reports = Reports()
    reports.next(*[WALL_US] * 5, failed=1)
    assert reports.next(WALL_US, WALL_US, CLONE_US) == [WALL_US, WALL_US, CLONE_US]


def test_teensy_that_has_rebooted_waits_as_one_that_boots():
    reports = Reports(wait_ms=200)
    reports.next(*[WALL_US] * 8)
    reports.pulses.restart()
    reports.wait_ms, reports.known_wait_ms, reports._now_ms = 50, 50, 300.0
    assert reports.next(WALL_US, CLONE_US) == [WALL_US, CLONE_US]


@pytest.mark.parametrize("echo_us, soon_us, in_the_end_us", [
    (5_965, 5_965, 5_965), (5_964, 71_500, 71_500), (464, 66_000, 66_000), (463, None, 463)],
    ids=["too_early", "earliest_wrap", "latest_wrap", "no_wrap_but_another_wait"])
def test_report_is_of_a_longer_echo_from_2_5_ms_before_until_3_ms_after_what_a_wrap_takes(
        echo_us, soon_us, in_the_end_us):
    """A report every 120 ms, 50 + 1 of which are waited: beside a wrap, 65.536 ms, there is room for 3.464 ms."""
    pulses = EchoPulses()
    found = [pulses.unwrap_us(echo_us, tick, 50) for tick in range(300, 1500, 120)]
    assert found[1:] == [soon_us] * 7 + [in_the_end_us] * 2, "eight reports show the wait"


# The first ping is at 300 ms: no pulse that has ended 65.536 ms later has wrapped.
@pytest.mark.parametrize("begins_ms, is_known", [
    (300, True), (359.5, True), (360.2, False), (5000, False), (2 ** 32 - 100, False)])
def test_first_length_is_known_of_a_teensy_that_boots_and_unknown_of_one_that_runs(begins_ms, is_known):
    reports = Reports(begins_ms=begins_ms)
    assert reports.first == (WALL_US if is_known else None)
    assert reports.next(WALL_US, CLONE_US, WALL_US) == [WALL_US, CLONE_US, WALL_US]


def test_lost_report_leaves_one_length_unknown_unless_a_wall_was_near():
    near, far = Reports(), Reports()
    for reports, lost_us, found in ((near, WALL_US, WALL_US), (far, 20_000, None)):
        assert reports.next(WALL_US) == [WALL_US]
        reports._now_ms += 50 + 1.2 + lost_us / 1000
        assert reports.next(WALL_US, WALL_US) == [found, WALL_US]


@pytest.mark.parametrize("late_ms", [5, 1000])
def test_report_that_leaves_after_the_next_one_keeps_its_length(late_ms):
    pulses, wait_ms = EchoPulses(), late_ms + 5
    reports = (569, 301), (2025, 309 + late_ms), (1734, 309), (569, 316 + 2 * late_ms)
    assert [pulses.unwrap_us(echo, tick, wait_ms) for echo, tick in reports] == [569, 2025, 1734, 569]


def test_report_from_more_than_a_second_ago_is_of_a_teensy_whose_clock_goes_on_from_there():
    reports = Reports(begins_ms=5000)
    reports._now_ms -= 1500
    reports.next(WALL_US)
    assert reports.next(CLONE_US, WALL_US) == [CLONE_US, WALL_US]
