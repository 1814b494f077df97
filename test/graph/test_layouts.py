"""The layouts for Foxglove and PlotJuggler: each topic and field in them is one of a whole car's."""
import json
import os
import xml.etree.ElementTree as ElementTree

from car import CONFIG, Car
from car_interface.nodes.car_display import CarDisplay


def foxglove():
    """Return paths of fields with dots, and topics."""
    with open(os.path.join(CONFIG, "foxglove.json"), encoding="utf-8") as file:
        panels = json.load(file)["configById"].values()
    paths = [curve["value"] for panel in panels for curve in panel.get("paths", ())]
    paths += [panel["topicPath"] for panel in panels if "topicPath" in panel]
    return paths, [topic for panel in panels for topic in (*panel.get("topics", ()), panel.get("topicToRender"))
                   if topic]


def plotjuggler():
    """Return curves, whose topics and fields are parted by slashes."""
    root = ElementTree.parse(os.path.join(CONFIG, "plotjuggler.xml"))
    return [curve.get("name") for curve in root.iter("curve")]


def test_everything_that_they_show_is_published():
    car = Car().whole()
    car.graph.add(CarDisplay, "car_display", {})
    car.graph.run(1.0)
    types = {topic: found[0].type for topic, found in car.graph.publishers.items() if found}
    paths, topics = foxglove()
    curves = plotjuggler()
    assert set(topics) <= set(types)
    assert sorted(curves) == sorted(path.replace(".", "/") for path in paths if not path.endswith(".reason"))
    for path in paths:
        topic, *fields = path.split(".")
        value = types[topic]()
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, (int, float, str)), path
