"""A first check's questions: each answered right, and each answered wrong once; and the way through them."""
import math
from dataclasses import replace
from types import SimpleNamespace as Message

import pytest

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.errors import ConfigError
from car_interface.common.sources import NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.tools.first_check.car import SLOWER, Controls, Setup
from car_interface.tools.first_check.check import FirstCheck
from car_interface.tools.first_check.questions import BROKEN, FINE, LEARNED, SKIPPED
from slash import SLASH

TICK_NS = NS_PER_S // 20
ESC = ThrottleCalibration(1, [-5.0, 0.0, 3.0], [3277, 4915, 6554], 4915)
SETUP = Setup(SLASH, ESC, "unverified", calibrates_esc=True)
FALLING = replace(SETUP, throttle=replace(ESC, duty_table=[6554, 4915, 3277]))
FORWARD, BACKWARD = 0, 1
ENTER = "\n"
PAD = Controls({MANUAL: 4, AUTONOMOUS: 5}, {MANUAL: "L1", AUTONOMOUS: "R1", SLOWER: "cross"})


class Bench:
    """A car on a box whose nodes do what they should, and a person at the gamepad and at the keys.

    Attributes:
        held: the deadman that is held.
        stick: throttle, as teleop_logi publishes it.  side: steering.
        scale: human_scale.  speed_mps: of the wheels.
        near: the sonars that see a hand.  ranges: of the others; ``None`` = the Teensy has none.
        silent: inputs that don't arrive.
        turned: pulses of each wheel.
        board: who reports servo/output, and what it holds; ``None`` = what turn_arb and throttle_arb command.
    """

    def __init__(self, setup=SETUP, **state):
        self.killed = []
        self.check, self.setup, self.now_ns = FirstCheck(setup, self.kill), setup, 1000 * NS_PER_S
        self.check.car.controls = PAD
        self.held = None
        self.stick = self.side = self.speed_mps = 0.0
        self.scale, self.near, self.range_m, self.silent = 0.3, (), math.inf, set()
        self.buttons, self.turned, self.board, self.sender = (), [(0, 0), (0, 0)], None, "/pca9685"
        self.esc, self.link, self.neutral = "NEUTRAL", True, ESC.neutral
        self.steers = None  # the source that turn_arb names; None = as it should be
        self.pulls_pass = setup.calibrates_esc
        self.__dict__.update(state)
        self.run(0.1)

    def kill(self, name):
        self.killed.append(name)
        return ""

    @property
    def granted(self):
        passes = self.held == MANUAL and (self.stick > 0 or self.pulls_pass)
        return self.stick * self.scale if passes else 0.0

    def run(self, duration_s, keys=""):
        for _ in range(max(1, round(duration_s * NS_PER_S / TICK_NS))):
            self.now_ns += TICK_NS
            self._arrive()
            self.check.step(self.now_ns, keys)
            keys = ""
        return self

    def type(self, keys):
        for key in keys:
            self.run(0.05, key)
        return self

    def go_to(self, title):
        """Answer until a question is asked: on the box, and the others are skipped."""
        self.type("y")
        while title not in self.check.question.title:
            self.type("s")
        return self

    def _arrive(self):
        car, now_ns, setup = self.check.car, self.now_ns, self.setup
        asked = self.steering
        steers = {None: NO_HUMAN, MANUAL: TELEOP, AUTONOMOUS: NEUTRAL if asked is None else PLANNER}[self.held]
        steers = steers if self.steers is None else self.steers
        duty = {TELEOP: self.side, PLANNER: asked}.get(steers, 0.0)
        duty = setup.steering.teleop_duty(duty)
        duties = [0] * 16
        duties[0], duties[1] = duty, round(self.neutral + 1639 * self.granted)
        for name, update, value in (
                ("human", car.human.update, self.held is not None), ("mode", car.mode.update, self.held or MANUAL),
                ("gamepad", car.gamepad.update, "no deadman"), ("joy", car.buttons.update, self.buttons),
                ("side", car.steering_stick.update, self.side), ("stick", car.throttle_stick.update, self.stick),
                ("turn_arb", car.steering.update, Message(
                    source=steers, reason="no deadman is held", duty=duty)),
                ("throttle_arb", car.update_throttle, Message(
                    source=TELEOP if self.held == MANUAL else NEUTRAL, reason="nobody drives", granted=self.granted,
                    esc=self.esc, esc_reason="it needs neutral", human_scale=self.scale)),
                ("board", self._on_board, self.board or duties),
                ("link", car.link.update, self.link), ("odom", car.update_speed, self.speed_mps),
                ("wheels", car.update_wheels, Message(**{
                    side: Message(direction=direction, dist_abs=count)
                    for side, (direction, count) in zip(("left", "right"), self.turned)}))):
            if name not in self.silent:
                update(value, now_ns)
        for name in SONARS if "sonars" not in self.silent else ():
            car.update_range(name, 0.2 if name in self.near else self.range_m, now_ns)

    def _on_board(self, duties, now_ns):
        self.check.car.output.update(duties, now_ns)
        self.check.car.sender = self.sender

    def result(self, title):
        return next(result for each, result in self.check.results if title in each)

    @property
    def steering(self):
        return self.check.question and self.check.question.steering

    @property
    def lines(self):
        return self.check.lines(self.now_ns)

    @property
    def text(self):
        return " ".join(" ".join(self.lines).split())


