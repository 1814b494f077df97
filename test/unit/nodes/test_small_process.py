"""Running a module without site packages and without the user's environment."""
import os
import subprocess

from car_interface.nodes.pca9685 import small_process


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
