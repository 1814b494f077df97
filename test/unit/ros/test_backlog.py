"""When a thread that comes late, or whose step lasts, has stood still; a busy computer's delays don't count."""
import pytest

pytest.importorskip("rospy")

from car_interface.ros.backlog import STANDSTILL_NS, StandstillWatch

MS = 1_000_000
START = 1000 * 1000 * MS


def standstills(*steps):
    """For how long, ms, the thread has stood still before each of its steps.

    Args:
        steps: (waits, lasts, due): ms from the end of the step before to this one's begin, ms that it lasts, and ms
            from its end to when the next one is due.
    """
    now_ns, watch, found = START, StandstillWatch(START), []
    for waits, lasts, due in steps:
        now_ns += round(waits * MS)
        found.append(watch.begin_step(now_ns) // MS)
        now_ns += round(lasts * MS)
        watch.end_step(now_ns, now_ns + due * MS)
    return found


@pytest.mark.parametrize("steps, expected", [
    ([(0, 0.1, 10)] + [(10, 0.1, 10)] * 99, [0] * 100),
    ([(0, 0.1, 10), (0.2, 0.1, 10), (0, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 10), (3010, 0.1, 10), (10, 0.1, 10)], [0, 3000, 0]),
    ([(0, 0.1, 10), (10, 3000, 10), (0, 0.1, 10), (10, 0.1, 10)], [0, 0, 3000, 0]),
    ([(0, 0.1, 10), (310, 0.1, 10), (10, 300, 10), (310, 0.1, 10)], [0, 0, 0, 0]),
    ([(0, 0.1, 10), (509, 0.1, 10), (510, 0.1, 10)], [0, 0, 500]),
    ([(0, 0.1, 10), (10, 400, 10), (400, 400, 10), (400, 0.1, 10)], [0] * 4),
    ([(0, 0.1, float("inf")), (1000, 0.1, 60_000), (1000, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 60_000), (4000, 0.1, 10)], [0, 3000]),
    ([(0, 0.1, -700), (1, 0.1, -700), (1, 0.1, 10)], [0, 0, 0]),
    ([(700, 0.1, 10)], [700]),
])
def test_standstill(steps, expected):
    assert standstills(*steps) == expected


def test_limit_is_the_timeout_of_the_arbiters_inputs():
    from car_interface.interlock.motion_interlock import InterlockConfig
    assert round(InterlockConfig.human_timeout_s * 1e9) == STANDSTILL_NS