# --- each question, answered right ---

def drive(bench, stick=0.3, run_s=0.5):
    bench.held, bench.stick = MANUAL, stick
    bench.run(run_s)


def steer(bench):
    bench.held = AUTONOMOUS
    bench.run(0.2)


def press_both(bench):
    for held in (MANUAL, None, AUTONOMOUS, None):
        bench.held = held
        bench.run(0.2)


def hold_left(bench, side=1.0):
    bench.held, bench.side = MANUAL, side
    bench.run(0.1)


def push_and_pull(bench, stick=-0.5):
    drive(bench)
    for stick_now, run_s in ((0.0, 0.1), (stick, 1.2)):
        drive(bench, stick_now, run_s)


def pull_again(bench):
    for stick_now, run_s in ((0.0, 0.1), (-0.5, 1.2)):
        drive(bench, stick_now, run_s)


def turn(left=(FORWARD, 0), right=(FORWARD, 0)):
    def act(bench):
        bench.turned = [left, right]
        bench.run(0.1)
    return act


def show_hand(*names, run_s=0.3):
    def act(bench):
        bench.run(0.1)
        bench.near = names
        bench.run(run_s)
    return act


def let_go(bench):
    drive(bench)
    bench.held = None
    bench.run(0.1)


def pull_cable(bench):
    bench.link, bench.silent = False, {"wheels", "odom", "sonars"}
    bench.run(1.5)


def plug_in(bench):
    bench.link, bench.silent = True, set()
    bench.run(0.2)


def kill(guarded=True, back=True):
    def act(bench):
        steer(bench)
        bench.type("k")
        bench.silent = {"board"}
        assert bench.type("k").killed == ["/pca9685"]
        bench.run(0.5)
        if guarded:
            bench.board, bench.sender, bench.silent = [SLASH.servo_center, *[0] * 15], "/pca9685_guard", set()
            bench.run(0.5)
        if back:
            bench.board, bench.sender, bench.silent = None, "/pca9685", set()
        bench.run(0.5)
    return act


def report_again(bench):
    bench.silent = set()
    bench.run(0.1)


def hold_on(bench):
    """The board's output is reported again, as it was."""
    bench.board, bench.silent = bench.check.car.output.value, set()
    bench.run(1.6)


def answered(title, acts, keys):
    """A bench after the question was asked, acts and keys."""
    bench = Bench()
    if title != "on a box":
        bench.go_to(title)
    for act in acts:
        act(bench)
    return bench.type(keys)


