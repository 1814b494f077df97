"""What a drive came to: which class a collision is of, by what the cones truly met and how the car truly moved."""
from __future__ import annotations

import math
from typing import NamedTuple

from .drive import STEP_S, TICK_STEPS, Contact, Record

ECHO = "echo on that arc"
TURNED = "the arc began too late to stop on it"
OTHER_ARC = "echo on another arc only"
LOST = "every echo of it was lost"
NEVER = "never an echo of it"
ROLLED = "rolled by gravity"
RAN_AWAY = "rolled by gravity, and so fast that a stop should brake"
NONE = "no collision"
CLASSES = (ECHO, TURNED, OTHER_ARC, LOST, NEVER, RAN_AWAY, ROLLED)

TOUCH_MPS = 0.05  # slower is no collision
SAME_PLACE_M, SAME_ARC_PER_M = 0.25, 0.05
CREEPS_MPS, STANDS_MPS = 0.4, 0.02
SETTLES_S = 0.3  # of the motor, when a push ends
TICK_S = STEP_S * TICK_STEPS


class Verdict(NamedTuple):
    """A drive's end.

    Attributes:
        speed_mps: at contact, positive; 0 without one.
        scene: the draw, in short.
        known_s, known_m: how long, and how far, before the contact the place gave its first echo on that arc.
    """

    seed: int
    scene: str
    name: str
    speed_mps: float
    known_s: float
    known_m: float
    distance_m: float

    @property
    def is_collision(self) -> bool:
        """Whether it ran into something faster than a touch."""
        return self.speed_mps > TOUCH_MPS

    @property
    def is_known(self) -> bool:
        """Whether the place gave an echo on that arc."""
        return self.known_s > 0


def judge(record: Record) -> Verdict:
    """The class of a drive, or ``NONE``."""
    scene, contact = record.scene, record.contact
    if contact is None:
        return Verdict(scene.seed, scene.brief, NONE, 0.0, 0.0, 0.0, record.distance_m)
    began = _arc_began(record, contact)
    there = [echo for echo in record.echoes if _is_there(echo, contact)]
    known = [echo.at_s for echo in there if not echo.is_lost and echo.at_s >= record.samples[began].at_s]
    name = _class(record, contact, began, there, bool(known))
    first_s = min(known, default=contact.at_s)
    return Verdict(scene.seed, scene.brief, name, abs(contact.speed_mps), contact.at_s - first_s,
                   _driven_m(record, first_s), record.distance_m)


def _class(record, contact, began, there, is_known):
    if _has_rolled(record, contact):
        return RAN_AWAY if _is_sure_to_brake(record, contact) else ROLLED
    if is_known:
        return TURNED if _driven_m(record, record.samples[began].at_s) < _stop_m(record, began, there) else ECHO
    if any(not echo.is_lost for echo in there):
        return OTHER_ARC
    return LOST if there else NEVER


def _is_there(echo, contact):
    """Whether an echo came from the surface that was touched, or from the same box around its corner."""
    is_same = echo.name == contact.name or echo.name.split(".")[0] == contact.name.split(".")[0] != "wall"
    return is_same and math.dist((echo.x_m, echo.y_m), (contact.x_m, contact.y_m)) <= SAME_PLACE_M


def _arc_began(record, contact: Contact) -> int:
    """The first sample of the arc that the car drove up to the contact.

    It is the same arc as long as the curvature is; also where the speed alone widens the turn that its driver wants.
    """
    began = len(record.samples) - 1
    for number in range(began, -1, -1):
        sample = record.samples[number]
        if (abs(sample.curvature_per_m - contact.curvature_per_m) > SAME_ARC_PER_M
                and abs(sample.wanted_per_m - contact.wanted_per_m) > 1e-3):
            break
        began = number
    return began


def _driven_m(record, since_s):
    """How far the car drove from then to the contact."""
    return sum(abs(sample.speed_mps) for sample in record.samples if sample.at_s >= since_s) * TICK_S


def _way(contact):
    return math.copysign(1.0, contact.speed_mps)


def _coasts_mps2(record, sample, way):
    """How strongly this car slows by itself on this slope."""
    car = record.scene.car
    return car.drag_mps2 + car.drag_brake * car.brake_mps2 - way * sample.gravity_mps2


def _stop_m(record, began, there):
    """How far this very car goes, from the arc's beginning, if it stops as well as its ESC's kind lets it."""
    scene, sample, way = record.scene, record.samples[began], _way(record.contact)
    speed_mps = abs(sample.speed_mps)
    was_known = any(echo.at_s < sample.at_s and not echo.is_lost for echo in there)
    delay_s = 0.1 + scene.car.motor_lag_s + (0.0 if was_known else 6 * scene.firing_s)
    coasts_mps2 = max(0.05, _coasts_mps2(record, sample, way))
    brakes_mps2 = coasts_mps2 + scene.esc.stop_brake * scene.car.brake_mps2
    coasts_below_mps = 0.0 if scene.kind == "measured" else scene.esc.brake_margin_mps
    if way < 0:
        coasts_below_mps = math.inf  # no stop brakes a car that reverses
    slow_mps = min(speed_mps, coasts_below_mps)
    braking_m = (speed_mps ** 2 - slow_mps ** 2) / (2 * brakes_mps2)
    return speed_mps * delay_s + braking_m + slow_mps ** 2 / (2 * coasts_mps2)


def _has_rolled(record, contact):
    """Whether gravity alone brought the car there.

    Since it was last pushed that way it stood, or it crept at most when that ended and rolled on for a second. From
    there on drag took no more energy than gravity gave; or gravity was stronger than drag there, and on level ground
    the car would have stood before the contact.
    """
    way = _way(contact)
    pushed = max((sample.at_s for sample in record.samples if sample.request * way > 0.02), default=-1.0)
    since = [sample for sample in record.samples if sample.at_s > pushed + SETTLES_S]
    stood = [number for number, sample in enumerate(since) if abs(sample.speed_mps) < STANDS_MPS]
    if stood:
        since = since[stood[-1]:]
    elif len(since) * TICK_S <= 1.0 or abs(since[0].speed_mps) >= CREEPS_MPS:
        return False
    coasts_mps2 = [_coasts_mps2(record, sample, way) for sample in since]
    if sum(mps2 * abs(sample.speed_mps) for mps2, sample in zip(coasts_mps2, since)) <= 0.0:
        return True
    level_mps2 = coasts_mps2[0] + way * since[0].gravity_mps2
    return coasts_mps2[0] <= 0.0 and level_mps2 * _driven_m(record, since[0].at_s) >= since[0].speed_mps ** 2 / 2.0


def _is_sure_to_brake(record, contact):
    """Whether the page says that a stop brakes this car: forward, and well above ``esc/brake_margin``."""
    esc = record.scene.esc
    return record.scene.kind != "unverified" and contact.speed_mps > esc.brake_margin_mps + 0.1
