"""The causes of reasons in recordings from before SteeringState had one."""
from __future__ import annotations

from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.tools.report.old_reasons import UNKNOWN, cause_of


@pytest.mark.parametrize("reason, is_loss", [
    ("human_in_loop silent for 0.52 s", True), ("tele_steer_req is nan, no number to act on", True),
    ("human_in_loop was silent; let go once: publish false, then true", True), ("human_in_loop is false", False),
    ("human_in_loop was silent: let go of the deadman, then hold it again", True),
    ("the lock was on: let go of the deadman, then hold it again", True),
    ("this node has just started; let go once: publish false, then true", True),
    ("this node has just started: it waits up to 1 s for e_stop", False),
    ("human_in_loop was not heard since messages were dropped", True),
    ("av_turnrad_req is 0, which asks for nothing", False), ("av_turnrad_req is 2.000 m", False),
    ("neither tele_steer_req nor av_turnrad_req asks for anything", False)])
def test_loss_is_distinguished_from_a_missing_request(reason, is_loss):
    assert (cause_of(SimpleNamespace(reason=reason)) in causes.LOSSES) == is_loss


def test_cause_in_the_message_counts_whatever_its_reason_says():
    assert cause_of(SimpleNamespace(cause=causes.PLANNER, reason="human_in_loop is false")) == causes.PLANNER


def test_reason_that_is_not_in_the_table_has_an_unknown_cause():
    assert cause_of(SimpleNamespace(reason="something else")) == UNKNOWN
