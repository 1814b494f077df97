"""Reports of wheels, spelled out, and what a gate makes of them."""
import math

from car_interface.teensy.link.protocol import FORWARD, NO_DIRECTION, SonarStatus, Wheel, WheelStatus
from car_interface.teensy.sensing.plausibility import Gates

PULSE_M = math.pi * 0.095 / 20
HARM_M = 0.10
NEW = Wheel(0, NO_DIRECTION, 0, 0, 0)
START_MS = 50_000


def forward(pulses, when, dist=1):
    """A wheel that has gone forward all the time."""
    return Wheel(10, FORWARD, when, dist, pulses)


def report(left, right=None):
    return WheelStatus(left, left if right is None else right)


def crawl(count, first=100, step_ms=50, start_ms=START_MS):
    """Reports of a car at 0.3 m/s, a pulse of both wheels in each."""
    return [report(forward(first + index, start_ms + step_ms * index)) for index in range(count)]


def judged(records, judge):
    return [judge(record) for record in records]


def proven(verdicts):
    """The pulses of both wheels whose direction is known."""
    return tuple(sum(verdict.pulses[side] for verdict in verdicts) for side in (0, 1))


def counted(verdicts):
    """The pulses of both wheels; those whose direction is not known count forward."""
    return tuple(sum(verdict.pulses[side] + verdict.unproven[side] for verdict in verdicts) for side in (0, 1))


def crawling(ticks=()):
    """Gates that have seen five reports of a crawl, the last one is (104, START_MS + 200), and sonars' ticks."""
    some = Gates()
    judged(crawl(5), some.wheels)
    judged(map(sonar, ticks), some.sonar)
    return some


def crawled(count):
    """How the crawl goes on."""
    return crawl(5 + count)[5:]


LAST = crawl(5)[-1].left
NEXT = crawl(6)[-1].left


def sonar(when, echo_us=5000):
    return SonarStatus(1, echo_us, when)
