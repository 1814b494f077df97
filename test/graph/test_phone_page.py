"""What a phone's page shows of the car, and what its driver has done beside driving: by the nodes themselves."""
import os
import shutil
from functools import partial
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from car import CONFIG, ESC, STEERING, Car, config
from car_interface.nodes.calibration_drive import CalibrationDriveNode
from car_interface.nodes.phone_drive.car_state import MAX_REPORTS
from car_interface.nodes.phone_drive.programs import MIN_FREE_BYTES, CalibrationProgram, Recordings
from car_interface.tools.calibration.drive.config import parse
from phones import Network, Phone
from test_calibration_drive import CURVATURES, Recording, Terminal

FILES = "turn_arb.yaml", "throttle.yaml"


class BagFile:
    """A recording that is a file, as rosbag's is."""

    has_ended = is_ending = False
    _left = 3

    def __init__(self, folder, topics):
        self.path, self.topics = os.path.join(folder, "car_2026-11-26_12-00-00.bag"), topics
        with open(f"{self.path}.active", "wb") as file:
            file.write(bytes(2_000_000))

    def end(self):
        self.is_ending = True
        self.stop()

    def report(self):
        self._left -= 1  # bag_report takes a while
        if self._left:
            return None
        page = self.path.replace(".bag", ".html")
        with open(page, "w", encoding="utf-8") as file:
            file.write("<h1>report</h1>")
        return [f"recording: {self.path}", f"report: {page}"]

    def stop(self):
        if not self.has_ended:
            os.replace(f"{self.path}.active", self.path)
        self.has_ended = True


class Bench:
    """A whole car with its sensors, and a phone that drives it."""

    def __init__(self, folder, **parameters):
        self.folder = folder
        for name in FILES:
            shutil.copy(os.path.join(CONFIG, name), folder)
        self.car = Car()
        self.graph, self.run = self.car.graph, self.car.graph.run
        self.network = Network(self.graph)
        self.car.whole("speed", {"turn_arb": {"save_to": str(folder / FILES[0])},
                                 "throttle_arb": {"save_to": str(folder / FILES[1])}},
                       steering_duties=[*CURVATURES], steering_curvatures=[*CURVATURES.values()], obstacles=False,
                       start=[0.0, 0.0, 0.0])
        self.graph.set_parameter("/throttle_arb/sonar_hub", config("sonars.yaml"))
        self.free_bytes, self.programs = 10 ** 12, []
        self.node = self.network.add_node(
            make={"make_recordings": partial(Recordings, make_recording=self._record,
                                             free_bytes=lambda folder: self.free_bytes),
                  "make_calibration": partial(CalibrationProgram, make_program=self._start)},
            folder=str(folder / "bags"), **parameters)
        self.run(2.5)
        self.phone = Phone(self.network)
        self.run(0.3)

    def _record(self, folder, topics):
        self.bag = BagFile(folder, topics)
        return self.bag

    def _start(self, command, **variables):
        """Run calibration_drive in the graph."""
        terminal = Terminal(is_live=False)
        wanted = parse(["-o", str(self.folder / "new.yaml"), "--no-sonars"])
        program = self.graph.add(partial(CalibrationDriveNode, wanted, text=terminal, keys=terminal,
                                         make_recording=partial(Recording, self.car)), "calibration_drive")
        self.programs.append((command, variables["ROS_NAMESPACE"]))
        return _Child(program, terminal)

    def seat(self):
        self.phone.hold("")
        self.phone.evidence("drive")
        self.run(0.3)
        return self.phone

    def ask(self, kind, run_s=0.5, **fields):
        """Send a command of the driver's; return what it had, and why none."""
        self.phone.done = self.phone.refused = ""
        self.phone.evidence(kind, **fields)
        self.run(run_s)
        return self.phone.done, self.phone.refused


