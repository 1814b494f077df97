"""Whether the servo board holds what turn_arb commands, as stories on a clock of their own. Time is passed in."""

import math

import pytest

from car_interface.common import causes
from car_interface.common.declared import read
from car_interface.common.params import Params
from car_interface.common.units import one_channel
from car_interface.throttle.board_watch import BoardConfig, BoardWatch

MS = 1_000_000
S = 1000 * MS
TICK = 10 * MS
CENTER, LEFT = 5100, 3818


class Car:
    """A turn_arb and a board, whose states and reports are so many ms late, and a throttle_arb that judges them."""

    def __init__(self, state_late=1, report_late=1, channel=0, **config):
        self.watch = BoardWatch(BoardConfig(**config))
        self.channel = channel
        self._late = {"state": state_late * MS, "report": report_late * MS}
        self._arrivals = []
        self.now = 1000 * S
        self.troubles = []  # (time since the start in ms, cause or None)
        self._sent = {}

    def step(self, commanded, held):
        """Pass 10 ms, in which turn_arb's state names a duty and the board reports one; None = it is silent."""
        for kind, value in (("state", commanded), ("report", held)):
            if value is not None:
                self._arrivals.append((self.now + self._late[kind], kind, value))
        self.now += TICK
        for at, kind, value in sorted(a for a in self._arrivals if a[0] <= self.now):
            if kind == "state":
                self.watch.update_command(self.channel, value, at)
            else:
                self.watch.update_output(one_channel(self.channel, value), at)
        self._arrivals = [a for a in self._arrivals if a[0] > self.now]
        trouble = self.watch.trouble(self.now)
        self.troubles.append(trouble and trouble.cause)
        return trouble

    def steps(self, ms, *duties):
        """The trouble after each; ``commanded`` and ``held`` are duties, or functions of the time in ms."""
        return (self.step(*(duty(at) if callable(duty) else duty for duty in duties)) for at in range(0, ms, 10))

    def run(self, ms, commanded, held):
        return list(self.steps(ms, commanded, held))[-1]

    def ms_until_trouble(self, commanded, held, limit=5000):
        """How long the car drives on with a fault, in ms; inf = for ever."""
        return next((10 * number for number, trouble in enumerate(self.steps(limit, commanded, held), 1) if trouble),
                    math.inf)


def agreed(**arguments):
    car = Car(**arguments)
    assert car.run(700, CENTER, CENTER) is None
    return car


def test_board_that_never_reports_is_driven_only_if_the_parameter_says_so_and_one_that_does_is_checked():
    trouble = Car().run(2000, CENTER, None)
    assert trouble.cause == causes.BOARD_NEVER_RECEIVED and "output_required: false" in trouble.reason
    foreign = Car(output_required=False)
    assert foreign.run(100, CENTER, None) is None
    assert foreign.run(1000, LEFT, CENTER).cause == causes.STEERING_NOT_HELD


def test_throttle_is_given_once_both_agreed_for_half_a_second_and_the_reason_says_so():
    assert Car().run(100, None, CENTER).reason == "turn_arb's command for the steering isn't known"
    car = Car()
    assert car.run(500, CENTER, CENTER) == (
        causes.STEERING_NOT_HELD, "the servo board holds turn_arb's command, which must last for 0.5 s")
    assert car.run(20, CENTER, CENTER) is None


@pytest.mark.parametrize("before", [CENTER, LEFT])  # a board that doesn't follow, and a channel that timed out
def test_difference_ends_the_throttle_after_half_a_second(before):
    car = agreed()
    car.run(1000, before, before)
    assert car.ms_until_trouble(LEFT, CENTER) == pytest.approx(500, abs=20)


@pytest.mark.parametrize("channel, held, words", [(3, CENTER, "5100 on channel 3"), (0, -1, "nothing on channel 0")])
def test_reason_names_both_duties_and_the_channel(channel, held, words):
    reason = Car(channel=channel).run(1000, LEFT, held).reason
    assert reason == f"the servo board holds {words}, where turn_arb commands 3818"


def test_board_that_falls_silent_ends_the_throttle_after_its_timeout_and_must_agree_again_for_half_a_second():
    car = agreed()
    assert car.ms_until_trouble(CENTER, None) == pytest.approx(500, abs=20)
    assert car.run(500, CENTER, None).cause == causes.BOARD_STALE
    assert car.run(450, CENTER, CENTER) is not None
    assert car.run(120, CENTER, CENTER) is None


