"""The causes of turn_arb's reasons in recordings that were made before SteeringState had the field ``cause``.

This table is for such recordings only: reasons may change, causes are data.
"""
from __future__ import annotations

from typing import Any

from car_interface.common import causes

UNKNOWN = ""
# How the reasons of those versions begin; the first that fits counts.
BEGINNINGS = (
    ("e_stop is true", causes.E_STOP),
    ("e_stop silent for ", causes.E_STOP_STALE),
    ("e_stop was not heard since ", causes.E_STOP_STALE),
    ("e_stop was never heard", causes.E_STOP_NEVER_RECEIVED),
    ("this node has just started: it waits", causes.STARTING),
    ("messages were dropped: it waits", causes.STARTING),
    ("this node has just started", causes.NOT_REARMED),
    ("messages were dropped", causes.NOT_REARMED),
    ("the lock was on", causes.NOT_REARMED),
    ("human_in_loop was silent", causes.NOT_REARMED),
    ("human_in_loop silent for ", causes.HUMAN_STALE),
    ("human_in_loop was not heard since ", causes.HUMAN_STALE),
    ("human_in_loop was never heard", causes.HUMAN_NEVER_RECEIVED),
    ("human_in_loop is false", causes.HUMAN_ABSENT),
    ("tele_steer_req silent for ", causes.TELEOP_STALE),
    ("tele_steer_req was not heard since ", causes.TELEOP_STALE),
    ("tele_steer_req is nan", causes.TELEOP_NOT_FINITE),
    ("tele_steer_req is inf", causes.TELEOP_NOT_FINITE),
    ("tele_steer_req is -inf", causes.TELEOP_NOT_FINITE),
    ("tele_steer_req is ", causes.TELEOP),
    ("av_turnrad_req silent for ", causes.PLANNER_STALE),
    ("av_turnrad_req was not heard since ", causes.PLANNER_STALE),
    ("av_turnrad_req is nan", causes.PLANNER_NOT_FINITE),
    ("av_turnrad_req is inf", causes.PLANNER_NOT_FINITE),
    ("av_turnrad_req is -inf", causes.PLANNER_NOT_FINITE),
    ("av_turnrad_req is 0,", causes.NO_RADIUS),
    ("av_turnrad_req is ", causes.PLANNER),
    ("neither tele_steer_req nor av_turnrad_req", causes.NO_REQUEST),
)


def cause_of(state: Any) -> str:
    """The cause in a SteeringState message; UNKNOWN if it has none and its reason isn't in the table."""
    if hasattr(state, "cause"):
        return state.cause
    return next((cause for beginning, cause in BEGINNINGS if state.reason.startswith(beginning)), UNKNOWN)
