"""The commands for recordings and tables: ``car-interface COMMAND …``, and ``rosrun car_interface COMMAND …``.

A command is a module with ``add_arguments(parser)`` and ``run(options)``, which returns the exit code: 0 done,
1 refused or failed, with one line that says why. argparse ends with 2 on options that it doesn't know.
This module imports no library, so that a limit of memory, or one that isn't installed, ends with one line, too.
"""
from __future__ import annotations

import argparse
import codecs
import importlib
import os
import signal
import sys
from importlib import metadata
from typing import Sequence
from xml.etree import ElementTree

from car_interface.common import process_setup
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file

PACKAGE, PROGRAM = "car_interface", "car-interface"
MODULES = {name: f"car_interface.tools.cli.{name}" for name in (
    "bag_report", "calibrate_esc", "calibrate_steering", "calibrate_value_map", "check_map", "drives")}
INSTALL = "see docs/recordings.md, Install the tools"
# Libraries whose package has another name.
PACKAGES = {"yaml": "PyYAML", "ruamel": "ruamel.yaml"}
# For terminals with ASCII only.
PLAIN = {"█": "#", "│": "|", "└": "+", "─": "-", "²": "2", "±": "+-", "°": " deg", "…": "...", "−": "-", "×": "x"}
INTERRUPTED = 128 + signal.SIGINT


def main(command: str | None = None, arguments: Sequence[str] | None = None) -> int:
    """Run a command, ``None`` = the first of the arguments (by default the process's); return the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    codecs.register_error("car_interface.plain", _plain)
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="car_interface.plain")
    try:
        process_setup.prepare()
        parser = _parser(command, arguments)
        options = parser.parse_args(arguments)
        process_setup.reserve_blas()
        code = options.run(options)
        sys.stdout.flush()  # while a broken pipe can still be caught
        return code
    except CarInterfaceError as error:
        return _failed(command, error)
    except ModuleNotFoundError as error:
        if (error.name or "car_interface").startswith("car_interface"):
            raise
        library = error.name.split(".")[0]
        return _failed(command, f"this needs {PACKAGES.get(library, library)}, which isn't installed: {INSTALL}")
    except BrokenPipeError:  # the reader, such as head, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        why = process_setup.describe_shortage(error)
        if why is None and isinstance(error, OSError) and error.filename is not None:
            why = f"{error.filename}: {error.strerror}"
        if why is None:
            raise
        return _failed(command, why)


def version() -> str:
    """Return the version in package.xml; where pip installed the package without that, in its metadata.

    Raises:
        CarInterfaceError: there is neither.
    """
    try:
        return ElementTree.parse(str(package_file("package.xml"))).findtext("version")
    except CarInterfaceError:
        pass
    try:
        return metadata.version(PACKAGE)
    except metadata.PackageNotFoundError as error:
        raise CarInterfaceError(f"{PACKAGE} has neither package.xml nor metadata: install it again") from error


def _parser(command, arguments):
    """Return the parser for one command; without a name for all of them."""
    if command is not None:
        return _describe(argparse.ArgumentParser(prog=command), command)
    parser = argparse.ArgumentParser(prog=PROGRAM, description="Tables and reports from recordings of a car's drives.")
    _add_version(parser)
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    named = next((argument for argument in arguments if argument in MODULES), None)
    for name in [named] if named else MODULES:
        _describe(commands.add_parser(name, help=importlib.import_module(MODULES[name]).__doc__.split("\n")[0]), name)
    return parser


def _describe(parser, name):
    module = importlib.import_module(MODULES[name])
    parser.description = module.__doc__
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    module.add_arguments(parser)
    _add_version(parser)
    parser.set_defaults(run=module.run)
    return parser


def _add_version(parser):
    parser.add_argument("--version", action="version", version=f"{PACKAGE} {version()}",
                        help="print the version of car_interface and end")


def _plain(error):
    """Replace characters that the output can't encode."""
    return "".join(PLAIN.get(character, "?") for character in error.object[error.start:error.end]), error.end


def _failed(command, error):
    print(f"{command or PROGRAM}: {error}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
