"""Summaries of small recordings that a test writes."""
import tempfile
from pathlib import Path

from car_interface.tools.report.summary import summarize
from written_recordings import write_ros1


def summarized(folder, messages, namespace="/", extra_types=(), **options):
    """Write the messages to a bag of their own, in the order of their times; return its summary."""
    path = Path(tempfile.mkdtemp(dir=str(folder)), "a.bag")
    write_ros1(path, sorted(messages, key=lambda message: message.time_s), extra_types=extra_types)
    return summarize(str(path), namespace, **options)
