"""What a node knows of its guard, and when it may obey commands again after it stood still."""

import errno

import pytest

from car_interface.pca9685.guard_protocol import ACTING, ALIVE, NOT_TRIED, SAFE, WATCHING, GuardMessage, node_reader
from car_interface.pca9685.guard_watch import GuardWatch

MS = 1_000_000
NOW = 1000_000 * MS
COUNTS = (319, 307) + (0,) * 14


class Bench:
    def __init__(self):
        self.watch = GuardWatch()
        self.now_ns = NOW
        self.sent = node_reader()
        self.newest = None

    def wait(self, ms):
        self.now_ns += round(ms * MS)

    def live(self, ms=0):
        self.wait(ms)
        self.newest, = self.sent.feed(self.watch.sign_of_life(self.now_ns, COUNTS, True))
        return self.newest

    def hangs_after(self, ms):
        """Say whether the guard hangs from a moment after that on."""
        self.wait(ms)
        hung = self.watch.hangs(self.now_ns)
        self.wait(0.001)
        return not hung and self.watch.hangs(self.now_ns)

    def answer(self, state=WATCHING, interventions=0, error=0, sequence=None):
        sequence = self.newest.sequence if sequence is None else sequence
        self.watch.receive(GuardMessage(state, sequence, interventions, error).encode(), self.now_ns)


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def watched(bench):
    bench.watch.start(bench.now_ns)
    bench.live()
    bench.answer()
    assert bench.watch.watches and not bench.watch.holds
    return bench


def test_node_without_a_guard_obeys(bench):
    assert not (bench.watch.is_present or bench.watch.watches or bench.watch.holds)
    assert bench.watch.error == NOT_TRIED
    assert bench.live().acknowledged == 0
    bench.wait(1000)
    assert bench.watch.stood_still_ns(bench.now_ns) == 1000 * MS
    assert not (bench.watch.holds or bench.watch.watches)


def test_node_that_had_not_reached_its_chip_before_did_not_stand_still(bench):
    assert bench.watch.due_ns <= bench.now_ns
    for _ in range(2):
        assert bench.watch.stood_still_ns(bench.now_ns) == 0 and not bench.watch.is_late(bench.now_ns)
        bench.watch.sign_of_life(bench.now_ns, COUNTS, False)
        bench.wait(5000)  # it waited for the chip


def test_signs_of_life_are_due_every_50_ms_and_carry_the_timeout_values(watched):
    assert watched.watch.due_ns == watched.now_ns + 50 * MS
    message = watched.live(50)
    assert (message.kind, message.has_reached, message.timeout_counts) == (ALIVE, True, COUNTS)
    assert (message.sequence, message.acknowledged) == (2, 0)


def test_guard_that_does_not_answer_for_400_ms_hangs(watched):
    for _ in range(10):
        watched.live(50)
        watched.answer()
        assert not watched.watch.was_overruled() and watched.watch.stood_still_ns(watched.now_ns) == 0
    for _ in range(8):
        watched.live(50)
    assert watched.hangs_after(0)


@pytest.mark.parametrize("state, error", [
    (None, 0), (WATCHING, NOT_TRIED), (WATCHING, errno.ETIMEDOUT), (ACTING, 0), (SAFE, 0)])
def test_guard_that_starts_or_may_wait_for_a_held_bus_has_3_s(watched, state, error):
    if state is None:
        watched.watch.start(watched.now_ns)
        assert not watched.watch.watches
    else:
        watched.answer(state, error=error)
        assert watched.watch.watches == (state == WATCHING) and watched.watch.error == error
    assert watched.hangs_after(3000)


def test_node_that_stood_still_for_250_ms_knows_it(watched):
    watched.wait(249)
    assert not watched.watch.is_late(watched.now_ns)
    assert watched.watch.stood_still_ns(watched.now_ns) == 0
    watched.wait(1)
    assert watched.watch.is_late(watched.now_ns)
    assert watched.watch.stood_still_ns(watched.now_ns) == 250 * MS
    watched.live()
    assert watched.watch.stood_still_ns(watched.now_ns) == 0


def test_node_that_stood_still_obeys_when_the_guard_has_answered_a_newer_sign_of_life(watched):
    watched.wait(3000)
    watched.answer(SAFE, interventions=1)  # what waited in the pipe
    assert watched.watch.stood_still_ns(watched.now_ns)
    assert watched.watch.holds
    assert watched.live().acknowledged == 1
    watched.answer(SAFE, interventions=1, sequence=1)
    assert watched.watch.holds
    watched.answer(WATCHING, interventions=1, sequence=1)  # the guard hadn't read the newer sign
    assert watched.watch.holds
    watched.answer(WATCHING, interventions=1)
    assert not watched.watch.holds
    assert watched.watch.interventions == 1


def test_node_that_stood_still_does_not_take_its_guard_for_dead(watched):
    watched.wait(3000)
    assert watched.watch.stood_still_ns(watched.now_ns)
    assert watched.hangs_after(400)


def test_node_learns_that_it_was_overruled_though_it_did_not_notice_that_it_stood_still(watched):
    watched.live(240)
    watched.answer(ACTING, interventions=1)
    assert watched.watch.was_overruled()
    assert not watched.watch.was_overruled()
    assert watched.watch.holds
    watched.live()
    watched.answer(WATCHING, interventions=1)
    assert not watched.watch.holds


def test_node_that_was_overruled_before_its_first_sign_of_life_waits_for_the_answer_to_it(bench):
    bench.watch.start(bench.now_ns)
    bench.answer(ACTING, interventions=1, sequence=0)
    assert bench.watch.was_overruled() and bench.watch.holds
    bench.live()
    bench.answer(interventions=1)
    assert not bench.watch.holds


def test_half_a_message_of_a_guard_that_was_lost_is_no_part_of_the_next_one_s(watched):
    watched.watch.receive(b"\x03", watched.now_ns)
    watched.watch.lose()
    watched.watch.start(watched.now_ns)
    watched.answer()
    assert watched.watch.watches


def test_node_whose_guard_is_lost_obeys_and_a_new_guard_begins_anew(watched):
    watched.answer(ACTING, interventions=2, error=errno.EIO)
    watched.wait(300)
    assert watched.watch.stood_still_ns(watched.now_ns)
    watched.watch.lose()
    assert not (watched.watch.holds or watched.watch.watches)
    assert not watched.watch.hangs(watched.now_ns + 10_000 * MS)
    watched.watch.start(watched.now_ns)
    assert not watched.watch.holds and not watched.watch.was_overruled()
    assert watched.watch.error == NOT_TRIED
    assert watched.live().acknowledged == 0
    watched.answer(ACTING, interventions=1)
    assert watched.watch.interventions == 3