RIGHT = [
    ("on a box", [], "y", "all wheels hang free"),
    ("deadman", [press_both], "", "both were seen held and released"),
    ("direction", [hold_left], "l", "stick and wheels go to the same side"),
    ("center", [steer], ENTER, "straight at duty 5100"),
    ("left end", [steer], "<" * 20 + ENTER, "free up to the end of the file, duty 3800"),
    ("right end", [steer], "." * 25 + ENTER, "free up to the end of the file, duty 6700"),
    ("neutral", [lambda bench: drive(bench, 0.0)], "y", "the wheels stand at duty 4915"),
    ("throttle's direction", [drive], "f", "pushed, the wheels turn forward"),
    ("left rear wheel", [turn((FORWARD, 21), (BACKWARD, 20))], ENTER, "it counts forward, 21 pulses in one turn"),
    ("right rear wheel", [turn((BACKWARD, 20), (FORWARD, 19))], ENTER, "it counts forward, 19 pulses in one turn"),
    ("sonar front right", [show_hand("front_right")], "", "it sees the hand: 0.20 m"),
    ("letting go", [let_go], "y", "neutral or its brake within 0.1 s, and the wheels stood"),
    ("unplugging", [pull_cable, plug_in], "", "noticed, and its wheels were heard again"),
    ("killing", [kill(guarded=False, back=False), lambda bench: bench.run(15.0), report_again], "y",
     "/pca9685 reported the center 16.1 s after the kill, and the node came back"),
    ("killing", [kill()], "y", "/pca9685_guard reported the center 0.6 s after the kill, and the node came back"),
]


@pytest.mark.parametrize("title, acts, keys, answer", RIGHT, ids=[row[0].replace(" ", "_") for row in RIGHT])
def test_right_answer_is_fine_and_changes_nothing(title, acts, keys, answer):
    bench = answered(title, acts, keys)
    assert (bench.result(title).verdict, bench.result(title).answer) == (FINE, answer), bench.text
    assert bench.check.changes() == {} and not bench.result(title).repair


# --- each question, answered wrong ---

EXCHANGED = {"turn_arb": {"servo_left": 6700, "servo_center": 5100, "servo_right": 3800,
                          "k_pwmcmd_left_table_servo": list(SLASH.right_duties),
                          "k_pwmcmd_right_table_servo": list(SLASH.left_duties)}}


def press_another(*buttons):
    def act(bench):
        bench.buttons = buttons
        bench.run(0.1)
    return act


def creep(bench):
    drive(bench, 0.0)
    bench.type("++")


LEARNS = [
    ("deadman", [press_another(6)], "n", {"teleop_logi": {"manual_button": 6}}),
    ("direction", [hold_left], "r", EXCHANGED),
    ("direction", [lambda bench: hold_left(bench, -1.0)], "r", {"teleop_logi": {"steer_scale": -1.0}}),
    ("direction", [lambda bench: hold_left(bench, -1.0)], "l", {"teleop_logi": {"steer_scale": -1.0}, **EXCHANGED}),
    ("neutral", [creep], "y", {"throttle": {"servo/neutral": 4925, "servo/duty_table": [3287, 4925, 6564]}}),
    ("throttle's direction", [lambda bench: drive(bench, -0.5)], "b", {"teleop_logi": {"throttle_scale": -1.0}}),
    ("throttle's direction", [lambda bench: drive(bench, -0.5)], "f", {"teleop_logi": {"throttle_scale": -1.0}}),
    ("throttle's direction", [drive, lambda bench: bench.type("b"), lambda bench: drive(bench, -0.3)], "y",
     {"throttle": {"servo/neutral": 4915, "servo/duty_table": [6553, 4915, 3276]}}),
    ("ESC's kind", [push_and_pull], "2", {"throttle": {"esc/profile": "brake_becomes_reverse"}}),
    ("ESC's kind", [push_and_pull], "3", {"throttle": {"esc/profile": "direct_reverse"}}),
    ("ESC's kind", [push_and_pull, lambda bench: bench.type("1"), pull_again], "y",
     {"throttle": {"esc/profile": "brake_then_reverse"}}),
    ("ESC's kind", [push_and_pull, lambda bench: bench.type("1"), pull_again], "n",
     {"throttle": {"esc/profile": "forward_only"}}),
    ("sonar rear left", [], "x", {"teensy_sensor_hub": {"sonar_sequence": [0, 1, 2, 3, 4]}}),
]


@pytest.mark.parametrize("title, acts, keys, changes", LEARNS)
def test_answer_that_a_file_can_take_becomes_its_parameter(title, acts, keys, changes):
    bench = answered(title, acts, keys)
    assert bench.result(title).verdict == LEARNED, bench.text
    assert bench.check.changes() == changes


