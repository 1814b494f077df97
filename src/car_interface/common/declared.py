"""Declares the parameters of a node, each once, as fields of the frozen dataclasses that use the values.

A declaration has the parameter's name, default, meaning, unit and range. From it come the reader with its one-line
errors (``read``), the node's --help and the table in docs/nodes.md (``rows``).

    @dataclass(frozen=True)
    class StickConfig:
        expo: float = declared.number("expo", 0.0, "0 = linear, 1 = the cube of the stick", low=0, high=1)
"""
from __future__ import annotations

from dataclasses import MISSING, field, fields
from functools import partial
from types import MappingProxyType
from typing import Any, Mapping, NamedTuple, Sequence

from car_interface.common.params import REQUIRED, Params
from car_interface.common.units import CHANNELS, MAX_DUTY

DECLARATION = "declaration"  # in a field's metadata
RANGES = {"path": "absolute path", "timeout": "s", "text": "text", "text_or_integer": "path or number"}  # by kind


class Parameter(NamedTuple):
    """The declaration of a parameter."""

    kind: str  # the method of Params that reads it
    name: str  # with a slash at its end: a namespace that has one parameter for each of ``family``
    text: str  # its meaning
    unit: str
    accepted: Mapping[str, Any]  # what that method takes beside name and default
    family: Sequence[str]
    same_as: str  # another parameter, whose value is the default
    default_text: str  # describes a default that is no constant

    def read(self, params: Params, namespace: str, default: Any) -> Any:
        """Return the value of a parameter, or the tuple of a family's.

        Raises:
            ConfigError: naming the parameter.
        """
        read = partial(getattr(params, self.kind), **self.accepted)
        if self.family:
            return tuple(read(f"{namespace}{self.name}{name}", one) for name, one in zip(self.family, default))
        return read(namespace + self.name, read(self.same_as, default) if self.same_as else default)


class Group(NamedTuple):
    """The declaration of a configuration within another one."""

    config_class: type
    namespace: str  # before its names
    same_as: Mapping[str, str]  # of its parameters, as Parameter.same_as


class Row(NamedTuple):
    """A parameter, as it is shown."""

    name: str
    default: str
    range: str
    text: str


def parameter(kind: str, name: str, default: Any, text: str, unit: str = "", family: Sequence[str] = (),
              same_as: str = "", default_text: str = "", **accepted: Any) -> Any:
    """Return a dataclass's field for a parameter that the method ``kind`` of Params reads; see ``Parameter``."""
    return _field(default, Parameter(kind, name, text, unit, accepted, family, same_as, default_text))


number, integer, numbers, integers, flag, text, path, text_or_integer, choice, timeout = (
    partial(parameter, kind) for kind in ("number", "integer", "numbers", "integers", "flag", "text", "path",
                                          "text_or_integer", "choice", "timeout"))
duty, duties = (partial(kind, unit="duty", low=0, high=MAX_DUTY) for kind in (integer, numbers))
channel = partial(integer, low=0, high=CHANNELS - 1)
duty_of_each = partial(integers, length=CHANNELS, unit="duty", low=0, high=MAX_DUTY)


def group(default: Any, namespace: str = "", same_as: Mapping[str, str] = MappingProxyType({}),
          config_class: type | None = None) -> Any:
    """Return a dataclass's field for another configuration.

    Args:
        default: the default, or the configuration's class where that has parameters that are required.
        namespace, same_as: see ``Group``.
        config_class: where the default is of another one.
    """
    is_required = isinstance(default, type)
    config_class = config_class or (default if is_required else type(default))
    return _field(REQUIRED if is_required else default, Group(config_class, namespace, same_as))


def _field(default, declaration):
    metadata = {DECLARATION: declaration}
    return field(metadata=metadata) if default is REQUIRED else field(default=default, metadata=metadata)


def read_all(params: Params, config_class: type, is_complete: bool = True, default: Any = None) -> Any:
    """Return a node's configuration, and refuse names that it hasn't, unless they are below its ``SHARED``.

    Of the arguments see ``read``.

    Raises:
        ConfigError: naming the parameter.
    """
    config = read(params, config_class, is_complete, default)
    params.finish(getattr(config_class, "SHARED", ()))
    return config


