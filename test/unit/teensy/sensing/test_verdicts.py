"""The answer of a plausibility gate about one record, and the texts of its reasons."""
from __future__ import annotations

import pytest

from car_interface.teensy.sensing import verdicts
from car_interface.teensy.sensing.verdicts import FINE, Verdict

REASONS = {name: text for name, text in vars(verdicts).items() if name.isupper() and isinstance(text, str)}


def test_verdict_has_neither_pulses_nor_a_restart_by_default():
    verdict = Verdict(False, verdicts.TICK_BACK)
    assert (verdict.accepted, verdict.reason) == (False, "a tick that goes back")
    assert (verdict.pulses, verdict.unproven) == ((0, 0), (0, 0))
    assert verdict.restarted is False and verdict.boot_tick is None


def test_fine_is_an_accepted_record_with_nothing_notable():
    assert FINE == Verdict(True, "") == (True, "", (0, 0), False, (0, 0), None)


def test_verdict_cannot_be_changed():
    with pytest.raises(AttributeError):
        FINE.accepted = False


def test_every_reason_is_a_different_text():
    # Reasons are counted and shown by their texts: two equal ones would be counted as one.
    assert len(set(REASONS.values())) == len(REASONS) == 21


@pytest.mark.parametrize("name", sorted(REASONS))
def test_reason_is_one_line_that_goes_into_a_sentence(name):
    text = REASONS[name]
    assert text and text == text.strip() and "\n" not in text
    assert text[0].islower() and not text.endswith(".")