REPAIRS = [
    ("on a box", [], "n", "it is on the ground", "put it on a box first"),
    ("deadman", [], "n", "no button of joy is seen", "manual_button in teleop_logi.yaml: rostopic echo /joy"),
    ("deadman", [press_another(5)], "n", "buttons 5 are held", "set manual_button"),
    ("direction", [hold_left], "n", "channel 0 has duty 3800", "the servo's plug"),
    ("center", [steer], "n", "can't be made straight", "horn one tooth further"),
    ("left end", [steer], "n", "don't turn to the left far enough", "what blocks"),
    ("neutral", [creep], "n", "don't stop, at duty 4925 either", "teach the ESC its neutral"),
    ("throttle's direction", [drive], "n", "don't turn; the ESC got throttle", "plug in channel 1"),
    ("throttle's direction", [drive, lambda bench: bench.type("b"), lambda bench: drive(bench, -0.3)], "n",
     "the other way round", "exchange two wires"),
    ("ESC's kind", [push_and_pull], "n", "isn't clear", "calibrate_esc"),
    ("left rear wheel", [], ENTER, "counts nothing", "the sensor's plug"),
    ("left rear wheel", [turn((FORWARD, 0), (FORWARD, 20))], ENTER, "the other sensor counts it", "exchange the plugs"),
    ("left rear wheel", [turn((BACKWARD, 20), (FORWARD, 20))], ENTER, "the other sensor counts it",
     "exchange the plugs"),
    ("left rear wheel", [turn((BACKWARD, 20))], ENTER, "counts backward", "exchange the two signal wires"),
    ("left rear wheel", [turn((FORWARD, 4), (BACKWARD, 20))], ENTER, "counts too little", "plug and magnets"),
    ("left rear wheel", [turn((FORWARD, 40))], ENTER, "40 pulses in one turn", "pulses_per_revolution"),
    ("sonar front left", [show_hand("rear_left")], "n", "rear left sees the hand", "exchange the plugs of front left"),
    ("sonar front left", [], "n", "sees no hand", "trigger and echo"),
    ("letting go", [let_go], "n", "go on after the release", "disconnect the battery"),
    ("unplugging", [], "n", "wasn't noticed", "port:="),
    ("unplugging", [pull_cable], "n", "doesn't come back", "setup_hardware"),
    ("killing", [kill(), ], "n", "the wheels weren't there at once", "the servo's plug"),
    ("killing", [kill(guarded=False, back=False), hold_on], "", "nobody centered", "guard"),
    ("killing", [kill(guarded=False, back=False), lambda bench: bench.run(20.0)], "", "nobody reports", "guard"),
    ("killing", [kill(back=False), lambda bench: bench.run(20.0)], "", "the node isn't back", "launch file"),
]


@pytest.mark.parametrize("title, acts, keys, answer, repair", REPAIRS)
def test_answer_that_no_file_can_take_says_what_to_repair(title, acts, keys, answer, repair):
    bench = answered(title, acts, keys)
    result = bench.result(title)
    assert result.verdict == BROKEN and answer in result.answer and repair in result.repair, (result, bench.text)
    assert bench.check.changes() == {}


def test_sonar_that_always_sees_something_and_one_that_is_silent_are_told_apart():
    bench = Bench(range_m=0.2).go_to("sonar front left")
    assert bench.run(1.0).type("n").result("sonar front left").answer == "it always sees something: 0.20 m"
    bench.silent = {"sonars"}
    bench.run(1.0)
    for name in SONARS[:2]:
        bench.check.car.update_range(name, 1.0, bench.now_ns)
    bench.run(1.5)
    assert bench.type("n").result("sonar rear right").answer == "it isn't heard"


@pytest.mark.parametrize("range_m, text", [(math.inf, "it sees nothing"), (-math.inf, "it sees something too near"),
                                           (1.5, "it sees 1.50 m")])
def test_what_a_sonar_sees_is_said_in_words(range_m, text):
    assert f"Now: {text}" in Bench(range_m=range_m).go_to("sonar front left").run(0.1).text


def test_kind_of_esc_is_asked_with_calibration_drive_and_once_a_push_drives_forward():
    bench = Bench(replace(SETUP, calibrates_esc=False)).go_to("left rear wheel")
    assert bench.result("ESC's kind").answer == "the car was launched without calibration_drive:=true"
    bench = Bench().go_to("throttle's direction")
    drive(bench)
    bench.type("b")
    drive(bench, -0.3)
    assert "a push has to drive forward first" in bench.type("y").result("ESC's kind").answer


