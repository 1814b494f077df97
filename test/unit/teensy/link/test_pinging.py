"""Pings, their pongs, and which checksum to send them with. Time is passed in; the bytes are spelled out by hand."""

import pytest

from car_interface.teensy.link.framing import CORRECTED, SHIPPED
from car_interface.teensy.link.pinging import AUTO, Answer, Pinger

S = 1_000_000_000
MS = 1_000_000
NOW = 100 * S
GIVE_UP = S // 2
FILLER = bytes(39)
QUICK, QUICK_PINGS = 200 * MS, 5
DITHER_NS = 10 * MS
TICK = MS

# A timestamp whose frame carries, so that the two checksums differ: 4 + 4·ff = 400 (hex).
CARRIES = 0xffffffff
SHIPPED_FRAME = bytes.fromhex("7e 02010100 ffffffff 00000000 ff 7e")
CORRECTED_FRAME = bytes.fromhex("7e 02010100 ffffffff 00000000 fb 7e")


def pinger(checksum=AUTO, period_ns=S):
    return Pinger(period_ns, checksum, NOW)


def is_planned_for(pings, at_ns):
    """Whether the next ping is due then, but for the dither."""
    return at_ns <= pings.due_ns < at_ns + DITHER_NS


def keep_pinging(pings, count, answered=True):
    """Send each ping when it's due; when that was."""
    sent_ns = []
    for number in range(count):
        sent_ns.append(pings.due_ns)
        pings.ping(number, pings.due_ns)
        if answered:
            pings.pong(number, sent_ns[-1] + MS)
    return sent_ns


def go_unanswered(pings, count, now_ns=NOW):
    """Send pings and let each wait too long; the time after the last."""
    for number in range(count):
        pings.ping(1000 + number, now_ns)
        now_ns += GIVE_UP
        assert pings.expire(now_ns) == [1000 + number]
    return now_ns


@pytest.mark.parametrize("sent_ms, due_ms", [
    ((0,), 1000), ((300,), 1000), ((0, 400), 1000), ((1000,), 2000), ((3500,), 4500),
], ids=["on_time", "late", "one_in_between", "a_period_late", "later"])
def test_ping_goes_without_filler_and_the_next_is_due_on_the_period_s_grid_unless_one_was_missed(sent_ms, due_ms):
    pings = pinger()
    assert pings.due_ns == pings.next_event_ns() == NOW
    assert {pings.ping(CARRIES, NOW + ms * MS) for ms in sent_ms} == {SHIPPED_FRAME}
    assert pings.expire(NOW + 100 * MS) == []
    assert is_planned_for(pings, NOW + due_ms * MS) and pings.sent == len(sent_ms)


def test_pings_that_are_answered_come_five_times_as_fast_at_first_and_when_something_happened():
    pings = pinger()
    for _ in range(2):
        sent_ns = keep_pinging(pings, 20)
        gaps_ns = [later - earlier for earlier, later in zip(sent_ns, sent_ns[1:])]
        assert gaps_ns[:QUICK_PINGS] == [pytest.approx(QUICK, abs=2 * DITHER_NS)] * QUICK_PINGS
        assert gaps_ns[QUICK_PINGS:] == [pytest.approx(S, abs=2 * DITHER_NS)] * (19 - QUICK_PINGS)
        pings.retry_now()


@pytest.mark.parametrize("period_ms, quick_ms", [(20, 20), (300, 200), (1000, 200), (60_000, 12_000)])
def test_quick_pings_are_not_quicker_than_makes_sense_for_their_period(period_ms, quick_ms):
    pings = pinger(period_ns=period_ms * MS)
    pings.ping(1, NOW)
    pings.pong(1, NOW)
    assert is_planned_for(pings, NOW + quick_ms * MS)


@pytest.mark.parametrize("period_ms", [10, 20, 1000])
def test_any_twenty_pings_in_a_row_meet_the_tick_at_phases_all_over_it(period_ms):
    """The largest hole between two of them is less than a quarter of the tick; 20 at even distances leave 1/20."""
    pings = pinger(period_ns=period_ms * MS)
    sent_ns = keep_pinging(pings, 400, answered=False)
    for start in range(380):
        phases = sorted(at_ns % TICK for at_ns in sent_ns[start:start + 20])
        holes = [later - earlier for earlier, later in zip(phases, [*phases[1:], phases[0] + TICK])]
        assert max(holes) < TICK / 4
    assert sent_ns[-1] - sent_ns[0] == pytest.approx(399 * period_ms * MS, abs=DITHER_NS)


