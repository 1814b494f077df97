"""When a guard acts: the node's silence or death, what it does then and in which order, and when it leaves."""
from __future__ import annotations

import errno

import pytest

from car_interface.pca9685.guard import ASSERT, CHECK, END, NOTHING, PROBE, SWITCH_OFF, Guard
from car_interface.pca9685.guard_protocol import (
    ACTING,
    ALIVE,
    ENDED,
    ENDING,
    NOT_TRIED,
    OFF,
    SAFE,
    WATCHING,
    NodeMessage,
    guard_reader,
)

MS = 1_000_000
S = 1000 * MS
NOW = 1000 * S
OFF_AFTER = 10 * S
COUNTS = (319, 307) + (0,) * 14
SILENCE_MS = 250


class Bench:
    """A guard, a clock, and the node's and the bus's part."""

    def __init__(self):
        self.guard = Guard(OFF_AFTER)
        self.now_ns = NOW
        self.sequence = 0

    def wait(self, ms):
        self.now_ns += round(ms * MS)

    def tell(self, acknowledged=0, has_reached=True, kind=ALIVE, counts=COUNTS):
        self.sequence += 1
        self.guard.receive(NodeMessage(kind, has_reached, self.sequence, acknowledged, counts).encode(), self.now_ns)

    def die(self):
        self.guard.receive(b"", self.now_ns)

    def action(self):
        return self.guard.action(self.now_ns)

    def do(self, *expected):
        """Do what the guard wants, at once or when it is due, as often as there are expectations."""
        for each in expected:
            self.now_ns = max(self.now_ns, int(self.guard.next_due_ns()))
            assert self.action() == each
            if each not in (NOTHING, END):
                self.guard.succeeded(each, self.now_ns)

    def fail(self, number=errno.EREMOTEIO):
        """Have the next action fail; how many ms later the guard tries again."""
        action = self.action()
        assert action not in (NOTHING, END)
        self.guard.failed(action, number, self.now_ns)
        waited_ns = self.guard.next_due_ns() - self.now_ns
        self.now_ns += waited_ns
        return waited_ns // MS

    @property
    def status(self):
        return guard_reader().feed(self.guard.status())[0]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def watching(bench):
    bench.tell()
    bench.do(PROBE)
    assert bench.action() == NOTHING
    return bench


def test_guard_before_the_first_sign_of_life_waits_and_ends_with_its_node(bench):
    assert bench.guard.next_due_ns() == float("inf")
    bench.wait(60_000)
    assert bench.action() == NOTHING
    bench.die()
    assert bench.action() == END


def test_guard_reaches_for_the_chip_once_while_the_node_lives_and_says_whether_it_could(bench):
    assert bench.status.error == NOT_TRIED
    bench.tell()
    assert bench.action() == PROBE
    bench.guard.failed(PROBE, errno.EACCES, bench.now_ns)
    assert bench.status.error == errno.EACCES
    for _ in range(19):
        bench.wait(50)
        bench.tell()
        assert bench.action() == NOTHING
    bench.wait(50)
    bench.tell()
    bench.do(PROBE)
    assert bench.action() == NOTHING
    assert bench.status.error == 0


def test_node_that_lives_is_left_alone(watching):
    for _ in range(1000):
        watching.wait(200)
        watching.tell()
        assert watching.action() == NOTHING
    assert watching.status.state == WATCHING


def test_node_silent_for_250_ms_is_overruled(watching):
    watching.wait(SILENCE_MS - 1)
    assert watching.action() == NOTHING
    assert watching.guard.next_due_ns() == watching.now_ns + MS
    watching.wait(1)
    assert watching.action() == ASSERT
    assert watching.guard.timeout_counts == COUNTS
    assert (watching.status.state, watching.status.interventions) == (ACTING, 1)


def test_node_whose_pipe_ends_is_overruled_at_once(watching):
    watching.wait(1)
    watching.die()
    assert watching.action() == ASSERT
    assert watching.guard.node_is_dead


def test_timeout_values_are_the_newest_that_the_node_sent(watching):
    watching.tell(counts=(325, *COUNTS[1:]))
    watching.die()
    assert watching.action() == ASSERT
    assert watching.guard.timeout_counts[0] == 325