def test_dropped_messages_take_the_agreement_and_the_command_away():
    car = agreed()
    car.watch.mark_stale()
    assert car.step(CENTER, CENTER).cause == causes.STEERING_NOT_HELD
    car = agreed()
    car.watch.mark_stale()
    assert car.watch.trouble(car.now).cause == causes.BOARD_STALE
    assert car.step(None, CENTER).reason == "turn_arb's command for the steering isn't known"
    assert car.run(300, CENTER, CENTER).cause == causes.STEERING_NOT_HELD
    assert car.run(300, CENTER, CENTER) is None


@pytest.mark.parametrize("held, until_ms", [(LEFT - 10, math.inf), (LEFT + 16, math.inf), (LEFT + 17, 500)])
def test_rounding_of_the_board_is_no_difference(held, until_ms):
    assert agreed().ms_until_trouble(LEFT, held) == pytest.approx(until_ms, abs=20)


@pytest.mark.parametrize("commanded, held, until_ms", [(3800, 4000, math.inf), (6700, 6000, math.inf),
                                                       (3800, 3800, 500)])
def test_limits_of_the_board_are_no_difference(commanded, held, until_ms):
    car = agreed(pwm_min=(4000,) * 16, pwm_max=(6000,) * 16)
    assert car.ms_until_trouble(commanded, held, 2000) == pytest.approx(until_ms, abs=20)


def sweep(period_ms, amplitude=1200):
    """Commands that go to and fro, as a driver's stick does, sent at 100 Hz."""
    return lambda at: round(CENTER + amplitude * math.sin(2 * math.pi * at / period_ms))


@pytest.mark.once
@pytest.mark.parametrize("state_late, report_late", [(1, 1), (1, 25), (25, 1), (40, 45)])
@pytest.mark.parametrize("period_ms", [400, 3000])
def test_board_that_follows_a_moving_stick_is_never_in_trouble(state_late, report_late, period_ms):
    wave = sweep(period_ms)
    assert agreed(state_late=state_late, report_late=report_late).ms_until_trouble(wave, wave, 10_000) == math.inf


def bursts(period_ms, away_ms, there=CENTER, away=LEFT):
    """A duty that is away for a part of each period."""
    return lambda at: away if at % period_ms < away_ms else there


@pytest.mark.parametrize("period_ms, away_ms", [(120, 100), (200, 100), (1090, 470), (600, 300)])
def test_servo_that_stands_still_while_commands_return_to_its_place_for_moments_ends_the_throttle(period_ms, away_ms):
    assert agreed().ms_until_trouble(bursts(period_ms, away_ms), CENTER, 30_000) < 3000


@pytest.mark.parametrize("period_ms, away_ms, ends", [(900, 380, True), (1000, 250, True), (40, 10, True),
                                                      (20, 10, True), (1000, 150, False)])
def test_second_sender_that_has_the_servo_for_more_than_a_fifth_of_the_time_ends_the_throttle(period_ms, away_ms, ends):
    assert (agreed().ms_until_trouble(CENTER, bursts(period_ms, away_ms), 30_000) < 30_000) == ends


def test_board_that_failed_once_is_given_less_time_the_next_time():
    car = agreed()
    car.run(1000, LEFT, CENTER)
    car.run(600, LEFT, LEFT)
    assert car.ms_until_trouble(LEFT, CENTER) < 400