class _Child:
    def __init__(self, program, terminal):
        self._program, self._terminal = program, terminal

    @property
    def exit_code(self):
        return None if self._program.is_alive else int(bool(self._program.fault))

    def interrupt(self):
        self._program.inbox.end()

    def tail(self, count):
        return self._program.fault or self._terminal.lines[-1]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


# --- what it shows ---

def test_page_shows_who_drives_what_is_asked_and_granted_and_how_the_devices_are(bench):
    phone = bench.seat()
    phone.hold("manual", 0.5, 0.4)
    bench.run(1.5)
    car = phone.car
    assert car["who"] == {"cause": "manual", "text": "phone: manual deadman held"}
    assert (car["steering"]["source"], car["throttle"]["source"]) == ("teleop", "teleop")
    assert car["steering"]["asked"] == pytest.approx(0.5, abs=0.05)
    assert car["steering"]["granted"] == pytest.approx(car["steering"]["asked"], abs=0.02)
    assert 0.5 < car["steering"]["radius"] < 100
    assert car["throttle"]["asked"] == pytest.approx(0.4, abs=0.05) and 0 < car["throttle"]["granted"] <= 0.4
    assert car["throttle"]["mode"] == "manual" and car["speed"] > 0.1
    assert (car["esc"]["state"], car["esc"]["profile"]) == ("FORWARD", config("throttle.yaml")["esc"]["profile"])
    assert set(car["sonars"]) == set(car["layout"]["sonars"]) and len(car["sonars"]) == 6
    assert all(range_m == "inf" or 0 < range_m <= 2.0 for range_m, age_s in car["sonars"].values() if age_s < 0.5)
    assert car["layout"]["sonars"]["front_middle"] == [0.42, 0.0, 0.0] and car["layout"]["width"] == 0.296
    assert [car[device]["level"] for device in ("board", "teensy")] == [0, 0]
    assert 0 < car["teensy"]["delay"] < 0.05
    assert set(car["worst"]) == {"level", "text", "remedy"}
    assert car["trims"]["center"] == {"value": 5100, "low": 4600, "high": 5600}
    assert car["recording"]["state"] == car["calibration"]["state"] == "off" and car["recordings"] == []
    assert phone.status["delay"] == pytest.approx(0.04, abs=0.01)


@pytest.mark.more
def test_node_that_falls_silent_and_the_limit_that_cuts_are_shown_in_words(bench):
    phone = bench.seat()
    bench.car.graph.nodes["/throttle_arb"].kill()
    bench.run(1.5)
    assert phone.car["throttle"] == {"cause": "silent", "level": 2, "text": "throttle_arb is silent", "remedy": ""}
    assert phone.car["steering"]["source"] is not None and phone.car["who"]["cause"] == "no deadman"
    bench.run(6.0)
    assert (phone.car["worst"]["level"], phone.car["battery"]["text"]) == (2, "throttle_arb has stopped reporting")


def test_reports_are_kept_of_so_many_devices_and_no_more_while_no_page_is_open(graph):
    node = Network(graph).add_node()
    for at in range(5):
        graph.publish("/diagnostics", DiagnosticArray(status=[
            DiagnosticStatus(name=f"turn_arb: {at * 100 + device}", level=at) for device in range(100)]))
        graph.run(0.2)
    reports = node.node._car._reports
    assert len(reports) == MAX_REPORTS and reports["turn_arb: 0"].value["level"] == 0
    graph.publish("/diagnostics", DiagnosticArray(status=[DiagnosticStatus(name="turn_arb: 0", level=2)]))
    graph.run(0.2)
    assert reports["turn_arb: 0"].value["level"] == 2  # one that is known goes on


# --- guests ---

@pytest.mark.more
def test_guest_sees_and_stops_where_a_parameter_allows_it_and_nothing_else(tmp_path):
    bench = Bench(tmp_path, watch_without_pin=True)
    driver = bench.seat()
    guest = Phone(bench.network, "10.0.0.99", is_guest=True)
    bench.run(0.5)
    assert guest.status["guest"] and guest.car["who"] and not guest.key
    for kind, fields in (("drive", {}), ("clear", {}), ("save", {}), ("record", {"on": True})):
        guest.refused = ""
        guest.evidence(kind, **fields)
        bench.run(0.1)
        assert guest.refused == "enter the PIN first"
    assert driver.status["driver"] == "you"
    guest.send(type="e_stop")
    bench.run(0.3)
    assert driver.status["e_stop"]