def read(params: Params, config_class: type, is_complete: bool = True, default: Any = None, namespace: str = "",
         same_as: Mapping[str, str] = MappingProxyType({})) -> Any:
    """Return a configuration from the parameters that its fields declare.

    Args:
        config_class: the dataclass. Where it has a method ``completed(params)``, that returns what the node uses.
        is_complete: false = as the parameters alone say, without that.
        default: has other defaults than the class.
        namespace: before the names.
        same_as: by a parameter's name another one, whose value is the default.

    Raises:
        ConfigError: naming the parameter.
    """
    values = {}
    for name, declaration, one in _declarations(config_class, default, same_as):
        if isinstance(declaration, Group):
            values[name] = read(params, declaration.config_class, is_complete, None if one is REQUIRED else one,
                                namespace + declaration.namespace, declaration.same_as)
        else:
            values[name] = declaration.read(params, namespace, one)
    config = config_class(**values)
    return config.completed(params) if is_complete and hasattr(config, "completed") else config


def check(config: Any) -> None:
    """Refuse a configuration that was not read from parameters as ``read`` would.

    Raises:
        ConfigError: naming the parameter.
    """
    for name, declaration, default in _declarations(type(config)):
        value = getattr(config, name)
        if isinstance(declaration, Parameter) and value is not default:
            declaration.read(Params({declaration.name: value}), "", default)


def parameter_of(config_class: type, field_name: str) -> Parameter:
    """Return the declaration of a field."""
    return next(declaration for name, declaration, _ in _declarations(config_class) if name == field_name)


def rows(config_class: type) -> list[Row]:
    """Return the parameters of a configuration, each once."""
    return list(dict.fromkeys(_rows(config_class)))


def _rows(config_class, default=None, namespace="", same_as=MappingProxyType({})):
    for _, declaration, one in _declarations(config_class, default, same_as):
        if isinstance(declaration, Group):
            yield from _rows(declaration.config_class, None if one is REQUIRED else one,
                             namespace + declaration.namespace, declaration.same_as)
        else:
            shown = declaration.default_text or _default_text(one)
            if declaration.same_as:
                shown = f"`{declaration.same_as}`, else {shown}"
            yield Row(_name_text(declaration, namespace), shown, _range_text(declaration), declaration.text)


def _declarations(config_class, default=None, same_as=MappingProxyType({})):
    """Yield field name, declaration and default of each declared field; of the arguments see ``read``."""
    for each in fields(config_class):
        declaration = each.metadata.get(DECLARATION)
        if declaration is not None:
            if isinstance(declaration, Parameter) and declaration.name in same_as:
                declaration = declaration._replace(same_as=same_as[declaration.name])
            value = each.default if default is None else getattr(default, each.name)
            yield each.name, declaration, REQUIRED if value is MISSING else value


def _name_text(declaration, namespace):
    names = [f"`{namespace}{declaration.name}{name}`" for name in declaration.family or ("",)]
    return names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}"


def _default_text(value):
    if value is REQUIRED:
        return "required"
    if isinstance(value, str):
        return f"`{value}`" if value else "none"
    if isinstance(value, tuple) and value and len(set(value)) == 1:
        return _default_text(value[0])
    return "" if value is None else _number_text(value) if isinstance(value, (int, float)) else str(list(value))


def _number_text(value):
    if isinstance(value, bool):
        return str(value).lower()
    return (str(int(value)) if value == int(value) else f"{value:.4g}").replace("-", "−")


def _range_text(declaration):
    accepted = declaration.accepted
    low, high, above = (accepted.get(name) for name in ("low", "high", "above"))
    bounds = ""
    if "choices" in accepted:
        bounds = ", ".join(f"`{choice}`" for choice in accepted["choices"])
    elif above is not None:
        bounds = f"above {_number_text(above)}" + ("" if high is None else f", up to {_number_text(high)}")
    elif low is not None:
        bounds = f"at least {_number_text(low)}" if high is None else f"{_number_text(low)}..{_number_text(high)}"
    several = f"one or {accepted['length']}" if "length" in accepted else ""
    return ", ".join(filter(None, (declaration.unit or RANGES.get(declaration.kind, ""), bounds, several)))
