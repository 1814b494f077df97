"""How the simulator's configurations refuse what no car could be."""

from car_interface.common.errors import ConfigError


def require(fine: bool, name: str, value: object, accepted: str):
    """Raises ConfigError, naming the parameter, what it is and what is accepted, unless ``fine``."""
    if not fine:
        raise ConfigError(name, value, accepted)
