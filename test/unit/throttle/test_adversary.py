"""An adversary's sequences, a sample: no stop and no held brake that reverses. ``python3 test/adversary 100000`` and
``--sweep`` run them all; test/adversary says what is judged.
"""

import json
import os
from pathlib import Path

import pytest
from adversary import runs, world
from adversary.cases import FAULTS, SWEEP_CASES, SWEEP_FAULTS, random_case, sweep_case
from adversary.esc_model import BACKWARD, BBR, BRAKE, BTR, DIRECT, FORWARD, FORWARD_ONLY, FREE, EscModel, EscSpec

IS_LONG = bool(os.environ.get("CAR_INTERFACE_ALL"))
SEQUENCES, THIN = (20_000, 7) if IS_LONG else (150, 401)  # 401: no divisor of the sweep's numbers
SPEEDS_MPS = runs.STOP_SPEEDS if IS_LONG else (4.0,)
# Sequences that once reversed, or in which a reverse that was wanted did not come about.
FAILED = ("4022050", "6020433", "8069914", "9107457", "12012343", "12026936", "12028068")
BASELINE = Path(runs.__file__).with_name("stops.json")


def _failures(names):
    summary = runs.run_many(names, os.cpu_count() if IS_LONG else 1)
    return "\n".join(summary.lines()) if summary.failures or summary.got < summary.wanted else ""


@pytest.mark.once
def test_random_sequences_have_no_stop_and_no_brake_that_reverses():
    assert _failures([*map(str, range(SEQUENCES)), *FAILED]) == ""


@pytest.mark.once
def test_a_fault_at_any_moment_of_a_stop_makes_it_no_reverse():
    assert _failures([f"s{index}" for index in range(0, SWEEP_CASES, THIN)]) == ""


@pytest.mark.once
def test_stops_are_as_short_as_they_were():
    assert runs.longer_stops(json.loads(BASELINE.read_text()), runs.stop_distances(SPEEDS_MPS)) == []


@pytest.mark.once
@pytest.mark.parametrize("kind, text", [(BTR, "stop"), (DIRECT, "hold")])
def test_careless_rules_are_found_out(kind, text, monkeypatch):
    class Careless(world.ThrottleControl):
        def decide(self, now_ns):
            decision = super().decide(now_ns)
            asked = decision.arbitration
            return decision._replace(duty=world.NEUTRAL - 800 if asked.is_stop else decision.duty if asked.asked >= 0
                                     else world.NEUTRAL - 900)
    monkeypatch.setattr(world, "ThrottleControl", Careless)
    cases = [case for case in map(random_case, range(60)) if case.esc.kind == kind]
    reversals = [each for case in cases for each in world.World(case).run().reversals]
    assert sum(each.want == text and world.SLOWED not in each.faults for each in reversals) > 2


def test_each_fault_is_in_the_sweep_and_in_random_sequences():
    assert {name for _, *names in SWEEP_FAULTS for name in names} == set(FAULTS)
    assert {fault.name for seed in range(200) for fault in random_case(seed).faults} >= set(FAULTS)
    assert {case.group for case in map(sweep_case, range(0, SWEEP_CASES, 997))} == {"right", "unverified", "wrong"}


@pytest.mark.once
def test_a_seed_is_the_same_sequence_again():
    for name in ("7", "s4711"):
        assert runs.case_of(name) == runs.case_of(name)
        assert world.World(runs.case_of(name), tells=True).run().story == \
            world.World(runs.case_of(name), tells=True).run().story


@pytest.mark.parametrize("kind, rolling, held, second", [
    (BTR, BRAKE, BRAKE, BACKWARD), (BBR, BRAKE, BACKWARD, BACKWARD), (DIRECT, BRAKE, BACKWARD, BACKWARD),
    (FORWARD_ONLY, BRAKE, BRAKE, BRAKE)])
def test_esc_model_does_what_its_kind_does(kind, rolling, held, second):
    esc = EscModel(EscSpec(kind, dwell_s=0.2, hold_s=0.1))

    def after(pulse, wheel_mps, seconds):
        for _ in range(round(seconds * 200)):
            esc.step(pulse, wheel_mps, 0.005)
        return esc.motor
    assert after(0.0, 0.0, 0.3) == FREE and after(0.5, 1.0, 0.3) == FORWARD
    assert after(-0.5, 1.0, 0.5) == rolling
    assert after(-0.5, 0.0, 0.2) == held
    assert after(0.0, 0.0, 0.3) == FREE and after(-0.5, 0.0, 0.2) == second