# --- e-stop ---

def test_e_stop_outlives_the_node_and_so_does_its_end(bench):
    driver = bench.seat()
    for is_on in (True, False):
        if is_on:
            driver.send(type="e_stop")
        else:
            driver.evidence("clear")
        bench.run(0.5)
        bench.node.kill()
        bench.run(0.3)
        bench.node.start()
        bench.run(0.2)
        driver.key = ""
        driver.connect()
        bench.run(0.3)
        assert (bench.node.node._phones.e_stop, driver.status["e_stop"]) == (is_on, is_on)
        assert (bench.graph.newest("/turn_arb/state").cause == "e_stop") == is_on
        bench.seat()


# --- trims ---

def test_driver_trims_center_and_neutral_within_the_live_limits_and_saves_them(bench):
    bench.seat()
    assert bench.ask("trim", name="center", value=5130) == ("center is 5130 now", "")
    assert bench.ask("trim", name="center", value=9999) == ("center is 5600 now", "")
    bench.ask("trim", name="center", value=5120)
    assert bench.ask("trim", name="neutral", value=4925) == ("neutral is 4925 now", "")
    bench.run(1.0)
    assert bench.phone.car["trims"] == {"center": {"value": 5120, "low": 4600, "high": 5600},
                                        "neutral": {"value": 4925, "low": 4815, "high": 5015}}
    assert bench.car.board.counts[STEERING] == 5120 // 16 and bench.car.board.counts[ESC] == round(4925 / 16)
    assert bench.ask("save", 2.0)[0].startswith("throttle_arb: saved to ")
    assert "servo_center: 5120" in (bench.folder / "turn_arb.yaml").read_text(encoding="utf-8")


@pytest.mark.more
def test_trim_of_a_node_that_is_gone_is_refused_in_words(bench):
    bench.seat()
    bench.graph.nodes["/throttle_arb"].kill()
    done, refused = bench.ask("trim", name="neutral", value=4925)
    assert (done, refused) == ("", "service [/throttle_arb/servo/set_parameters] unavailable")


# --- recordings ---

@pytest.mark.more
def test_driver_records_and_has_the_report_opened(bench):
    phone = bench.seat()
    assert bench.ask("record", on=False) == ("", "no recording is running")
    assert bench.ask("record", on=True)[0] == "recording car_2026-11-26_12-00-00.bag"
    assert bench.ask("record", on=True) == ("", "a recording is running already")
    assert "/phone/joy" in bench.bag.topics and "/teleop_logi/state" in bench.bag.topics
    bench.run(2.0)
    assert phone.car["recording"] == {"state": "on", "name": "car_2026-11-26_12-00-00.bag", "age": 2, "size": 2.0,
                                      "text": "recording"}
    bench.ask("record", on=False)
    assert phone.car["recording"]["state"] == "report"
    bench.run(6.0)
    assert phone.car["recording"]["text"].startswith("report: /")
    assert phone.car["recordings"] == [{"name": "car_2026-11-26_12-00-00.bag", "size": 2.0,
                                        "report": "car_2026-11-26_12-00-00.html"}]
    phone.send(type="open", name="car_2026-11-26_12-00-00.html")
    bench.run(0.1)
    assert phone.file == "/files/ticket/car_2026-11-26_12-00-00.html"


def test_file_that_isn_t_a_recording_is_refused(bench):
    folder = bench.folder / "bags"
    folder.mkdir()
    (bench.folder / "secret").write_text("secret", encoding="utf-8")
    (folder / "link.bag").symlink_to(bench.folder / "secret")
    (folder / "folder.bag").mkdir()
    for name in ("absent.bag", "link.bag", "folder.bag"):
        bench.phone.refused = ""
        bench.phone.send(type="open", name=name)
        bench.run(0.1)
        assert (bench.phone.refused, bench.phone.file) == ("there is no such file", ""), name


