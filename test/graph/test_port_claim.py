"""Two simulated cars never share a serial port's path, and a dead one's path is free."""
import os
import subprocess
import sys

import pytest

from car_interface.common.errors import ConfigError
from car_interface.nodes.car_sim.virtual_line import claim_port

HOLDER = ("import sys, time; from car_interface.nodes.car_sim.virtual_line import claim_port; "
          "claim = claim_port(sys.argv[1]); print('held', flush=True); time.sleep(60)")


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "teensy")


def test_path_that_a_living_process_claims_is_refused_with_its_number_and_what_to_do(path):
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout.readline() == "held\n"
            with pytest.raises(ConfigError) as caught:
                claim_port(path, 0.0)
            assert str(caught.value) == (
                f"port {path} is in use by another car_sim (process {other.pid}); accepted: a path that no other "
                f"car_sim uses: end that one, or start this one with another port, e.g. port:={path}_2")
        finally:
            other.kill()
    claim_port(path, 1.0).close()  # a killed process leaves nothing behind


def test_path_is_the_same_by_another_way_to_its_folder_and_free_once_it_was_given_back(path, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path)
    claim = claim_port(path)
    with pytest.raises(ConfigError, match=f"in use by another car_sim .process {os.getpid()}."):
        claim_port(str(tmp_path / "link" / "teensy"), 0.0)
    claim_port(path + "_2", 0.0).close()
    claim.close()
    claim_port(path, 0.0).close()
