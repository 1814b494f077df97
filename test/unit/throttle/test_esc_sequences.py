"""Virtual ESCs driven at random through the state machine: no reverse that nobody meant, and each that was wanted.

What holds: with the right profile, no push backward that nobody meant, known speed or not, and with speed every wanted
reversal; with a wrong profile or none, no stop that becomes reverse; with speed, a wrong profile pushes the car
backward for no more than half a second.

What can't hold: with a wrong profile and no speed, a person's or a planner's own pull may be reverse for as long as
it is held. Without pulses an ESC does for a while what it did, and a node that is away is obeyed until the board's
timeout. A guard's neutral must be on /servo/output sooner than the ESC's dwell (0.1 s): here it is within 0.06 s.
"""

import os

import esc_sequences
import pytest
from esc_sequences import failure, run, summed_up
from many_drives import run_on_all_cores

IS_LONG = bool(os.environ.get("CAR_INTERFACE_ALL"))
DRIVES = 100_000 if IS_LONG else 120


@pytest.mark.once
def test_random_drives():
    found, totals = summed_up(run_on_all_cores(run, DRIVES) if IS_LONG else map(run, range(DRIVES)))
    assert found == []
    assert totals["drives"] == DRIVES
    assert totals["got"] == totals["wanted"] > DRIVES / 10
    assert all(totals[f"state {name}"] > DRIVES for name in
               ("ARMING", "NEUTRAL", "FORWARD", "BRAKING", "HOLD", "REVERSE"))
    assert totals["backward"] > DRIVES / 50, "wrong profiles did nothing wrong: the drives are too tame"


@pytest.mark.once
@pytest.mark.parametrize("stop, text", [(-0.4, "a stop became reverse"), (0.0, "reverse that nobody meant")])
def test_careless_rules_are_found_out(stop, text, monkeypatch):
    class Careless(esc_sequences.Esc):
        def step(self, request, now_ns):
            return super().step(request, now_ns)._replace(fraction=stop if request.is_stop else request.value)
    monkeypatch.setattr(esc_sequences, "Esc", Careless)
    assert sum(text in failure(run(seed)) for seed in range(30)) > 2