def test_node_that_never_reached_a_chip_has_nothing_to_guard(bench):
    bench.tell(has_reached=False)
    assert bench.fail() == 1000  # the guard's own attempt
    bench.wait(10_000)
    assert bench.action() == PROBE
    bench.guard.failed(PROBE, errno.ENOENT, bench.now_ns)
    bench.die()
    assert bench.action() == END


def test_guard_claims_the_chip_once_its_node_has_reached_it(bench):
    bench.tell(has_reached=False)
    bench.do(PROBE)
    assert not bench.guard.node_has_reached
    bench.tell(has_reached=True)
    assert bench.action() == PROBE
    assert bench.guard.node_has_reached
    bench.guard.failed(PROBE, errno.ETIMEDOUT, bench.now_ns)
    bench.wait(200)
    bench.tell()
    assert bench.action() == NOTHING
    for _ in range(4):
        bench.wait(200)
        bench.tell()
    bench.do(PROBE)
    assert bench.action() == NOTHING


def test_chip_that_only_the_guard_has_reached_is_guarded(bench):
    bench.tell(has_reached=False)
    bench.do(PROBE)
    bench.die()
    assert bench.action() == ASSERT


def test_verified_timeout_values_are_read_back_every_50_ms(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    assert watching.status.state == SAFE
    for _ in range(10):
        before_ns = watching.now_ns
        watching.do(CHECK)
        assert watching.now_ns - before_ns == 50 * MS


def test_failed_attempts_are_repeated_after_20_ms_to_200_ms(watching):
    watching.die()
    assert [watching.fail() for _ in range(6)] == [20, 40, 80, 160, 200, 200]
    assert watching.status.error == errno.EREMOTEIO
    assert watching.status.state == ACTING
    watching.do(ASSERT)
    assert (watching.status.state, watching.status.error) == (SAFE, 0)


def test_error_without_a_number_is_an_io_error(watching):
    watching.die()
    watching.fail(None)
    assert watching.status.error == errno.EIO


def test_chip_that_is_lost_after_it_was_safe_is_written_anew(watching):
    watching.die()
    watching.do(ASSERT, CHECK)
    watching.wait(50)
    assert watching.fail() == 20
    assert watching.status.state == ACTING
    assert watching.action() == ASSERT


def test_everything_is_switched_off_when_nobody_has_taken_over(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    began_ns = watching.now_ns
    while watching.now_ns - began_ns < OFF_AFTER - 50 * MS:
        watching.do(CHECK)
    watching.do(SWITCH_OFF)
    assert OFF_AFTER <= watching.now_ns - began_ns <= OFF_AFTER + 50 * MS
    assert watching.status.state == OFF


def test_guard_of_a_dead_node_ends_after_full_off(watching):
    watching.die()
    watching.do(ASSERT)
    watching.wait(10_000)
    watching.do(SWITCH_OFF)
    assert watching.action() == END


def test_guard_of_a_frozen_node_stays_and_keeps_everything_off(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    watching.wait(10_000)
    watching.do(SWITCH_OFF, SWITCH_OFF, SWITCH_OFF)
    watching.die()
    assert watching.action() == END


def test_bus_that_comes_back_late_gets_neutral_for_100_ms_before_full_off(watching):
    watching.die()
    watching.fail(errno.ETIMEDOUT)
    watching.wait(30_000)
    watching.do(ASSERT)
    safe_ns = watching.now_ns
    watching.do(CHECK, SWITCH_OFF)
    assert watching.now_ns - safe_ns >= 100 * MS


def test_failed_full_off_is_repeated(watching):
    watching.die()
    watching.do(ASSERT)
    watching.wait(10_000)
    assert watching.fail() == 20
    assert watching.action() == SWITCH_OFF


def test_guard_of_a_dead_node_that_never_reaches_the_chip_gives_up_after_10_minutes(watching):
    watching.die()
    for _ in range(3):
        watching.fail()
    watching.now_ns = NOW + 599 * S
    assert watching.action() == ASSERT
    watching.wait(1001)
    assert watching.action() == END


def test_node_that_acknowledges_gets_the_chip_back(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    watching.wait(3000)
    watching.tell(acknowledged=1)
    assert watching.status.state == WATCHING
    assert watching.status.sequence == watching.sequence
    assert watching.action() == NOTHING
    watching.wait(SILENCE_MS)
    assert watching.action() == ASSERT
    assert watching.status.interventions == 2


@pytest.mark.parametrize("actions", [(), (ASSERT,), (ASSERT, CHECK)])
def test_sign_of_life_from_before_the_silence_is_no_acknowledgement(watching, actions):
    watching.wait(SILENCE_MS)
    assert watching.action() == ASSERT
    watching.do(*actions)
    watching.tell(acknowledged=0)
    assert watching.guard.is_acting
    assert watching.action() in (ASSERT, CHECK, NOTHING)
    assert watching.guard.next_due_ns() <= watching.now_ns + 50 * MS


def test_second_silence_is_not_acknowledged_by_the_first_ones_number(watching):
    for acknowledged in (1, 2):
        watching.wait(SILENCE_MS)
        watching.do(ASSERT)
        watching.tell(acknowledged=acknowledged - 1)
        assert watching.guard.is_acting
        watching.tell(acknowledged=acknowledged)
        assert not watching.guard.is_acting


def test_node_back_from_full_off_gets_the_chip_back(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    watching.wait(10_000)
    watching.do(SWITCH_OFF)
    watching.tell(acknowledged=1)
    assert watching.status.state == WATCHING


def test_node_that_ended_well_needs_no_guard(watching):
    watching.tell(kind=ENDED)
    watching.die()
    assert watching.action() == END


def test_node_that_shuts_down_may_take_5_s_as_long_as_it_lives(watching):
    watching.tell(kind=ENDING)
    watching.wait(4999)
    assert watching.action() == NOTHING
    watching.wait(1)
    assert watching.action() == ASSERT


def test_node_killed_while_it_shuts_down_is_overruled_at_once(watching):
    watching.tell(kind=ENDING)
    watching.wait(10)
    watching.die()
    assert watching.action() == ASSERT


def test_guard_ends_when_there_is_nothing_left_to_guard(watching):
    watching.die()
    assert watching.action() == ASSERT
    watching.guard.finish()
    assert watching.action() == END


def test_guard_that_was_held_up_itself_reads_before_it_judges(watching):
    watching.wait(5000)
    watching.tell()  # it waited in the pipe
    assert watching.action() == NOTHING


def test_guard_of_a_dead_node_tells_at_once_what_the_chip_holds(watching):
    assert not watching.guard.acts_alone(watching.now_ns)
    watching.die()
    watching.do(ASSERT)
    assert watching.guard.acts_alone(watching.now_ns)


def test_guard_of_a_frozen_node_tells_what_the_chip_holds_half_a_second_later(watching):
    watching.wait(SILENCE_MS)
    watching.do(ASSERT)
    acted_ns = watching.now_ns
    assert not watching.guard.acts_alone(acted_ns + 499 * MS)
    assert watching.guard.acts_alone(acted_ns + 500 * MS)
    watching.tell(acknowledged=1)
    assert not watching.guard.acts_alone(acted_ns + 500 * MS)


def lasting_ms(bench, silent_ms=20_000):
    """How long after it acted the guard of a node that is silent for so long tells what the chip holds."""
    bench.tell(acknowledged=bench.guard.interventions)
    bench.wait(SILENCE_MS)
    bench.do(ASSERT)
    acted_ns = bench.now_ns
    found = next(ms for ms in range(0, 20_000, 250) if bench.guard.acts_alone(acted_ns + ms * MS))
    bench.wait(silent_ms)
    bench.tell(acknowledged=bench.guard.interventions)
    return found


def test_guard_of_a_node_that_comes_back_again_and_again_waits_longer_each_time(watching):
    assert [lasting_ms(watching) for _ in range(6)] == [500, 1000, 2000, 4000, 8000, 8000]


def test_short_silences_change_nothing_about_that(watching):
    assert [lasting_ms(watching, 400) for _ in range(3)] == [500, 500, 500]


@pytest.mark.parametrize("steady_s, expected_ms", [(59, 2000), (60, 500)])
def test_guard_of_a_node_that_was_steady_for_a_minute_tells_as_soon_as_at_first(watching, steady_s, expected_ms):
    lasting_ms(watching), lasting_ms(watching)
    for _ in range(10 * steady_s - 2):
        watching.wait(100)
        watching.tell()
    assert lasting_ms(watching) == expected_ms


def test_guard_tells_at_once_when_a_node_dies_that_had_come_back(watching):
    lasting_ms(watching), lasting_ms(watching)
    watching.die()
    watching.do(ASSERT)
    assert watching.guard.acts_alone(watching.now_ns)