def test_pong_answers_its_ping_once_with_the_time_it_was_sent_and_the_round_trip():
    pings = pinger()
    pings.ping(7, NOW)
    pings.ping(8, NOW + 3 * MS)
    pings.ping(7, NOW + 4 * MS)  # of the same millisecond: answered from the first
    assert pings.pong(8, NOW + 5 * MS) == Answer(sent_ns=NOW + 3 * MS, round_trip_ns=2 * MS, sent_bytes=15)
    assert pings.pong(7, NOW + 6 * MS) == Answer(sent_ns=NOW, round_trip_ns=6 * MS, sent_bytes=15)
    assert [pings.pong(timestamp, NOW + 6 * MS) for timestamp in (7, 9, 0, 2 ** 32 - 1)] == [None] * 4
    assert (pings.sent, pings.answered) == (3, 2)


def test_ping_unanswered_for_half_a_second_is_given_up_and_the_next_go_at_once_behind_filler_until_one_is_answered():
    pings = pinger()
    pings.ping(7, NOW)
    assert pings.next_event_ns() == NOW + GIVE_UP
    assert pings.expire(NOW + GIVE_UP - 1) == []
    assert pings.expire(NOW + GIVE_UP) == [7]
    assert (pings.unanswered_in_a_row, pings.pong(7, NOW + GIVE_UP + 1)) == (1, None)
    after = go_unanswered(pings, 2, NOW + GIVE_UP)
    assert (pings.due_ns, pings.resyncs) == (after, 2)
    assert pings.ping(CARRIES, after) == FILLER + SHIPPED_FRAME
    assert pings.pong(CARRIES, after + MS).sent_bytes == 39 + 15
    assert (pings.unanswered_in_a_row, pings.resyncs) == (0, 3)
    assert pings.ping(CARRIES, after + S) == SHIPPED_FRAME


def test_five_pings_unanswered_in_a_row_switch_to_the_other_checksum_and_five_more_back():
    pings = pinger()
    after = go_unanswered(pings, 4)
    assert pings.checksum == SHIPPED
    after = go_unanswered(pings, 1, after)
    assert pings.checksum == CORRECTED
    pings.restart(after)  # the line was opened anew: what was found out is kept
    assert pings.ping(CARRIES, after) == CORRECTED_FRAME
    assert pings.pong(CARRIES, after + MS) is not None
    after = go_unanswered(pings, 4, after)
    assert pings.checksum == CORRECTED
    after = go_unanswered(pings, 1, after)
    assert pings.checksum == SHIPPED
    after = go_unanswered(pings, 4, after)
    assert pings.checksum == SHIPPED, "each has five again"
    go_unanswered(pings, 1, after)
    assert pings.checksum == CORRECTED


@pytest.mark.parametrize("answered", [True, False], ids=["an_answer", "a_new_opening"])
def test_pings_unanswered_with_an_answer_or_a_new_opening_between_do_not_switch(answered):
    pings = pinger()
    after = go_unanswered(pings, 4)
    pings.ping(1, after)
    if answered:
        pings.pong(1, after + MS)
    else:
        pings.restart(after + MS)
    go_unanswered(pings, 4, after + S)
    assert pings.checksum == SHIPPED


@pytest.mark.parametrize("checksum, frame", [(SHIPPED, SHIPPED_FRAME), (CORRECTED, CORRECTED_FRAME)])
def test_checksum_that_was_chosen_is_kept_however_many_go_unanswered(checksum, frame):
    pings = pinger(checksum)
    after = go_unanswered(pings, 12)
    assert pings.checksum == checksum
    assert pings.ping(CARRIES, after) == FILLER + frame


def test_pings_lie_within_their_periods_at_the_fractions_of_the_golden_section():
    """Multiples of 0.618034, modulo 1, of a tenth of the period."""
    pings = pinger(period_ns=50 * MS)
    due_ns = keep_pinging(pings, 4, answered=False)
    assert [round((at_ns - NOW) / MS, 3) for at_ns in due_ns] == [0.0, 53.090, 101.180, 154.271]
