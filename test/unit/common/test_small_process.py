"""Running a module without site packages and without the user's environment."""
from __future__ import annotations

import os
import subprocess
import sys

from car_interface.common import small_process


def run(*command, **environment):
    return subprocess.run(command, env={**os.environ, **environment}, cwd="/", capture_output=True, text=True,
                          check=False)


def test_module_runs_with_its_arguments_and_finds_the_package_from_anywhere_whatever_the_user_s_environment(tmp_path):
    (tmp_path / "socket.py").write_text("raise SystemExit('shadowed')")
    for path in ("", str(tmp_path)):
        done = run(*small_process.command("sim.chip_server", str(tmp_path / "missing" / "chip"), "64"), PYTHONPATH=path)
        assert done.returncode == 1
        assert "FileNotFoundError" in done.stderr and "missing/chip.lock" in done.stderr
    assert "car_interface.nothing" in run(*small_process.command("nothing")).stderr


def test_byte_code_goes_where_the_starter_writes_its_own(monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(sys, "pycache_prefix", "/cache")
    assert small_process.command("x")[:6] == [sys.executable, "-S", "-I", "-B", "-X", "pycache_prefix=/cache"]
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    assert small_process.command("x")[1:4] == ["-S", "-I", small_process.__file__]
