"""Random walks of the car's software against a monitor that knows only the goals of docs/safety_case.md.

``goals`` has the monitor, ``cores`` the walk of the parts alone; the walk of the whole graph is in test/graph.
"""
