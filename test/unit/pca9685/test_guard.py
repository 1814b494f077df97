"""When a guard acts: the node's silence or death, what it does then and in which order, and when it leaves."""

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
    WAITING,
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
    def __init__(self):
        self.guard = Guard(OFF_AFTER)
        self.now_ns = NOW
        self.sequence = 0

    def wait(self, ms):
        self.now_ns += round(ms * MS)

    def tell(self, acknowledged=0, has_reached=True, kind=ALIVE, counts=COUNTS):
        self.sequence += 1
        self.guard.receive(NodeMessage(kind, has_reached, self.sequence, acknowledged, counts).encode(), self.now_ns)

    def live(self, ms):
        """Pass time with a node that lives: what the guard does, asked every 50 ms."""
        actions = []
        for _ in range(0, ms, 50):
            self.wait(50)
            self.tell()
            actions.append(self.action())
        return actions

    def die(self):
        self.guard.receive(b"", self.now_ns)

    def action(self):
        return self.guard.action(self.now_ns)

    def do(self, *expected):
        """Do what the guard wants, at once or when it is due, as often as there are expectations; wait for numbers."""
        for each in expected:
            if isinstance(each, int):
                self.wait(each)
                continue
            self.now_ns = max(self.now_ns, int(self.guard.next_due_ns()))
            assert self.action() == each
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


def test_guard_reaches_for_the_chip_every_second_until_it_could_and_tells_the_node(bench):
    assert bench.status.error == NOT_TRIED
    bench.tell()
    assert bench.action() == PROBE
    bench.guard.failed(PROBE, errno.EACCES, bench.now_ns)
    assert bench.status.error == errno.EACCES
    assert bench.live(1000) == [NOTHING] * 19 + [PROBE]
    bench.do(PROBE)
    assert (bench.action(), bench.status.error) == (NOTHING, 0)


def test_node_that_lives_is_left_alone(watching):
    assert watching.live(20_000) == [NOTHING] * 400
    watching.wait(5000)
    watching.tell()  # it waited in the pipe while the guard was held up itself
    assert watching.action() == NOTHING
    assert (watching.status.state, watching.status.sequence) == (WATCHING, watching.sequence)


def test_node_silent_for_250_ms_is_overruled(watching):
    watching.wait(SILENCE_MS - 1)
    assert watching.action() == NOTHING
    assert watching.guard.next_due_ns() == watching.now_ns + MS
    watching.wait(1)
    assert watching.action() == ASSERT
    assert watching.guard.timeout_counts == COUNTS
    assert (watching.status.state, watching.status.interventions) == (ACTING, 1)


def test_node_whose_pipe_ends_is_overruled_at_once_with_its_newest_timeout_values(watching):
    watching.wait(1)
    watching.tell(counts=(325, *COUNTS[1:]))
    watching.die()
    assert watching.action() == ASSERT
    assert watching.guard.node_is_dead and watching.guard.timeout_counts[0] == 325


def test_guard_waits_for_its_node_s_first_message_for_ever(bench):
    assert bench.guard.next_due_ns() == float("inf")
    assert bench.status == (WAITING, 0, 0, NOT_TRIED) and bench.guard.timeout_counts == (0,) * 16


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
    assert bench.live(1000) == [NOTHING] * 19 + [PROBE]
    bench.do(PROBE)
    assert bench.action() == NOTHING


@pytest.mark.parametrize("reached_by", ["guard", "node"])
def test_chip_that_only_one_of_them_has_reached_is_guarded(bench, reached_by):
    bench.tell(has_reached=reached_by == "node")
    if reached_by == "guard":
        bench.do(PROBE)
    bench.die()
    assert bench.action() == ASSERT


def test_guard_of_a_frozen_node_holds_the_timeout_values_for_10_s_and_then_keeps_everything_off(watching):
    watching.do(SILENCE_MS, ASSERT)
    assert watching.status.state == SAFE
    began_ns = watching.now_ns
    for step in range(1, 200):
        watching.do(CHECK)
        assert watching.now_ns == began_ns + 50 * step * MS
    watching.do(SWITCH_OFF)
    assert watching.now_ns == began_ns + OFF_AFTER and watching.status.state == OFF
    watching.do(SWITCH_OFF, SWITCH_OFF)
    assert watching.now_ns == began_ns + OFF_AFTER + S
    watching.die()
    assert watching.action() == END


def test_failed_attempts_are_repeated_after_20_ms_to_200_ms_and_a_chip_that_is_lost_again_is_written_anew(watching):
    watching.die()
    assert [watching.fail() for _ in range(6)] == [20, 40, 80, 160, 200, 200]
    assert (watching.status.state, watching.status.error) == (ACTING, errno.EREMOTEIO)
    watching.do(ASSERT, CHECK)
    assert (watching.status.state, watching.status.error) == (SAFE, 0)
    watching.wait(50)
    assert watching.fail(None) == 20
    assert (watching.status.state, watching.status.error) == (ACTING, errno.EIO)
    assert watching.action() == ASSERT