@pytest.mark.parametrize("esc", ["NEUTRAL", "BRAKING"])
def test_esc_that_is_not_neutral_after_the_release_is_said_at_once(esc):
    bench = Bench().go_to("letting go")
    drive(bench)
    bench.held, bench.board, bench.esc = None, [5100, 5200, *[0] * 14], esc
    bench.run(0.6)
    assert bench.result("letting go").answer == (
        "the ESC's channel is neither neutral nor its brake half a second after the release")


@pytest.mark.parametrize("setup, duty", [(SETUP, 3277), (FALLING, 6554)], ids=["rising_duties", "falling_duties"])
def test_brake_of_a_stop_is_as_good_as_neutral(setup, duty):
    bench = Bench(setup).go_to("letting go")
    drive(bench)
    bench.held, bench.board, bench.esc = None, [5100, duty, *[0] * 14], "BRAKING"
    bench.run(0.6)
    assert bench.type("y").result("letting go").verdict == FINE


def test_backward_wheels_without_calibration_drive_are_not_guessed_at():
    bench = Bench(replace(SETUP, calibrates_esc=False)).go_to("throttle's direction")
    drive(bench)
    assert "exchange two wires between ESC and motor; or launch" in bench.type("b").result("throttle's").repair
    assert bench.check.question.title != "the ESC's kind"


# --- what several answers make together ---

def test_center_and_ends_of_a_servo_that_is_built_in_the_other_way_round():
    bench = Bench().go_to("direction")
    hold_left(bench)
    bench.type("r")
    steer(bench)
    bench.type("<<" + ENTER)
    assert bench.result("center").answer == "straight at duty 5132"  # left is the larger duty now
    assert bench.steering == pytest.approx(-0.02)
    bench.type("<" * 10 + ENTER)
    bench.type(">" * 12 + ENTER)
    changes = bench.check.changes()["turn_arb"]
    assert (changes["servo_left"], changes["servo_center"], changes["servo_right"]) == (5932, 5132, 4346)
    assert changes["k_pwmcmd_left_table_servo"][0] == 5932.0
    assert changes["k_pwmcmd_right_table_servo"][0] == 4346.0
    assert changes["k_pwmcmd_left_table_servo"][-1] == changes["k_pwmcmd_right_table_servo"][-1] == 5132.0


def test_center_that_is_an_end_in_the_file_is_refused_by_name():
    bench = Bench(replace(SETUP, steering=replace(SLASH, servo_center=3800))).go_to("center")
    steer(bench)
    bench.type(">" + ENTER)
    with pytest.raises(ConfigError, match="servo_center is an end at start"):
        bench.check.changes()


# --- safety ---

def test_it_steers_only_in_the_questions_on_the_steering_and_within_the_ends():
    bench = Bench()
    asked = {}
    bench.type("y")
    while bench.check.question is not None:
        title = bench.check.question.title
        bench.held = AUTONOMOUS
        bench.run(0.1)
        bench.type("<" * 60)
        asked[title] = bench.steering
        bench.type("s")
    assert {title for title, steering in asked.items() if steering is not None} == {
        "the steering's center", "the steering's left end", "the steering's right end",
        "killing the servo board's node"}
    assert max(abs(steering) for steering in asked.values() if steering is not None) == 1.0
    assert asked["the steering's center"] == 0.4
    assert bench.steering is None and bench.check.question is None


def test_keys_that_steer_or_answer_wait_for_the_deadman():
    bench = Bench().go_to("center")
    for key in ("<", ENTER):
        bench.type(key)
        assert bench.check.question.title == "the steering's center" and bench.steering == 0.0
        assert "hold it, and type then" in bench.text
    assert "the autonomous deadman isn't held (no deadman)" in bench.text
    bench.type("sss")
    bench.type("y")
    assert "hold the deadman while you answer" in bench.text
    drive(bench)
    assert "let go of the stick" in bench.type("y").text
    drive(bench, 0.0)
    bench.type("s")
    assert "push the stick first" in bench.type("f").text
    drive(bench)
    bench.type("by")
    assert "pull the stick first, with the deadman held" in bench.text
    bench.type("s")
    assert "first do it" in bench.type("2").text
    bench.type("s")
    assert "let go of the deadman first" in bench.type(ENTER).text


