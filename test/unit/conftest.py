"""How hypothesis works for all unit tests: the same cases on every run, no stopwatch, and no file in the checkout."""
import os
import tempfile

from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir

if "HYPOTHESIS_STORAGE_DIRECTORY" not in os.environ:
    set_hypothesis_home_dir(os.path.join(tempfile.gettempdir(), f"hypothesis-{os.getuid()}"))
settings.register_profile("car_interface", database=None, deadline=None, derandomize=True)
settings.load_profile("car_interface")
