"""Changes single values in a YAML text and keeps every other character of it, comments included.

``save`` does it in a file, which is replaced in one step; a backup stays in its folder, under a name with the time.
``edited`` does it in a text; ``rewritten`` makes a new text after the pattern of another one.
"""
from __future__ import annotations

import errno
import os
import re
from contextlib import suppress
from typing import Mapping, Sequence, Union

from car_interface.common.atomic_file import is_write_protected, replace
from car_interface.common.errors import ConfigError, require
from car_interface.common.input_file import read_file
from car_interface.common.yaml_file import MAX_BYTES, compose_yaml, decode_yaml, load_yaml, scalar_number

Value = Union[int, float, str, Sequence[Union[int, float]]]  # bool is an int
Values = Mapping[str, Value]  # by name; one inside a mapping as ``servo/neutral``
SCALAR, LIST, MAPPING = "scalar", "sequence", "mapping"  # the kinds of PyYAML's nodes
COMMENT_BEHIND = re.compile(r"[ \t]+#[^\r\n]*")


def save(path: str, values: Values) -> str | None:
    """Write ``values`` into the file at ``path``; a link is followed.

    Returns:
        The backup's path; ``None``: the file had these values already, and nothing was written.

    Raises:
        ConfigError: naming the file and why it was not changed.
    """
    path = os.path.realpath(path)
    try:
        before = decode_yaml(read_file(path, MAX_BYTES), path)
        if is_write_protected(path):
            raise PermissionError(errno.EACCES, "it is write-protected")
        after = edited(before, values, path)
        return None if after == before else replace(path, after.encode("utf-8"), keeps_old=True)
    except OSError as error:
        raise ConfigError(path, None, "a file that this node may read and write, in a folder where it may too",
                          f"can't be saved ({error.strerror})") from error


def edited(text: str, values: Values, path: str = "the file", keeps_comments: bool = True) -> str:
    """Return the text of a YAML file with ``values`` replaced; names that it lacks are appended.

    Args:
        values: those that it has already are left alone, however they are spelled.
        keeps_comments: otherwise the comment behind a value that changes is removed: it may describe the old value.

    Raises:
        ConfigError: it can't be done without changing anything else.
    """
    root = compose_yaml(text, path)
    nodes = {name: _find(root, name.split("/")) for name in values}
    require(any(nodes.values()), path, None, "a file with at least one of them", f"has none of {', '.join(values)}")
    added = {name: value for name, value in values.items() if nodes[name] is None}
    for name in added:
        require("/" not in name, path, None, f"a file with {name}", "lacks it")
    edits_of = {name: _edits(nodes[name], value) for name, value in values.items() if name not in added}
    changed = [name for name, found in edits_of.items() if found]
    edits = [edit for found in edits_of.values() for edit in found]
    if not keeps_comments:
        edits += _comments_behind(text, edits, [nodes[name] for name in changed])
    result = text
    for begin, end, new_text in sorted(edits, reverse=True):
        result = result[:begin] + new_text + result[end:]
    if added and not result.endswith("\n"):
        result += "\n"
    result += "".join(f"{name}: {_format(value)}\n" for name, value in added.items())
    wanted = {name: _plain(values[name]) for name in (*changed, *added)}
    with suppress(ConfigError):
        if _content(compose_yaml(result, path)) == _merged(_content(root), wanted):
            return result
    raise ConfigError(path, None, "plain values, each written out in its place", "can't be edited safely")


def rewritten(text: str, values: Values, head: Sequence[str], path: str = "the file") -> str:
    """Return a new YAML text after the pattern of ``text``: its other values, layout and comments stay.

    Comments behind values that change are removed, and the comments before the first name are replaced by ``head``.
    Names that the pattern lacks are added, those inside a mapping at its end. A text that can't be edited safely is
    written from its values, without its comments.

    Args:
        head: lines of the comment at the top.

    Raises:
        ConfigError: the pattern is no mapping in YAML.
    """
    import yaml
    body = text[compose_yaml(text, path).start_mark.index:]
    try:
        body = edited(_with_names(body, values, path), values, path, keeps_comments=False)
    except ConfigError:
        body = yaml.safe_dump(_merged(load_yaml(path, text), values), sort_keys=False)
    return "".join(f"# {line}".rstrip() + "\n" for line in head) + "\n" + body


def _with_names(text, values, path):
    """Return the text with each name of ``values`` that lies inside a mapping added, with the value 0.

    A mapping on one line is left as it is.
    """
    for name in values:
        outer, _, inner = name.rpartition("/")
        root = compose_yaml(text, path)
        if not outer or _find(root, name.split("/")) is not None:
            continue
        mapping = _find(root, outer.split("/"))
        if mapping is None and "/" not in outer:
            text += ("" if text.endswith("\n") else "\n") + f"{outer}:\n  {inner}: 0\n"
        elif mapping is not None and mapping.id == MAPPING and not mapping.flow_style:
            key, last = mapping.value[-1]
            end = text.find("\n", last.end_mark.index - (last.end_mark.column == 0))
            end = len(text) if end < 0 else end
            text = f"{text[:end]}\n{' ' * key.start_mark.column}{inner}: 0{text[end:]}"
    return text


def _merged(content, values):
    """Return the content of a document with ``values`` in it."""
    content = dict(content)
    for name, value in values.items():
        outer, _, inner = name.partition("/")
        inside = content.get(outer)
        content[outer] = _merged(inside if isinstance(inside, dict) else {}, {inner: value}) if inner else value
    return content


def _find(node, names):
    """Return the node of a value, or None."""
    for name in names:
        pairs = node.value if node is not None and node.id == MAPPING else ()
        node = next((value for key, value in pairs if key.value == name), None)
    return node


def _edits(node, value):
    """Return the ranges of text to replace, as (begin, end, text), for the elements that differ.

    One number stands for a list of equal ones.
    """
    if node.id == LIST and isinstance(value, (list, tuple)) and len(node.value) == len(value):
        return [edit for element, number in zip(node.value, value) for edit in _edits(element, number)]
    if isinstance(value, (str, bool)):
        is_same = node.value == _format(value)
    else:
        numbers = value if isinstance(value, (list, tuple)) else [value]
        is_same = node.id == SCALAR and all(number == scalar_number(node.value) for number in numbers)
    return [] if is_same else [(node.start_mark.index, node.end_mark.index, _format(value))]


def _comments_behind(text, edits, nodes):
    """Return the comments on the lines where edits end, as edits that remove them."""
    ends = {end for _, end, _ in edits} | {node.end_mark.index for node in nodes}
    found = (COMMENT_BEHIND.match(text, end) for end in ends)
    return [(match.start(), match.end(), "") for match in found if match]


def _format(value):
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_format(element) for element in value) + "]"
    return str(int(value)) if value == int(value) else repr(float(value))


def _content(node):
    """Return the content of a document as Python values: what is a number to a node as a number, the rest as texts."""
    if node.id == LIST:
        return [_content(element) for element in node.value]
    if node.id == MAPPING:
        return {str(key.value): _content(value) for key, value in node.value}
    number = scalar_number(node.value)
    return node.value if number is None else number


def _plain(value):
    """Return a new value as ``_content`` has it."""
    return list(value) if isinstance(value, (list, tuple)) else _format(value) if isinstance(value, bool) else value