@pytest.mark.parametrize("stall_ms", [100, 240, 400])
def test_stalls_of_the_arbiter_excuse_nothing(stall_ms):
    car = agreed()
    begun_ns = car.now
    while car.step(LEFT, CENTER) is None:
        for _ in range(stall_ms // 10):  # messages arrive meanwhile
            car.now += TICK
            car.watch.update_command(0, LEFT, car.now)
            car.watch.update_output(one_channel(0, CENTER), car.now)
    assert car.now - begun_ns <= 500 * MS + stall_ms * MS + 2 * TICK


@pytest.mark.parametrize("period_ms", [200, 700, 4000])
def test_servo_that_stands_still_while_the_stick_goes_to_and_fro_ends_the_throttle(period_ms):
    """A driver whose car doesn't steer moves the stick; each pass over the servo's position must not excuse it."""
    assert agreed().ms_until_trouble(sweep(period_ms), CENTER) < 1600


def test_stall_of_the_judge_alone_is_no_difference():
    """What arrives after it is judged at its own time of arrival."""
    car = agreed()
    car.step(LEFT, CENTER)
    car.now += 300 * MS
    assert car.run(1000, LEFT, LEFT) is None
    assert set(car.troubles[-100:]) == {None}


@pytest.mark.parametrize("lag_ms, follows", [(100, True), (101, False)])
def test_servo_may_lag_behind_commands_that_sweep_by_a_tenth_of_a_second(lag_ms, follows):
    watch = BoardWatch(BoardConfig())
    for ms in range(1300):
        watch.update_command(0, 10_000 + 40 * ms, S + ms * MS)
        watch.update_output(one_channel(0, 10_000 + 40 * max(0, ms - lag_ms)), S + ms * MS)
        trouble = watch.trouble(S + ms * MS)
    assert (trouble is None) == follows


def judged(*calls):
    """The troubles at (time, commanded, held), from an agreement of a second before S on."""
    watch = BoardWatch(BoardConfig())
    troubles = []
    for now_ns, commanded, held in ((0, CENTER, CENTER), (S - 20 * MS, CENTER, CENTER), *calls):
        watch.update_command(0, commanded, now_ns)
        watch.update_output(one_channel(0, held), now_ns)
        troubles.append(watch.trouble(now_ns))
    return [trouble is not None for trouble in troubles[2:]]


def test_difference_ends_the_throttle_after_exactly_half_a_second():
    differs = [(S + ms * MS, LEFT, CENTER) for ms in (0, 250, 480)]
    assert judged(*differs, (S + 500 * MS - 1, LEFT, CENTER)) == [False] * 4
    assert judged(*differs, (S + 500 * MS, LEFT, CENTER)) == [False] * 3 + [True]


@pytest.mark.parametrize("after_ns, follows", [(500 * MS - 1, False), (500 * MS, True)])
@pytest.mark.parametrize("is_new", [True, False])
def test_throttle_is_given_after_exactly_half_a_second_of_agreement_at_first_and_after_dropped_messages(
        after_ns, follows, is_new):
    watch = BoardWatch(BoardConfig())
    if not is_new:
        watch.update_output(one_channel(0, CENTER), 0)
        watch.trouble(0)
        watch.mark_stale()
    for now_ns in (S, S + 480 * MS, S + after_ns):
        watch.update_command(0, CENTER, now_ns)
        watch.update_output(one_channel(0, CENTER), now_ns)
        trouble = watch.trouble(now_ns)
    assert (trouble is None) == follows


@pytest.mark.parametrize("before_ms, is_judged", [(15, True), (14, False)])
def test_what_comes_within_15_ms_of_a_judgement_is_judged_later(before_ms, is_judged):
    differs = [(S + ms * MS, LEFT, CENTER) for ms in (0, 250, 500 - before_ms, 500)]
    assert judged(*differs) == [False] * 3 + [is_judged]


@pytest.mark.parametrize("asked_every_ms", [10, 400])
@pytest.mark.parametrize("period_ms, lag_ms, ends", [(500, 170, False), (300, 150, True)])
def test_verdict_on_a_servo_that_lags_does_not_depend_on_how_often_it_is_asked_for(
        period_ms, lag_ms, ends, asked_every_ms):
    watch, troubles = BoardWatch(BoardConfig()), []
    wave = bursts(2 * period_ms, period_ms)
    for ms in range(-1000, 3000, 10):
        now_ns = 2 * S + ms * MS
        watch.update_command(0, wave(ms) if ms >= 0 else CENTER, now_ns)
        watch.update_output(one_channel(0, wave(ms - lag_ms) if ms >= lag_ms else CENTER), now_ns)
        if ms < 0 or ms % asked_every_ms == 0:
            troubles.append(watch.trouble(now_ns))
    assert troubles[100] is None and any(troubles[100:]) == ends


def test_configuration_is_read_with_the_board_s_own_limits():
    config = read(Params({"output_required": False, "output_timeout": 0.7,
                          "board": {"pwm_min": 3000, "pwm_max": [6000] * 16, "timeout": 250}}), BoardConfig)
    assert config == BoardConfig(False, 0.7, (3000,) * 16, (6000,) * 16)