def test_steering_waits_while_something_else_than_the_program_steers():
    bench = Bench().go_to("center")
    steer(bench)
    bench.steers = NEUTRAL
    bench.run(0.1)
    assert "Now: no deadman is held" in bench.text  # turn_arb's reason
    assert bench.type("<" + ENTER).steering == 0.0 and bench.check.question.title == "the steering's center"


def test_end_that_is_hardly_a_turn_is_not_taken():
    bench = Bench().go_to("left end")
    steer(bench)
    assert "that is hardly a turn: go further, or type N" in bench.type("<<<<<" + ENTER).text
    assert bench.type("<" + ENTER).result("left end").answer == "the end is at duty 4710"


def test_kind_of_esc_counts_pulls_after_a_push_only_and_the_second_one_after_a_release():
    bench = Bench().go_to("ESC's kind")
    drive(bench, -0.5, 1.5)
    assert "first do it" in bench.type("3").text
    push_and_pull(bench)
    bench.type("1")
    drive(bench, -0.5, 1.5)  # still the first one
    assert "first do it" in bench.type("y").text
    pull_again(bench)
    assert bench.type("y").result("ESC's kind").answer == "brake_then_reverse"


@pytest.mark.parametrize("state, text", [
    ({"esc": "ARMING"}, "Now: it needs neutral"),
    ({"scale": 0.5}, "a full stick gives 0.5 of the throttle, too much for this: press the button for less (cross)"),
    ({"silent": {"mode"}}, "mode"), ({"held": AUTONOMOUS}, "the manual deadman isn't held")])
def test_stick_counts_only_while_it_reaches_the_esc_and_is_scaled_down(state, text):
    bench = Bench().go_to("throttle's direction")
    bench.held, bench.stick = MANUAL, 0.3
    bench.__dict__.update(state)
    bench.run(1.0)
    if "silent" not in state:
        assert text in bench.text
    assert "silent" in state or "push the stick first" in bench.type("f").text


def test_wheels_that_turn_too_fast_or_too_long_begin_the_question_again():
    bench = Bench().go_to("throttle's direction")
    drive(bench)
    bench.speed_mps = 3.4
    bench.run(0.2)
    assert "too fast: the wheels turn at 3.4 m/s. Let go, and push less" in bench.text
    bench.held, bench.stick, bench.speed_mps = None, 0.0, 0.0
    bench.run(0.2)
    assert "too fast" not in bench.text and "push the stick first" in bench.type("f").text
    drive(bench, run_s=7.9)
    assert "long enough" not in bench.text
    bench.run(0.3)
    assert "that was long enough: let go of the stick" in bench.text


@pytest.mark.parametrize("name, sign", [("front_left", 1), ("rear_right", -1)])
def test_car_that_moves_on_the_ground_ends_the_check(name, sign):
    bench = Bench().go_to("throttle's direction")
    drive(bench)
    bench.speed_mps, bench.silent = 0.5, {"sonars"}
    for step in range(20):
        bench.check.car.update_range(name, 1.2 - sign * 0.5 * 0.05 * step * 0.87, bench.now_ns)
        bench.run(0.05)
    assert bench.check.refusal.startswith(f"the car seems to move: what the sonar {name} sees")


def test_hand_before_a_sonar_and_wheels_that_turn_in_the_air_are_no_ground():
    bench = Bench(range_m=1.0).go_to("throttle's direction")
    drive(bench)
    bench.speed_mps = 1.0
    bench.run(3.0)
    bench.near = SONARS
    bench.run(3.0)
    assert bench.check.refusal == ""


# --- the way through ---

def test_question_can_be_skipped_repeated_gone_back_to_and_quit():
    bench = Bench().go_to("center")
    steer(bench)
    bench.type("<<")
    assert bench.steering == 0.02
    assert bench.type("a").steering == 0.0
    bench.type("<" + ENTER)
    assert bench.result("center").verdict == LEARNED and bench.check.question.title == "the steering's left end"
    bench.type("p")
    assert bench.result("center").verdict == SKIPPED and bench.check.changes() == {}


