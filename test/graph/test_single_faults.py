"""Each fault of ``single_faults``, at each phase of the timers: no goal of docs/safety_case.md is broken.

Each case has a process of its own, forked from the one that drives at that moment.
"""
import gc
import itertools
import math
import os
import random
import sys
from functools import lru_cache, partial

import pytest

from graph import NS_PER_S
from single_faults import ACTIONS, ESCS, KINDS, MODES, MOMENTS, NOISE_MPS, PAIRS, RESIDUAL, Case, Drive, cases, run
from test_stalls import forked

IS_ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
DRAWS, PAIRS_DRAWS, SEED = 3, 3, 37
SAMPLE, PAIRS_SAMPLE = 30, 40  # of a drive, where not all are made
AFTER_S = (0.05, 0.3, -0.1)
FIGURES = ("at rest after {:.3f} s", "{:.4f} s beyond time-out and delays", "throttle without steering for {:.3f} s",
           "backward at {:.2f} m/s")
FOUND = [Case("serial noise", 15, "autonomous", "forward_only", "pull"),
         Case("Teensy restarted", 12, "autonomous", "brake_becomes_reverse", "pull")]
DRIVES = list(itertools.product(MODES, ESCS)) if IS_ALL else list(zip(MODES, ESCS))
PAIRS_DRIVES = DRIVES if IS_ALL else [("autonomous", "brake_then_reverse")]


@lru_cache(maxsize=None)
def single_cases():
    return cases(KINDS, DRAWS, SEED)


def judged(drive, case, kind):
    found, figures = run(drive, case, kind, AFTER_S[case.moment % 3])
    return [*found, figures]


def drive_all(mode, esc, chosen):
    """Drive without a terminal; return what the cases of a mode and ESC showed: violations, and the worst figures."""
    sys.stdin = None
    drive = Drive(mode, esc)
    gc.collect()
    gc.freeze()  # children share the pages
    found, worst = [], [(-math.inf, "")] * len(FIGURES)
    for case in sorted(chosen, key=lambda case: case.moment):
        drive.run_to_moment(case.moment)
        for each in forked(partial(judged, drive, case, {**KINDS, **RESIDUAL, **PAIRS}[case.kind])):
            if isinstance(each, str):
                found.append(each)
            else:
                worst = [max(known, (figure, case.kind)) for known, figure in zip(worst, each)]
    return found, worst


def violations(forker, mode, esc, every, sample):
    """Return what the cases of a drive show, or a sample of them."""
    chosen = [case for case in every if (case.mode, case.esc) == (mode, esc)]
    if not IS_ALL:
        chosen = random.Random(SEED).sample(chosen, min(sample, len(chosen)))
    found, worst = forker.submit(drive_all, mode, esc, chosen).result()
    print(*found, sep="\n")
    print(f"{len(chosen)} runs; at worst", *(f"{text.format(figure)} ({kind})" for text, (figure, kind) in
                                            zip(FIGURES, worst)), sep="\n  ")
    return found


@pytest.mark.once
@pytest.mark.parametrize("mode, esc", DRIVES)
def test_no_single_fault_breaks_a_goal(forker, mode, esc):
    """And no reaction takes more than a tick beyond time-out and delays."""
    assert violations(forker, mode, esc, single_cases(), SAMPLE) == []


@pytest.mark.once
@pytest.mark.parametrize("case", FOUND, ids=lambda case: case.kind)
def test_speed_that_is_known_to_a_metre_a_second_is_no_speed_to_brake_by(forker, case):
    """The first odometry after the link was gone: it brakes until the car drives backward, or pushes for a pull."""
    assert violations(forker, case.mode, case.esc, [case], 1) == []


@pytest.mark.once
@pytest.mark.parametrize("mode, esc", PAIRS_DRIVES)
def test_no_pair_of_faults_breaks_a_goal(forker, mode, esc):
    choose = random.Random(SEED)
    every = [Case(name, choose.randrange(MOMENTS), choose.choice(kind.modes), choose.choice(list(ESCS)),
                  choose.choice(kind.actions)) for name, kind in PAIRS.items() for _ in range(PAIRS_DRAWS)]
    assert violations(forker, mode, esc, every, PAIRS_SAMPLE) == []


def stalls_in_a_stop():
    """Have throttle_arb, which hears no board, stall for just under a standstill at moments of a stop by hand."""
    drive = Drive("manual", "brake_then_reverse")
    drive.hold(True, 1.0)
    drive.graph.run_until(lambda: drive.car.speed_mps > 2.0)
    drive.hold(False, 0.0)
    stopped_ns, slowest = drive.graph.now_ns, []

    def slowest_mps():
        drive.graph.link("/servo/output", receiver="/throttle_arb", loses=lambda data: True)
        drive.graph.nodes["/throttle_arb"].stall(0.5)
        drive.graph.run(1.5)
        return [min(each.twist.twist.linear.x for each in drive.graph.messages("/car_sim/truth", stopped_ns))]

    for after_s in (0.02, 0.05, 0.1, 0.15, 0.25):
        drive.graph.run_to(stopped_ns + round(after_s * NS_PER_S))
        slowest += forked(slowest_mps)
    return slowest


@pytest.mark.once
def test_what_throttle_arb_handles_late_is_decided_now_so_a_pull_that_the_board_let_go_of_is_not_given_again(forker):
    """Its messages arrived meanwhile, as it would have braked; but the ESC takes another pull for reverse."""
    assert min(forker.submit(stalls_in_a_stop).result()) > -NOISE_MPS


def freezes_in_a_pull():
    """Have the board's node freeze while a person pulls, for less time than its reports' timeout; these come late."""
    drive = Drive("human_throttle", "brake_then_reverse")
    drive.act("pull")
    drive.graph.run(0.1)
    begun_ns = drive.graph.now_ns

    def slowest_mps(duration_s):
        KINDS["output late"].make(drive)
        drive.graph.nodes["/pca9685"].stall(duration_s, frozen=True)
        drive.graph.run(1.5)
        return [min(each.twist.twist.linear.x for each in drive.graph.messages("/car_sim/truth", begun_ns))]
    return [each for duration_s in (0.35, 0.4, 0.5, 0.6) for each in forked(partial(slowest_mps, duration_s))]


@pytest.mark.once
def test_a_pull_that_the_guard_let_go_of_is_not_given_again_before_whoever_commands_it_can_know(forker):
    """An ESC that brakes first takes it for reverse, as the car stands by then."""
    assert min(forker.submit(freezes_in_a_pull).result()) > -NOISE_MPS


@pytest.mark.once
@pytest.mark.parametrize("risk", RESIDUAL)
def test_what_remains_is_found_by_the_same_judge(forker, risk):
    case = Case(risk, 7, "manual", "direct_reverse", "release")
    assert any(each.startswith("G1") for each in violations(forker, case.mode, case.esc, [case], 1))


@pytest.mark.once
def test_cases_pair_each_kind_with_each_moment_mode_esc_and_action():
    assert len(KINDS) >= 60
    pairs = {pair for case in single_cases() for pair in itertools.combinations(enumerate(case), 2)}
    factors = (list(KINDS), range(MOMENTS), list(MODES), list(ESCS), ACTIONS)
    for (one, ones), (other, others) in itertools.combinations(enumerate(factors), 2):
        for pair in itertools.product(ones, others):
            allowed = {2: "modes", 4: "actions"}.get(other) if one == 0 else None
            if allowed is None or pair[1] in getattr(KINDS[pair[0]], allowed):
                assert ((one, pair[0]), (other, pair[1])) in pairs, pair
