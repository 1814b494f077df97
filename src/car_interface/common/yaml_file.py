"""Reads YAML files with parameters; nothing else in this package reads YAML.

A file that can't be a person's parameters is refused before anything is built from it: too large, too deeply nested,
with aliases that contain themselves or multiply. So is a name that is given twice, of which YAML itself would silently
take the last value.
"""
from __future__ import annotations

import functools
from typing import Any

from car_interface.common.errors import ConfigError, within
from car_interface.common.input_file import finite_number, read_file

MAX_BYTES = 1_000_000  # the package's own files have at most 2 kB; this much takes 2 s to read
MAX_LEVELS = 100  # of lists and mappings in each other; the reader needs 3 of Python's 1,000 frames for each
# With aliases, each counted as all values that it stands for: about as many as 1 MB holds without aliases.
MAX_VALUES = 100_000
MAX_DIGITS = 100  # of a number: a float's shortest text has at most 24, and the time for many grows with their square
ACCEPTED = "YAML lines of a parameter's name, a colon and its value"


def load_yaml(path: str, text: str | None = None) -> dict[str, Any]:
    """Load the parameters in a YAML file, as ROS would.

    Args:
        text: what the file has or is going to have; ``None`` = it is read.

    Raises:
        ConfigError: naming the file, the line and what is accepted.
    """
    return _read(read_yaml(path) if text is None else text, path, lambda loader, root: loader.construct_document(root))


def read_yaml(path: str) -> str:
    """Read the text of a YAML file, with ``\\n`` for every line end and no byte-order mark.

    Raises:
        ConfigError: naming the file.
    """
    try:
        text = decode_yaml(read_file(path, MAX_BYTES), path)
    except OSError as error:
        raise ConfigError(path, path, "a file that can be read", f"can't be read ({error.strerror})") from error
    return text.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def decode_yaml(data: bytes, path: str) -> str:
    """Decode a YAML file's content; all of its characters stay.

    Raises:
        ConfigError: naming the file and the line.
    """
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}, line {line}", None, "parameters in YAML, UTF-8", "is no text in UTF-8") from error


def compose_yaml(text: str, path: str):
    """Return the tree of a YAML text that is a mapping: PyYAML's node. The path is for errors.

    Raises:
        ConfigError: naming the file, the line and what is accepted.
    """
    return _read(text, path, lambda loader, root: root)


def scalar_number(text: str) -> float | None:
    """Return the number that a scalar's text is to the parameter server and then to a node, or ``None``."""
    import yaml
    loader = _loader_class()("")
    try:
        tag = loader.resolve(yaml.ScalarNode, text, (True, False))
        if tag in (_tag("int"), _tag("float")):
            number = loader.construct_object(loader.checked(yaml.ScalarNode(tag, text, loader.get_mark())))
            return None if number != number else number  # nan is equal to nothing
        return finite_number(text) if tag == _tag("str") else None
    except (ConfigError, yaml.YAMLError):
        return None


def _read(text, path, result):
    """Return ``result`` of the loader and the root of a text."""
    import yaml
    try:
        with within(path):  # the loader's names the lines alone
            loader = _loader_class()(text)
            root = loader.get_single_node()
            if isinstance(root, yaml.MappingNode):
                return result(loader, root)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise ConfigError(f"{path}, line {line}", None, "parameters in YAML",
                          f"is no YAML: U+{error.character:04X} is no character of a text") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        raise ConfigError(f"{path}, line {mark.line + 1}" if mark else path, None, "parameters in YAML",
                          f"is no YAML: {' '.join(problem.split())}") from error
    raise ConfigError(path, None, ACCEPTED, "has no such lines")


@functools.lru_cache(maxsize=None)
def _loader_class():
    """Return the loader; yaml is imported when it is first needed, since importers need the standard library alone."""
    import yaml

    class Loader(yaml.SafeLoader):
        """PyYAML's loader with limits that are checked before more is built."""

        def __init__(self, text):
            super().__init__(text)
            self._values = 0  # so far
            self._level = self._deepest_level = 0
            self._open_anchors = []  # of the lists and mappings that are being read
            self._extents = {}  # by anchor: values, levels

        def compose_node(self, parent, index):
            event = self.peek_event()
            if isinstance(event, yaml.AliasEvent):
                self._check_alias(event)
                return super().compose_node(parent, index)
            values, level, deepest_level = self._values, self._level, self._deepest_level
            self._count(event, 1, isinstance(event, yaml.CollectionStartEvent))
            self._level = self._deepest_level  # inside of this node
            self._open_anchors.append(event.anchor)
            node = super().compose_node(parent, index)
            self._open_anchors.pop()
            if event.anchor is not None:
                self._extents[event.anchor] = self._values - values, self._deepest_level - level
            self._level, self._deepest_level = level, max(deepest_level, self._deepest_level)
            return self.checked(node)

        def _check_alias(self, event):
            if event.anchor in self._open_anchors:
                raise ConfigError(_line(event), None, "aliases of values that are complete before them",
                                  f"has *{_short(event.anchor)} inside of what it stands for")
            deepest_level = self._deepest_level
            self._count(event, *self._extents.get(event.anchor, (1, 0)))
            self._deepest_level = max(deepest_level, self._deepest_level)
            if self._values > MAX_VALUES:
                raise ConfigError(_line(event), None, f"aliases for at most {MAX_VALUES:,} values in all",
                                  f"makes more than {MAX_VALUES:,} values by its aliases")

        def _count(self, event, values, levels):
            self._values += values
            self._deepest_level = self._level + levels
            if self._deepest_level > MAX_LEVELS:
                raise ConfigError(_line(event), None, f"at most {MAX_LEVELS} levels",
                                  f"is nested more than {MAX_LEVELS} levels deep")

        def checked(self, node):
            """Return the node, if it has no name twice and no endless number."""
            if isinstance(node, yaml.MappingNode):
                _check_names(key for key, _ in node.value if isinstance(key, yaml.ScalarNode))
            elif node.tag in (_tag("int"), _tag("float")) and len(node.value) > MAX_DIGITS:
                raise ConfigError(_line(node), None, f"at most {MAX_DIGITS} digits",
                                  f"has a number of {len(node.value)} digits")
            return node

        def construct_object(self, node, deep=False):
            try:
                return super().construct_object(node, deep)
            except (ConfigError, yaml.YAMLError):
                raise
            except Exception as error:  # of a value that isn't what its tag says PyYAML raises almost anything
                value = _short(node.value) if isinstance(node, yaml.ScalarNode) else "its value"
                raise ConfigError(_line(node), None, "parameters in YAML",
                                  f"is no YAML: {value} is no {node.tag.rpartition(':')[2]}") from error

    return Loader


def _check_names(keys):
    """Refuse a name that a mapping gives twice."""
    lines = {}
    for key in keys:
        line, name = key.start_mark.line + 1, _short(key.value)
        first = lines.get(key.value)
        if first == line:
            raise ConfigError(f"line {line}", None, "each name once", f"gives {name} twice")
        if first is not None:
            raise ConfigError(f"lines {first} and {line}", None, "each name once", f"both give {name}")
        lines[key.value] = line


def _line(marked):
    return f"line {marked.start_mark.line + 1}"


def _short(text, limit=40):
    """Return a name or value, shortened for a message of one line."""
    text = " ".join(text.split()) if text.isprintable() else repr(text)
    return text if len(text) <= limit else text[:limit - 1] + "…"


def _tag(name):
    return f"tag:yaml.org,2002:{name}"
