"""What is wrong with the link, from counters alone. Time is passed in; a second's counters are spelled out."""

import pytest

from car_interface.teensy.link import health
from car_interface.teensy.link.health import ERROR, FINE, OK, WAITING, WARN, Counts, LinkHealth

MS, S = 1_000_000, 1_000_000_000
NOW = 100 * S


def a_second_of(bytes_in=0, records=0, bad_frames=0, bad_checksums=None, pings_in_vain=0):
    """What one second adds to the counters; the pings in vain are as they stand."""
    return Counts(bytes_in, records, bad_frames, bad_frames if bad_checksums is None else bad_checksums, pings_in_vain)


GOOD = a_second_of(bytes_in=600, records=21)
STANDING = a_second_of(bytes_in=190, records=5)  # sonars off: a wheel report every 200 ms is all
NOTHING = a_second_of()
OTHER_BAUD = a_second_of(bytes_in=1200, bad_frames=3, bad_checksums=1)
FLOOD = a_second_of(bytes_in=1_000_000, records=2, bad_frames=4000, bad_checksums=450)
FLAGLESS = a_second_of(bytes_in=11_520)
OTHER_CHECKSUM = a_second_of(bytes_in=600, bad_frames=21)
NOISY = a_second_of(bytes_in=600, records=20, bad_frames=1)
VERY_NOISY = a_second_of(bytes_in=600, records=5, bad_frames=16, pings_in_vain=5)
UNANSWERED = a_second_of(bytes_in=600, records=21, pings_in_vain=3)
UNANSWERED_AND_NOISY = a_second_of(bytes_in=600, records=17, bad_frames=4, pings_in_vain=9)


class Link:
    """A link over which seconds pass."""

    def __init__(self):
        self.health = LinkHealth(115200)
        self.now_ns = NOW
        self.counts = Counts(0, 0, 0, 0, 0)
        self.open()

    def open(self):
        self.health.opened(self.counts, self.now_ns)

    def live(self, *seconds):
        return [self.second(second).state for second in seconds]

    def second(self, added):
        self.now_ns += S
        sums = [have + more for have, more in zip(self.counts[:4], added[:4])]
        self.counts = Counts(*sums, added.pings_in_vain)
        return self.health.judge(self.counts, self.now_ns)


@pytest.fixture
def link():
    return Link()


@pytest.fixture
def good_link():
    link = Link()
    link.live(GOOD)
    return link


def test_link_is_bad_before_its_port_is_opened_then_waited_for_and_fine_with_its_first_good_second(link):
    assert (LinkHealth(115200).verdict.state, LinkHealth(115200).verdict.level) == (health.ABSENT, ERROR)
    assert (link.health.verdict.state, link.health.verdict.level) == (WAITING, WARN)
    assert link.second(GOOD) == (FINE, OK, "fine: 21 frames a second", "")


def test_port_that_fails_is_told_at_once_in_the_port_s_own_words_and_judged_anew_once_it_is_open(good_link):
    good_link.live(NOTHING, NOTHING)
    good_link.health.port_failed(health.BUSY, "another program has it open", "See which one")
    assert good_link.health.verdict == (health.BUSY, ERROR, "another program has it open", "See which one")
    assert good_link.live(GOOD, GOOD) == [health.BUSY, health.BUSY]
    good_link.open()
    assert good_link.health.verdict.state == WAITING
    assert good_link.live(GOOD) == [FINE]


@pytest.mark.parametrize("second, state, level, words, next_step", [
    (NOTHING, health.SILENT, ERROR, "open, but nothing comes", "TX leads to this port's RX"),
    (OTHER_BAUD, health.NO_FRAMES, ERROR, "1200 bytes a second come, but no frames", "~baud 115200"),
    (FLAGLESS, health.NO_FRAMES, ERROR, "11520 bytes a second come, but no frames", "~baud"),
    (FLOOD, health.NO_FRAMES, ERROR, "more than 115200 baud can carry", "Is it a Teensy at all"),
    (OTHER_CHECKSUM, health.BAD_CHECKSUMS, ERROR, "the checksum of almost none of them is right", "cable"),
    (VERY_NOISY, health.BAD_CHECKSUMS, ERROR, "76 % of them are corrupt", "cable"),
    (UNANSWERED, health.NO_PONGS, WARN, "none of the last 3 pings was answered", "~firmware_checksum"),
    (UNANSWERED_AND_NOISY, health.NO_PONGS, WARN, "none of the last 9 pings", "~firmware_checksum"),
], ids=["silent", "other_baud_rate", "no_flag_at_all", "flood", "frames_none_of_which_sums_up",
        "more_noise_than_frames", "no_pongs", "no_pongs_and_a_little_noise"])
def test_fault_of_an_open_port_is_told_in_words_with_the_next_step(link, second, state, level, words, next_step):
    assert link.live(second, second) == [WAITING, state]
    verdict = link.second(second)
    assert (verdict.state, verdict.level) == (state, level)
    assert words in verdict.description
    assert next_step in verdict.next_step


HALF = a_second_of(bytes_in=1000, records=10, bad_frames=5)  # a fault begins or ends within it
DRIVING = a_second_of(bytes_in=11_000, records=400, bad_frames=1)
STANDING_BAD = a_second_of(bytes_in=190, records=4, bad_frames=1)