def test_going_back_passes_over_what_cannot_be_asked_and_a_moment_of_silence_ends_no_question():
    bench = Bench(replace(SETUP, calibrates_esc=False)).go_to("left rear wheel")
    assert bench.type("p").check.question.title == "the throttle's direction"
    bench.silent = {"throttle_arb"}
    bench.run(1.0)
    assert bench.check.question.title == "the throttle's direction"
    assert "Now: throttle_arb's state silent for" in bench.text or "the manual deadman isn't held" in bench.text


def test_end_keeps_the_answers_and_names_the_rest_as_not_asked_and_goes_back():
    bench = Bench().type("ye")
    assert bench.check.question is None
    verdicts = [result.verdict for _, result in bench.check.results]
    assert verdicts == [FINE] + [SKIPPED] * (len(verdicts) - 1)
    assert bench.result("deadman").answer == "the check ended before"
    assert bench.type("p").check.question.title == "killing the servo board's node"


def test_keys_that_are_typed_at_once_reach_no_question_that_cannot_be_asked():
    silent = {"wheels", "odom", "sonars", "link", "throttle_arb"}
    bench = Bench(replace(SETUP, throttle=None), silent=silent).run(0.05, "yssssssn+")
    assert bench.check.question is None and bench.result("killing").answer == "skipped"
    assert bench.result("neutral").answer == "throttle_arb isn't heard: launch with throttle:=true"


def test_without_teensy_sonars_and_throttle_the_rest_is_checked():
    silent = {"wheels", "odom", "sonars", "link", "throttle_arb"}
    bench = Bench(replace(SETUP, throttle=None), silent=silent).type("y")
    asked = []
    while bench.check.question is not None:
        asked.append(bench.check.question.title)
        bench.type("s")
    assert asked == ["the deadman", "the steering's direction", "the steering's center", "the steering's left end",
                     "the steering's right end", "killing the servo board's node"]
    assert bench.result("letting go").answer == "throttle_arb isn't heard: launch with throttle:=true"
    assert bench.result("left rear wheel").answer == "no wheel is heard: is the Teensy plugged in?"
    assert bench.result("sonar rear left").answer == "no sonar is heard: is the Teensy plugged in?"
    assert bench.result("unplugging").answer == "teensy_sensor_hub isn't heard"


def test_buttons_are_called_as_on_the_gamepad_that_sends_and_by_no_name_where_that_is_not_known():
    bench = Bench().go_to("center")
    assert "Hold the autonomous deadman (R1). Do the front" in bench.text
    bench.check.car.controls = Controls()
    assert "Hold the autonomous deadman. Do the front" in bench.run(0.1).text


def test_direction_may_be_answered_after_letting_go_by_the_newest_full_stick():
    bench = Bench().go_to("direction")
    assert "hold deadman and stick first" in bench.type("l").text
    hold_left(bench, 0.5)
    assert "hold deadman and stick first" in bench.type("l").text
    hold_left(bench)
    bench.held, bench.side = None, 0.0
    bench.run(1.5)
    assert "Now: the stick was seen" in bench.text
    bench.type("n")
    assert "channel 0 has duty 3800" in bench.result("direction").answer


def test_first_question_can_only_be_answered_or_left_and_a_car_on_the_ground_is_asked_no_other():
    bench = Bench().type("sae")
    assert bench.check.question.title == "the car on a box" and bench.lines[-1] == "Q quit"
    assert Bench().type("n").check.refusal == "it is on the ground: put it on a box first"
    moving = Bench(speed_mps=0.5).type("y")
    assert "the wheels turn: wait until they stand" in moving.text and not moving.check.refusal


def test_every_question_fits_a_terminal_of_80_columns_and_24_rows():
    bench = Bench().type("y")
    while bench.check.question is not None:
        assert len(bench.lines) < 12 and max(map(len, bench.lines)) < 80
        assert "S skip A again P previous E to the end Q quit" in bench.text
        bench.type("s")


def test_neutral_is_tuned_while_it_is_looked_for_kept_once_found_and_given_back_when_not():
    bench = Bench().go_to("neutral")
    drive(bench, 0.0)
    assert bench.type("+").check.car.neutral == 4920
    assert bench.type("-" * 30).check.car.neutral == 4815  # live_range
    bench.type("a")
    assert bench.check.car.neutral == 4915
    bench.type("-y")
    assert bench.check.question.title == "the throttle's direction" and bench.check.car.neutral == 4910
    bench.type("p")
    assert bench.check.car.neutral == 4915
