"""Trends over drives."""
import pytest

from car_interface.tools.report import drives, plots
from car_interface.tools.report.drives import Row, page, trends
from written_recordings import START_NS

ROWS = [Row(f"{index}.bag", start_ns=START_NS + index * 86_400_000_000_000, duration_s=60.0, distance_m=10.0 * index,
            gamepad_s=30.0, planner_s=0.0, losses={"planner silent": index % 2}, straight_per_m=0.002 * index,
            left_ratio=1.0 + 0.01 * index, hold_mps2=0.01 * index, frames=900, corrupt=index, reopened=int(index == 2),
            reboots=0, unanswered=0, faults=0, errors=0) for index in range(4)]
BLIND = Row("x.bag", start_ns=0, duration_s=60.0, distance_m=5.0)


@pytest.fixture
def figure(monkeypatch):
    """The figure of the last call, in place of its SVG."""
    made = []
    monkeypatch.setattr(plots, "svg_text", lambda figure, *_: made.append(figure) or "<svg/>")
    return made


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_every_trend_has_a_panel(figure):
    assert trends(ROWS) == "<svg/>"
    assert titles(figure[0]) == [
        "Distance in m", "Lost or locked while somebody drove, times",
        "Driven when sent straight on: 1/radius in 1/m, left up", "Tighter than the tables say, in % of the radius",
        "Acceleration beyond what the planner requested, in m/s²",
        "Corrupt frames of the Teensy's link, in %; x: its port was opened again, or it started anew"]
    distance, losses, center, sides, value_map, link = figure[0].axes
    assert [bar.get_height() for bar in distance.patches] == [0, 10, 20, 30]
    assert [bar.get_height() for bar in losses.patches] == [0, 1, 0, 1]
    assert center.lines[-1].get_ydata().tolist() == pytest.approx([0, 0.002, 0.004, 0.006])
    assert sides.lines[1].get_ydata().tolist() == pytest.approx([100 - 100 / (1 + ratio / 100) for ratio in range(4)])
    assert sides.lines[1].get_label() == "left"
    assert value_map.lines[2].get_label() == "holding the speed"
    assert link.lines[0].get_ydata()[3] == pytest.approx(100 * 3 / 903) and link.lines[1].get_xdata().tolist() == [2]


def test_plot_and_table_have_the_same_percentage_and_a_car_that_does_not_turn_hides_no_other(figure):
    rows = [ROWS[0]._replace(left_ratio=0.002), ROWS[1]._replace(left_ratio=1.25)]
    trends(rows)
    sides = figure[0].axes[3]
    assert sides.lines[1].get_ydata().tolist() == pytest.approx([-100, 20]) and sides.get_ylim()[1] < 120
    assert "left: 20% tighter<" in page("drives", rows, "", {})


def test_what_no_drive_tells_has_no_panel_and_what_one_lacks_is_a_gap(figure):
    trends([BLIND, BLIND])
    trends([*ROWS[:2], BLIND])
    assert titles(figure[0]) == ["Distance in m"]
    assert figure[1].axes[2].lines[-1].get_xdata().tolist() == [0, 1]


@pytest.mark.once
@pytest.mark.parametrize("count", [7, 14, 47])
def test_labels_stand_evenly_so_that_none_covers_its_neighbour(figure, count):
    trends(ROWS[:1] * count)
    at = figure[0].axes[-1].get_xticks()
    assert len(at) <= drives.MAX_LABELS and at[-1] == count - 1
    assert len({after - before for before, after in zip(at, at[1:])}) <= 1 and at[0] < max(2, at[-1] / 3)


def test_zero_has_a_point_so_that_it_does_not_look_like_what_is_not_known(figure):
    known, blind = ROWS[0]._replace(distance_m=0.0, losses={}), BLIND._replace(distance_m=None)
    trends([blind, known, ROWS[1]])
    for axes in figure[0].axes[:2]:
        assert [line.get_xdata().tolist() for line in axes.lines] == [[1]]


def test_rare_causes_are_drawn_together(figure):
    many = [ROWS[0]._replace(losses={f"cause {number}": 9 - number for number in range(9)}), ROWS[1]]
    trends(many)
    labels = [text.get_text() for text in figure[0].axes[1].get_legend().get_texts()]
    assert labels == [*(f"cause {number}" for number in range(5)), "others"]


def test_single_drive_has_no_trend(figure):
    assert trends(ROWS[:1]) == trends([]) == "" and figure == []