@pytest.mark.parametrize("seconds, states", [
    *(pytest.param([fault] * 3 + [GOOD] * 3, [FINE] + [state] * 3 + [FINE] * 2, id=f"{state}_two_to_come_two_to_go")
      for fault, state in ((NOTHING, health.SILENT), (OTHER_BAUD, health.NO_FRAMES),
                           (OTHER_CHECKSUM, health.BAD_CHECKSUMS), (UNANSWERED, health.NO_PONGS))),
    pytest.param([HALF] + [OTHER_BAUD] * 2, [FINE] + [health.NO_FRAMES] * 2, id="second_in_which_a_fault_begins"),
    pytest.param([NOTHING, GOOD, OTHER_BAUD, GOOD, GOOD], [FINE] * 5, id="single_bad_seconds"),
    pytest.param([NOTHING, OTHER_BAUD] * 2, [FINE] + [health.NO_FRAMES] * 3, id="fault_that_changes_its_face"),
    pytest.param([STANDING] * 20, [FINE] * 20, id="car_that_stands_with_its_sonars_off"),
    pytest.param([DRIVING] * 20, [FINE] * 20, id="small_share_of_bad_frames"),
    pytest.param(([STANDING] * 4 + [STANDING_BAD]) * 4, [FINE] * 20, id="two_bad_frames_in_ten_seconds_of_few"),
    pytest.param([OTHER_BAUD] * 3 + [HALF] + [GOOD] * 5, [FINE] + [health.NO_FRAMES] * 3 + [FINE] * 5,
                 id="second_in_which_another_baud_rate_ends_is_no_noise"),
    pytest.param([FLOOD] * 5 + [GOOD] * 10, [FINE] + [health.NO_FRAMES] * 5 + [FINE] * 9, id="flood_is_no_noise_later"),
    pytest.param([NOISY] * 20 + [GOOD] * 11, [FINE] * 3 + [health.BAD_CHECKSUMS] * 25 + [FINE] * 3,
                 id="noise_is_forgotten_within_ten_seconds"),
])
def test_state_of_a_good_link_second_by_second(good_link, seconds, states):
    assert good_link.live(*seconds) == states


def test_counters_looked_at_twice_in_a_row_change_nothing(good_link):
    for _ in range(10):
        good_link.now_ns += 10 * MS
        assert good_link.health.judge(good_link.counts, good_link.now_ns).state == FINE


def test_reboot_is_told_at_once_and_for_ten_seconds(good_link):
    good_link.health.rebooted("its clock went from 9.0 s back to 0.1 s", good_link.now_ns)
    verdict = good_link.health.verdict
    assert (verdict.state, verdict.level) == (health.REBOOTED, WARN)
    assert verdict.description == "the Teensy rebooted: its clock went from 9.0 s back to 0.1 s"
    assert "power supply" in verdict.next_step
    assert good_link.live(*[GOOD] * 10) == [health.REBOOTED] * 9 + [FINE]


def test_neither_the_link_nor_a_sonar_hides_the_other_s_fault(good_link):
    sonars = "rear_left does not report", "Check its plug"
    assert health.with_sonars(good_link.health.verdict, *sonars) == (health.SONAR_FAULT, WARN, *sonars)
    good_link.health.rebooted("its clock went back", good_link.now_ns)
    both = health.with_sonars(good_link.health.verdict, *sonars)
    assert (both.state, both.level) == (health.SONAR_FAULT, WARN)
    assert both.description == "the Teensy rebooted: its clock went back; rear_left does not report"
    assert both.next_step.startswith("Check its power supply") and both.next_step.endswith("Check its plug")
    for _ in range(3):
        good_link.live(NOTHING)
    both = health.with_sonars(good_link.health.verdict, *sonars)
    assert (both.state, both.level) == (health.SILENT, ERROR)
    assert both.description.endswith("; rear_left does not report")


@pytest.mark.parametrize("before, after, states", [
    ([GOOD], [NOTHING, NOTHING], [health.REBOOTED, health.SILENT]), ([], [GOOD, GOOD], [WAITING, health.REBOOTED]),
], ids=["fault_after_it_comes_as_any_other", "noticed_when_the_port_is_back_it_is_told_after_the_first_good_second"])
def test_reboot_does_not_hide_how_the_link_does(link, before, after, states):
    link.live(*before)
    link.health.rebooted("its clock went back", link.now_ns)
    assert link.live(*after) == states


def test_three_bad_frames_of_300_are_told_and_half_of_all_are_an_error_before_pings_in_vain(link):
    assert link.live(*[a_second_of(9000, 297, 3)] * 2)[1] == "bad checksums"
    link.open()
    verdict = [link.second(a_second_of(600, 10, 10, pings_in_vain=3)) for _ in range(3)][-1]
    assert (verdict.state, verdict.level) == ("bad checksums", ERROR)


@pytest.mark.parametrize("bytes_in, is_told", [(17_280, False), (17_281, True)])
def test_one_and_a_half_times_the_bytes_that_a_line_can_carry_are_too_many(link, bytes_in, is_told):
    verdict = [link.second(a_second_of(bytes_in)) for _ in range(3)][-1]
    assert ("more than 115200 baud can carry" in verdict.description) == is_told