def test_guard_probes_a_chip_that_failed_as_soon_as_its_node_is_back_and_begins_with_short_retries_again(watching):
    watching.wait(SILENCE_MS)
    assert [watching.fail() for _ in range(4)] == [20, 40, 80, 160]
    watching.wait(-150)
    watching.tell(acknowledged=1)
    assert watching.fail() == 250  # of the probe: then the node is silent again
    assert watching.fail() == 20


def test_guard_of_a_dead_node_repeats_a_failed_full_off_and_ends_after_it(watching):
    watching.die()
    watching.do(ASSERT, 10_000)
    assert watching.fail() == 20
    watching.do(SWITCH_OFF)
    assert watching.action() == END


def test_bus_that_comes_back_late_gets_neutral_for_100_ms_before_full_off(watching):
    watching.die()
    watching.fail(errno.ETIMEDOUT)
    watching.do(30_000, ASSERT)
    safe_ns = watching.now_ns
    watching.do(CHECK, SWITCH_OFF)
    assert watching.now_ns - safe_ns == 100 * MS


def test_guard_of_a_dead_node_that_never_reaches_the_chip_gives_up_after_10_minutes(watching):
    watching.die()
    watching.fail()
    watching.now_ns = NOW + 600 * S - 1
    assert watching.action() == ASSERT
    watching.now_ns += 1
    assert watching.action() == END


@pytest.mark.parametrize("actions", [(), (ASSERT,), (ASSERT, CHECK), (ASSERT, 10_000, SWITCH_OFF)],
                         ids=["acting", "safe", "checked", "off"])
def test_node_gets_the_chip_back_by_acknowledging_the_newest_intervention(watching, actions):
    for number in (1, 2):
        watching.wait(SILENCE_MS)
        assert watching.action() == ASSERT
        watching.do(*actions)
        watching.tell(acknowledged=number - 1)  # written before the silence
        assert watching.guard.is_acting and watching.status.interventions == number
        watching.tell(acknowledged=number)
        assert watching.status.state == WATCHING and watching.action() == NOTHING


@pytest.mark.parametrize("kind, silent_ms, dies, action", [
    (ENDED, 0, True, END), (ENDING, 4999, False, NOTHING), (ENDING, 5000, False, ASSERT), (ENDING, 10, True, ASSERT)])
def test_node_that_shuts_down_may_take_5_s_as_long_as_it_lives_and_needs_no_guard_once_it_ended_well(
        watching, kind, silent_ms, dies, action):
    watching.tell(kind=kind)
    watching.wait(silent_ms)
    if dies:
        watching.die()
    assert watching.action() == action


def test_guard_ends_when_there_is_nothing_left_to_guard(watching):
    watching.die()
    assert watching.action() == ASSERT
    watching.guard.finish()
    assert watching.action() == END


def lasting_ms(bench, silent_ms=20_000):
    """How long after it acted the guard of a node that is silent for so long tells what the chip holds."""
    bench.tell(acknowledged=bench.guard.interventions)
    bench.do(SILENCE_MS, ASSERT)
    acted_ns = bench.now_ns
    found = next(ms for ms in range(0, 20_000, 250) if bench.guard.acts_alone(acted_ns + ms * MS))
    assert not bench.guard.acts_alone(acted_ns + found * MS - 1)
    bench.wait(silent_ms)
    bench.tell(acknowledged=bench.guard.interventions)
    assert not bench.guard.acts_alone(bench.now_ns)
    return found


def test_guard_of_a_node_that_comes_back_again_and_again_waits_longer_each_time_but_not_for_a_dead_one(watching):
    assert [lasting_ms(watching, 400) for _ in range(3)] == [500, 500, 500]  # short silences change nothing
    assert [lasting_ms(watching) for _ in range(6)] == [500, 1000, 2000, 4000, 8000, 8000]
    watching.die()
    watching.do(ASSERT)
    assert watching.guard.acts_alone(watching.now_ns)


@pytest.mark.parametrize("steady_ms, expected_ms", [(60_000 - SILENCE_MS - 50, 2000), (60_000 - SILENCE_MS, 500)])
def test_guard_of_a_node_that_was_steady_for_a_minute_tells_as_soon_as_at_first(watching, steady_ms, expected_ms):
    lasting_ms(watching), lasting_ms(watching)
    watching.live(steady_ms)
    assert lasting_ms(watching) == expected_ms
