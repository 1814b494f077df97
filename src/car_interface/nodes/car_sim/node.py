"""The car_sim node: a car without hardware, for the real nodes to drive.

It turns what the servo board holds into motion and answers as the Teensy does, byte by byte, on a pseudo-terminal. Its
steering is that of a car's turn_arb.yaml, or one of its own; the drive train's curves are its own.

It follows the virtual servo board's chip itself, also while no pca9685 node lives; without one, /servo/output.

Subscribes:
    /servo/output (std_msgs/Int32MultiArray): what the servo board holds.
Publishes:
    ~truth (nav_msgs/Odometry, 50 Hz): where the car really is, in odom, and how fast.
    ~collisions (std_msgs/Int32, latched): how often it ran into a wall, a box or a post.
    ~room (visualization_msgs/MarkerArray, latched): the walls, boxes and posts, in odom; that drifts, and they don't.
    ~rollovers (std_msgs/Int32, latched): how often it turned so fast that it would have tipped over. It drives on.
Service:
    ~inject_fault (InjectFault): makes the Teensy and its line misbehave; see ``virtual_line``.
Arguments, by a launch file: --port, --virtual-chip, which these parameters must agree with: see
    ``common.fixed_parameters``.
"""
from __future__ import annotations

import math

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from std_msgs.msg import ColorRGBA, Header, Int32, Int32MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.declared import read_all
from car_interface.common.own_files import UnsafeFile
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import CHANNELS, NS_PER_MS, NS_PER_S, UNCHANGED
from car_interface.nodes.car_sim.config import CarSimConfig
from car_interface.nodes.car_sim.virtual_line import VirtualLine
from car_interface.nodes.pca9685.virtual_board import chip_path
from car_interface.pca9685.registers import duty_of_counts
from car_interface.ros.clocks import RosClock
from car_interface.ros.inbox import Inbox
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.sim.chip_link import ChipLink
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.sim.vehicle import Vehicle
from car_interface.sim.world import World, WorldConfig

STEP_NS = 2_000_000  # the car's maximum step, and how often bytes leave
TRUTH_RATE_HZ = 50
MAX_CATCH_UP_NS = NS_PER_S // 2  # a simulator that was stopped for longer goes on from now
RETRY_NS = 200 * NS_PER_MS  # between attempts to find the chip
HEIGHT_M, WALL_HEIGHT_M, WALL_M = 0.25, 0.12, 0.04  # of the room's things, as they are drawn
THING, WALL = ColorRGBA(0.55, 0.42, 0.30, 1.0), ColorRGBA(0.45, 0.47, 0.50, 1.0)


class ChipFollower:
    """Follows what the pins of a virtual servo board do, whoever writes to it. Its process may come and go."""

    def __init__(self, path: str, inbox: Inbox):
        self.duties: list[int] | None = None  # of the 16 pins, 0 = no pulse; ``None`` while there is no chip
        self.problem = ""  # why nothing that is at the path is used; empty: nothing is wrong with it
        self._link = ChipLink(path, 0)
        self._inbox = inbox
        self._fd: int | None = None
        self._next_try_ns = 0

    def step(self, now_ns: int) -> None:
        """Connect if there is a chip, and take what it sent."""
        try:
            if self._fd is None and now_ns >= self._next_try_ns:
                self._next_try_ns = now_ns + RETRY_NS
                self.problem = ""
                self._link.open()
                self._fd = self._link.observe()
                self._inbox.watch("chip", self._fd)
            if self._fd is not None:
                for counts in self._link.changes():
                    self.duties = [duty_of_counts(each) for each in counts]
        except UnsafeFile as error:
            self.problem = str(error)
            self.close()
        except OSError:
            self.close()

    def close(self) -> None:
        self._inbox.watch("chip", None)
        self._link.close()
        self._fd = self.duties = None