@pytest.mark.more
def test_recording_ends_before_the_disk_is_full(bench):
    phone = bench.seat()
    bench.ask("record", on=True)
    bench.free_bytes = MIN_FREE_BYTES - 1
    bench.run(6.0)
    assert phone.car["recording"]["state"] == "off" and phone.car["recordings"][0]["report"]
    assert phone.car["recording"]["text"].startswith("the disk is nearly full: nothing is recorded; report: ")
    assert bench.ask("record", on=True) == ("", "the disk is nearly full: nothing is recorded")


def test_recording_that_ends_by_itself_is_told(bench):
    phone = bench.seat()
    bench.ask("record", on=True)
    bench.bag.has_ended = True
    bench.run(0.5)
    assert phone.car["recording"]["text"] == "the recording has ended by itself: rosrun rosbag record says why"


# --- calibration ---

@pytest.mark.more
def test_person_with_a_phone_and_no_gamepad_calibrates_the_steering(bench):
    bench.car.joy(False)
    phone = bench.seat()
    assert bench.ask("calibrate", what="finish") == ("", "calibration_drive is not running")
    assert bench.ask("calibrate", what="begin") == ("calibration_drive starts", "")
    assert bench.programs == [(["rosrun", "car_interface", "calibration_drive", "--yes", "odom:=/odom"], "/")]
    assert bench.ask("calibrate", what="begin") == ("", "calibration_drive is running already")
    bench.run(4.0)
    assert phone.car["calibration"]["state"] == "on" and phone.car["calibration"]["phase"] == "waiting"
    phone.hold("autonomous")
    bench.graph.run_until(lambda: bench.car.speed_mps > 0.3, 20)
    bench.run(2.0)
    shown = phone.car["calibration"]
    assert shown["phase"] in ("settling", "measuring", "turning") and shown["driven"] >= 1 and shown["left"] > 0
    assert len(shown["known"]) >= 2
    for kind, fields in (("trim", {"name": "center", "value": 5130}), ("save", {})):
        assert bench.ask(kind, **fields) == ("", "calibration_drive is running: trim before it or after it")
    assert phone.car["trims"]["center"]["value"] == 5100
    phone.hold("")
    bench.run(1.0)
    assert phone.car["calibration"]["phase"] == "paused" and abs(bench.car.speed_mps) < 0.3
    assert bench.ask("calibrate", what="finish")[0] == "it finishes with what is known"
    bench.run(8.0)
    assert phone.car["calibration"]["state"] == "over"
    assert "no calibration is written" in phone.car["calibration"]["text"]
    assert bench.ask("calibrate", what="begin")[0] == "calibration_drive starts"
    bench.run(1.0)
    assert bench.ask("calibrate", what="give up")[0] == "calibration_drive ends; nothing is written"
    bench.run(2.0)
    assert phone.car["calibration"] == {**phone.car["calibration"], "state": "over",
                                        "text": "ended before it was over: nothing is written"}
    assert bench.ask("save", 2.0)[0].startswith("throttle_arb: ")


def test_table_that_a_calibration_has_written_is_not_replaced_by_a_save_of_the_one_in_use(tmp_path, monkeypatch):
    written = SimpleNamespace(exit_code=0, tail=lambda count: "turn_arb.yaml written")
    monkeypatch.setattr(Bench, "_start", lambda self, command, **variables: written)
    bench = Bench(tmp_path)
    bench.seat()
    bench.ask("calibrate", what="begin")
    assert bench.phone.car["calibration"]["text"] == "turn_arb.yaml written"
    assert bench.ask("save") == (
        "", "the file has a new table, which turn_arb would replace by its own: launch again first")
    assert bench.ask("trim", name="center", value=5130)[0] == "center is 5130 now"
