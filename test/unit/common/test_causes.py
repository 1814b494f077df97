"""The cause constants and their sets."""
from car_interface.common import causes

CONSTANTS = {name: value for name, value in vars(causes).items() if name.isupper()}
CAUSES = {name: value for name, value in CONSTANTS.items() if isinstance(value, str)}


def test_causes_named_stale_or_not_finite_are_losses():
    for name, cause in CAUSES.items():
        assert (cause in causes.STALE) == name.endswith("_STALE")
        assert (cause in causes.NOT_FINITE) == name.endswith("_NOT_FINITE")
    assert causes.STALE | causes.NOT_FINITE < causes.LOSSES


def test_the_interlock_inhibits_by_the_e_stop_and_by_the_human():
    assert causes.LOCKS < causes.INHIBITS and causes.HUMAN_ABSENT in causes.INHIBITS


def test_what_an_operator_does_is_no_loss():
    assert not causes.LOSSES & {causes.E_STOP, causes.HUMAN_ABSENT, causes.NO_DEADMAN, causes.STARTING,
                                causes.NO_RADIUS, causes.TELEOP, causes.PLANNER, causes.DRIVING, causes.CONVERTING}