class CarSim:
    """Moves the car, feeds the Teensy, and carries its bytes to and from the pseudo-terminal.

    Args:
        make_chip, make_line: of other classes where a test connects them.
    """

    def __init__(self, params, inbox, make_chip=ChipFollower, make_line=VirtualLine):
        config = read_all(params, CarSimConfig)
        now_ns = inbox.clocks.now_ns()
        self._steering_channel, self._throttle_channel = config.steering_channel, config.throttle_channel
        self._world = world = World(config.world)
        self._vehicle = Vehicle(config.vehicle, now_ns, world if config.collides else None)
        self._firmware = TeensyFirmware(
            config.firmware, lambda sensor, at_ns: world.echo_us(self._vehicle.pose, sensor), now_ns)
        self._outputs = [UNCHANGED] * CHANNELS  # by the topic
        self._chip = make_chip(config.virtual_chip or chip_path(f"{inbox.graph.namespace()}pca9685"), inbox)
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._line = make_line(config.port, self._firmware, config.firmware.seed, inbox)
        self._timer = RateTimer(TRUTH_RATE_HZ, now_ns)
        self._ros_clock = RosClock(inbox.clocks)
        self._truth = advertise("~truth", Odometry, inbox)
        self._counts = {}  # by topic: the publisher, and the newest count
        for topic in ("~collisions", "~rollovers"):
            self._counts[topic] = advertise(topic, Int32, inbox, latch=True), 0
            self._counts[topic][0].publish(0)
        self._room = advertise("~room", MarkerArray, inbox, latch=True)
        self._room.publish(room_markers(config.world, f"{inbox.graph.namespace()}odom".lstrip("/")))
        subscribe("/servo/output", Int32MultiArray, inbox, self._on_output)
        rospy.loginfo("a virtual Teensy is on %s (seed %d)", config.port, config.firmware.seed)
        if config.steering_duties is not None:
            rospy.loginfo("the car's steering is another one than turn_arb's file says, on purpose: until that is "
                          "calibrated, its turns are not the requested ones")

    def step(self, now_ns):
        """Live on until now: first the car, then the Teensy, then the line."""
        self._move(now_ns)
        self._inbox.dispatch()
        self._chip.step(now_ns)
        if self._chip.problem:
            self._warnings.warn("chip", f"the virtual servo board isn't followed: {self._chip.problem}")
        self._line.step(now_ns)
        world, rollovers = self._world, self._vehicle.rollovers
        self._report("~collisions", world.count, "the car ran into something at %.2f m/s and stands, its wheels "
                     "stalled (collision %d): drive it out the way it came", abs(world.speed_mps))
        self._report("~rollovers", rollovers.count, "the car would have tipped over: %.1f m/s² sideways at %.1f m/s "
                     "(rollover %d)", abs(rollovers.lateral_mps2), abs(self._vehicle.speed_mps))
        if self._timer.is_due(now_ns):
            self._publish_truth()
        return now_ns + STEP_NS

    def shut_down(self):
        self._line.close()
        self._chip.close()

    def _on_output(self, message, now_ns):
        if len(message.data) != CHANNELS:
            self._warnings.warn("length", f"/servo/output has {len(message.data)} values, not {CHANNELS}: ignored")
            return
        self._outputs = message.data

    def _move(self, now_ns):
        outputs = self._chip.duties or self._outputs
        steering, throttle = outputs[self._steering_channel], outputs[self._throttle_channel]
        vehicle = self._vehicle
        if now_ns - vehicle.time_ns > MAX_CATCH_UP_NS:
            vehicle.time_ns = now_ns - STEP_NS
        while vehicle.time_ns < now_ns:
            for pulse in vehicle.step(min(STEP_NS, now_ns - vehicle.time_ns), steering, throttle):
                self._firmware.wheel_pulse(pulse.side, pulse.direction, pulse.at_ns)

    def _report(self, topic, count, text, *values):
        """Publish and log a count once it has grown."""
        publisher, before = self._counts[topic]
        if count != before:
            self._counts[topic] = publisher, count
            publisher.publish(count)
            rospy.logwarn(text, *values, count)

    def _publish_truth(self):
        vehicle = self._vehicle
        message = Odometry(child_frame_id="base_link")
        message.header.stamp = self._ros_clock.stamp("truth", vehicle.time_ns)
        message.header.frame_id = "odom"
        message.pose.pose = _pose(vehicle.pose.x_m, vehicle.pose.y_m, 0.0, vehicle.pose.yaw_rad)
        message.twist.twist.linear = Vector3(vehicle.speed_mps, 0.0, 0.0)
        message.twist.twist.angular = Vector3(0.0, 0.0, vehicle.yaw_rate_radps)
        self._truth.publish(message)


def room_markers(world: WorldConfig, frame: str) -> MarkerArray:
    """Return the room as markers in a frame in which the car has begun at x = y = yaw = 0."""
    walls, length_m, width_m = world.walls, world.walls.length_m, world.walls.width_m
    things = [(Marker.CUBE, walls.x_m + x_m, walls.y_m + y_m, 0.0, size, WALL) for x_m, y_m, size in (
        (0.0, -width_m / 2, (length_m, WALL_M)), (0.0, width_m / 2, (length_m, WALL_M)),
        (-length_m / 2, 0.0, (WALL_M, width_m)), (length_m / 2, 0.0, (WALL_M, width_m)))]
    things += [(Marker.CUBE, box.x_m, box.y_m, box.yaw_rad, (box.length_m, box.width_m), THING) for box in world.boxes]
    things += [(Marker.CYLINDER, post.x_m, post.y_m, 0.0, (2 * post.radius_m, 2 * post.radius_m), THING)
               for post in world.posts]
    markers = []
    for index, (kind, x_m, y_m, yaw_rad, size_m, color) in enumerate(things):
        height_m = WALL_HEIGHT_M if color is WALL else HEIGHT_M
        markers.append(Marker(
            header=Header(stamp=rospy.Time(), frame_id=frame), ns="room", id=index, type=kind, action=Marker.ADD,
            pose=_pose(x_m, y_m, height_m / 2, yaw_rad), scale=Vector3(*size_m, height_m), color=color,
            frame_locked=True))
    return MarkerArray(markers)


def _pose(x_m, y_m, z_m, yaw_rad):
    return Pose(Point(x_m, y_m, z_m), Quaternion(0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))


def main():
    run("car_sim", CarSim)
