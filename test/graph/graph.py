"""A ROS graph in one process, on a clock of the test's: any set of the package's real node classes.

Messages are serialised, and delivered in the order and with the delay that the test says. Nothing waits: time goes from
event to event. A busy computer changes nothing, and a timeout of 0.5 s is exactly that.

A node has its turn, as its thread would, when a message wakes it or its next step is due. Within a step its clock
stands still, but for its own pauses. What it publishes leaves at that time.
"""
from __future__ import annotations

import heapq
import io
import itertools
import logging
import threading
from collections import defaultdict
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Callable, NamedTuple

import rospy
from dynamic_reconfigure.encoding import encode_config
from dynamic_reconfigure.srv import ReconfigureRequest

from car_interface.common.publishers import ANY, Publisher
from car_interface.ros.clocks import Clocks
from car_interface.ros.inbox import MAX_WAIT_NS, Inbox
from car_interface.ros.runtime import Steps, describe_error, read_params

NS_PER_S = 1_000_000_000
START_NS = 1000 * NS_PER_S  # of the monotonic clock
ROS_AHEAD_NS = 1_700_000_000 * NS_PER_S
SHORTEST_WAIT_NS = 1000  # of a node that wants its next step at once
WATCH_NS = NS_PER_S
REAL_POLL_S = 0.001
CALL_POLL_S = 0.001
COUNTED_NS, MAX_TURNS = NS_PER_S // 100, 2000  # of a node in such a time; none needs so many
MACHINE = "127.0.0.1"


class Record:
    def __init__(self, at_ns: int, sender: str, message_type: Any, data: bytes):
        self.at_ns, self.sender, self._content = at_ns, sender, (message_type, data)

    @cached_property
    def message(self) -> Any:
        return _message(*self._content)


class Line(NamedTuple):
    at_ns: int
    node: str
    level: int
    text: str


class Report(NamedTuple):
    """What a node reports on /diagnostics under one name."""

    level: int
    message: str
    values: dict[str, str]


class NodeClocks(Clocks):
    """The clocks of one node: the graph's, ahead of it by the pauses that the node makes in a step."""

    def __init__(self, graph: Graph):
        self._graph = graph
        self.paused_ns = 0

    def now_ns(self) -> int:
        return self._graph.now_ns + self.paused_ns

    def ros_now(self) -> rospy.Time:
        return rospy.Time(nsecs=self.now_ns() + self._graph.ros_ahead_ns)

    def sleep(self, duration_s: float) -> None:
        """A pause of the node; or of a call's thread, while the node goes on."""
        if threading.current_thread() is threading.main_thread():
            self.paused_ns += round(duration_s * NS_PER_S)
        else:
            self._graph.newest_call.sleep(duration_s)


class NodeInbox(Inbox):
    """An inbox that has its node's next turn planned instead of a thread woken."""

    def __init__(self, node: Node, graph: NodeGraph, **arguments):
        self.node = node
        self._has_request = False  # of a service call
        super().__init__(node.name, graph=graph, **arguments)

    def wake(self) -> None:
        self.node.plan_step(self.clocks.now_ns())

    def put(self, handler, item, wakes=True, on_drop=None) -> None:
        if threading.current_thread() is threading.main_thread():
            super().put(handler, item, wakes, on_drop)
            return
        self._has_request = True

        def drop():
            self._has_request = False
            on_drop()
        super().put(handler, item, wakes, on_drop and drop)
        self.node.graph.newest_call.has_begun.set()

    def drain(self) -> list[tuple]:
        self._has_request = False
        return super().drain()

    @property
    def awaits_answer(self) -> bool:
        """Whether a service call waits for the node."""
        return self._has_request or not all(done.done() for done in list(self._open_requests))

    @property
    def fds(self) -> list:
        """The devices that the node watches."""
        return list(self._watched.values())

    @property
    def has_readable(self) -> bool:
        """Whether a watched device still has something: as with select, the node's wait ends at once then."""
        return any(getattr(fd, "is_readable", False) for fd in self.fds)

    def abandon(self) -> None:
        """Close the devices that the node watches, and the service calls, as the system does for a killed process."""
        for fd in self.fds:
            getattr(fd, "close", lambda: None)()
        for done in list(self._open_requests):
            self._refuse(done, "the node was killed")


class Connection:
    """From one publisher to one subscription. Its header is a new object for each, as rospy's is."""

    def __init__(self, publisher: TopicPublisher, subscription: Subscription):
        self.publisher, self.subscription = publisher, subscription
        self.header = {"callerid": publisher.node, "topic": publisher.topic, "type": publisher.type._type,
                       "md5sum": publisher.type._md5sum, "message_definition": publisher.type._full_text,
                       "latching": "1" if publisher.latch else "0"}


class TopicPublisher:
    """What ``rospy.Publisher`` is to a node."""

    def __init__(self, graph: Graph, node: str, topic: str, message_type, latch: bool, clocks: Clocks):
        self.graph, self.node, self.topic, self.type, self.latch = graph, node, topic, message_type, latch
        self.resolved_name = topic
        self.connections: list[Connection] = []
        self._clocks = clocks
        self._last: bytes | None = None
        graph.publishers[topic].append(self)
        for subscription in graph.subscriptions[topic]:
            self.connect(subscription)

    def connect(self, subscription: Subscription) -> None:
        if subscription.is_open and subscription.takes(self.type):
            connection = Connection(self, subscription)
            self.connections.append(connection)
            if self.latch and self._last is not None:
                self.graph.send(connection, self._last, self._clocks.now_ns())

    def disconnect(self, subscription: Subscription) -> None:
        self.connections = [each for each in self.connections if each.subscription is not subscription]

    def publish(self, *args, **kwargs) -> None:
        """As rospy: a message, or its fields; nothing is serialised for nobody."""
        if not (self.latch or self.get_num_connections()):
            return
        is_message = len(args) == 1 and not kwargs and isinstance(args[0], self.type)
        message = args[0] if is_message else self.type(*args, **kwargs)
        buffer = io.BytesIO()
        message.serialize(buffer)
        data, now_ns = buffer.getvalue(), self._clocks.now_ns()
        self._last = data if self.latch else None
        if self.topic in self.graph.recorded:
            self.graph.recorded[self.topic].append(Record(now_ns, self.node, self.type, data))
        for connection in self.connections:
            self.graph.send(connection, data, now_ns)

    def get_num_connections(self) -> int:
        """As rospy; the test, which may record each topic, counts as one."""
        return len(self.connections) + (self.topic in self.graph.recorded)

    def unregister(self) -> None:
        if self in self.graph.publishers[self.topic]:
            self.graph.publishers[self.topic].remove(self)
        self.connections = []


class Subscription:
    """What ``rospy.Subscriber`` is to a node."""

    def __init__(self, graph: Graph, node: Node, topic: str, message_type, callback, queue_size: int | None):
        self.graph, self.node, self.type_class, self.callback = graph, node, message_type, callback
        self.resolved_name, self.type = topic, ANY if message_type is rospy.AnyMsg else message_type._type
        self.queue_size = queue_size
        self.is_open = True
        self.retired: list[dict] = []  # headers of replaced connections
        graph.subscriptions[topic].append(self)
        for publisher in graph.publishers[topic]:
            publisher.connect(self)

    @property
    def impl(self) -> Subscription | None:
        return self if self.is_open else None

    def takes(self, message_type) -> bool:
        return self.type_class is rospy.AnyMsg or self.type_class._md5sum == message_type._md5sum

    def replace_connections(self) -> Callable[[Any], bool]:
        """What is under way on the old connections will be recognised by its header."""
        for publisher in list(self.graph.publishers[self.resolved_name]):
            self.retired += [each.header for each in publisher.connections if each.subscription is self]
            publisher.disconnect(self)
            publisher.connect(self)
        return lambda header: any(header is retired for retired in self.retired)

    def unregister(self) -> None:
        self.is_open = False
        if self in self.graph.subscriptions[self.resolved_name]:
            self.graph.subscriptions[self.resolved_name].remove(self)
        for publisher in self.graph.publishers[self.resolved_name]:
            publisher.disconnect(self)


class NodeGraph:
    """The graph as one node sees it: what ``ros.graph.RosGraph`` is to a real one."""

    def __init__(self, graph: Graph, node: Node):
        self._graph, self._node = graph, node
        self.clocks = NodeClocks(graph)

    def process_name(self) -> str:
        return self._node.name

    def namespace(self) -> str:
        return self._node.name.rpartition("/")[0] + "/"

    def resolve_name(self, name: str) -> str:
        full = name if name.startswith("/") else self.namespace() + name
        return self._node.remap.get(name, self._node.remap.get(full, full))

    def publisher(self, name: str, message_type, queue_size: int, latch: bool) -> TopicPublisher:
        return TopicPublisher(self._graph, self._node.name, self.resolve_name(name), message_type, latch, self.clocks)

    def subscriber(self, name: str, message_type, callback, queue_size: int) -> Subscription:
        return Subscription(self._graph, self._node, self.resolve_name(name), message_type, callback, queue_size)

    def replace_connections(self, subscriber: Subscription) -> Callable[[Any], bool]:
        return subscriber.replace_connections()

    def service(self, name: str, service_type, handler) -> SimpleNamespace:
        full, services = self.resolve_name(name), self._graph.services
        self._graph.service_types[full], services[full] = service_type, handler
        return SimpleNamespace(shutdown=lambda *_: services.pop(full, None))

    def parameter(self, name: str, default: Any) -> Any:
        return self._graph.parameter(self.resolve_name(name), default)

    def set_parameter(self, name: str, value: Any) -> None:
        self._graph.set_parameter(self.resolve_name(name), value)

    def call(self, service: str, service_type, request: Any, on_done: Callable[[Any, str], None]) -> None:
        """The callee answers while time goes on."""
        if service not in self._graph.services:
            on_done(None, f"service [{service}] unavailable")
            return
        call = self._graph.begin_call(service, request)

        def poll():
            if not call.is_over:
                self._graph.after(CALL_POLL_S, poll)
            elif isinstance(call.answer, Exception):
                on_done(None, str(call.answer))
            else:
                on_done(call.answer, "")
        poll()

    def watch(self, process_watch, watch) -> None:
        self._node.watches.append(watch)

    def start_thread(self, target: Callable[[], None], name: str) -> None:
        target()  # its result is there at once

    def publishers(self, topic: str) -> list[str]:
        return [publisher.node for publisher in self._graph.publishers[topic]]


class Node:
    """One node of the graph; ``Graph.add`` has the arguments.

    Attributes:
        fault: what ended it by itself, in words.
        turns: how often its thread had one.
        exit_actions: called when its process has ended, however that was: what the kernel closes then.
    """

    def __init__(self, graph: Graph, node_class: Callable, name: str, remap: dict[str, str], inbox_limit: int | None):
        self.graph, self._class, self.name, self.remap = graph, node_class, name, remap
        self._inbox_arguments = {} if inbox_limit is None else {"limit": inbox_limit}
        self.watches: list = []
        self.fault = ""
        self.start()

    def start(self) -> None:
        self.fault, self.turns, self.watches = "", 0, []
        self._counted_from = self.graph.now_ns, 0  # time and turns
        self.exit_actions: list[Callable[[], None]] = []
        self.stalled_until_ns, self._is_frozen, self._held_back = 0, False, []
        self._planned_ns: int | None = None
        self._busy_until_ns = 0
        self._life = object()  # turns and deliveries that were planned for another life don't happen
        self._graph = NodeGraph(self.graph, self)
        self.inbox = NodeInbox(self, self._graph, **self._inbox_arguments)
        self.node = self._in_turn(lambda: self._class(read_params(self.inbox, {}), self.inbox))
        self._steps = Steps(self.node, self.inbox)
        self.is_alive = True
        self.plan_step(self._end_turn())
        life = self._life
        self.graph.at(self.graph.now_ns + WATCH_NS // 2, lambda: self._watch(life))

    def _in_turn(self, act, *arguments):
        """Call something; what it logs are lines of this node."""
        graph = self.graph
        before, graph.turn = graph.turn, self.name
        try:
            return act(*arguments)
        finally:
            graph.turn = before

    def _end_turn(self):
        """Return when the node's thread is free again."""
        clocks = self._graph.clocks
        now_ns, clocks.paused_ns = clocks.now_ns(), 0
        self._busy_until_ns = now_ns
        return now_ns

    def plan_step(self, at_ns: float) -> None:
        """Have it step at a time, unless a sooner step is planned."""
        if at_ns == float("inf"):
            return
        at_ns = max(int(at_ns), self.stalled_until_ns, self._busy_until_ns)
        if self._planned_ns is None or at_ns < self._planned_ns:
            self._planned_ns, life = at_ns, self._life
            self.graph.at(at_ns, lambda: self._step(at_ns, life))

    def _step(self, at_ns, life):
        if life is not self._life or at_ns != self._planned_ns or not self.is_alive:
            return
        self._planned_ns = None
        if self.graph.now_ns < self.stalled_until_ns:
            self.plan_step(self.stalled_until_ns)
            return
        self.turns += 1
        if self.graph.now_ns - self._counted_from[0] >= COUNTED_NS:
            self._counted_from = self.graph.now_ns, self.turns
        assert self.turns - self._counted_from[1] < MAX_TURNS, f"{self.name} takes the whole time of a CPU"
        try:
            due_ns = self._in_turn(self._steps.step)
        except Exception as error:
            self.fault = describe_error(error)
            self.end()
            return
        ended_ns = self._end_turn()
        if self.inbox.ending:
            self.end()
            return
        due_ns = ended_ns if self.inbox.has_readable else min(due_ns, ended_ns + MAX_WAIT_NS)
        self.plan_step(max(due_ns, ended_ns + SHORTEST_WAIT_NS))

    def receive(self, connection: Connection, data: bytes, life) -> None:
        if life is not self._life or not self.is_alive or not connection.subscription.is_open:
            return
        if self._is_frozen:
            self._held_back.append((connection, data))
            return
        subscription = connection.subscription
        message = rospy.AnyMsg() if subscription.type_class is rospy.AnyMsg else subscription.type_class()
        message.deserialize(data)
        message._connection_header = connection.header
        self._in_turn(subscription.callback, message)

    def stall(self, duration_s: float, frozen: bool = False, after_step: bool = False) -> None:
        """Have its thread stand still from now on.

        Args:
            frozen: the whole process stands still: what is sent meanwhile waits in its sockets, and then looks new.
            after_step: it arrives after the node's first step then, else before.
        """
        self.stalled_until_ns = self.graph.now_ns + round(duration_s * NS_PER_S)
        self._is_frozen = frozen
        self._planned_ns = None
        life = self._life
        if not after_step:
            self.graph.at(self.stalled_until_ns, lambda: self._thaw(life))
        self.plan_step(self.stalled_until_ns)
        if after_step:
            self.graph.at(self.stalled_until_ns, lambda: self._thaw(life))

    def _thaw(self, life):
        if life is not self._life or self.graph.now_ns < self.stalled_until_ns:
            return
        self._is_frozen = False
        held_back, self._held_back = self._held_back, []
        waiting: dict = defaultdict(int)
        for connection, _ in held_back:
            waiting[connection.subscription] += 1
        for connection, data in held_back:
            subscription = connection.subscription
            waiting[subscription] -= 1
            if subscription.queue_size is None or waiting[subscription] < subscription.queue_size:
                self.receive(connection, data, life)

    def kill(self) -> None:
        """End its process without a word, as SIGKILL does. ``start`` starts it again."""
        self.is_alive = False
        self._life = object()
        self.inbox.ending = True
        self.inbox.abandon()
        self._exit()

    def end(self) -> None:
        """End it in order, as a signal does."""
        try:
            self._in_turn(self.node.shut_down)
        except Exception as error:
            self.fault = self.fault or describe_error(error)
        self._end_turn()
        self.is_alive = False
        self._life = object()
        self.inbox.close()
        self._exit()

    def _exit(self):
        self.graph.drop(self.name)
        for action in self.exit_actions:
            action()

    def _watch(self, life):
        """What ``ros.command_topics`` does each second."""
        if life is not self._life or not self.is_alive:
            return
        if not self._is_frozen:
            listed = {name: sorted(each.node for each in found)
                      for name, found in self.graph.publishers.items() if found}
            for watch in self.watches:
                watch.update(self.graph.master_fault, listed, _Lookup)
        self.graph.at(self.graph.now_ns + WATCH_NS, lambda: self._watch(life))


class Call:
    """A call of a service, which waits for its node's thread."""

    def __init__(self, graph: Graph, handler: Callable[[Any], Any], request: Any):
        self._graph = graph
        self._answers: list = []
        self.has_begun = threading.Event()  # it waits, or is answered
        self._sleeps: threading.Event | None = None  # until this is set
        graph.newest_call = self
        self._thread = threading.Thread(target=self._ask, args=(handler, request), daemon=True)
        self._thread.start()
        self.has_begun.wait()

    def _ask(self, handler, request):
        try:
            self._answers.append(_on_wire(handler(_on_wire(request))))
        except Exception as error:
            self._answers.append(error)
        finally:
            self.has_begun.set()

    def sleep(self, duration_s: float) -> None:
        """Block the call's thread for a while of the graph's time."""
        self._sleeps = over = threading.Event()
        self._graph.after(duration_s, over.set)
        self.has_begun.set()
        over.wait()
        self._sleeps = None

    @property
    def is_over(self) -> bool:
        """Whether it is answered; a call that waits for nothing of the graph's time soon is."""
        while self._thread.is_alive() and not self._waits:
            self._thread.join(REAL_POLL_S)
        return not self._thread.is_alive()

    @property
    def _waits(self):
        return (any(node.inbox.awaits_answer for node in self._graph.nodes.values())
                or self._sleeps is not None and not self._sleeps.is_set())

    @property
    def answer(self) -> Any:
        """The answer, or the exception that the caller would get."""
        answer, = self._answers
        return answer

    def finish(self) -> Any:
        while not self.is_over:
            self._graph.run_event()
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


class Graph:
    """All nodes, their messages, and the clock.

    Attributes:
        now_ns: of the monotonic clock.
        ros_ahead_ns: of ROS time to that; the test may set the clock by it.
        recorded: the messages by topic, as Records; of the topics that ``record`` named.
        log: the log of all nodes, as Lines.
        master_fault: what every node finds wrong with the ROS master.
        turn: the node that has its turn.
    """

    def __init__(self):
        self.now_ns = START_NS
        self.ros_ahead_ns = ROS_AHEAD_NS
        self.publishers: dict[str, list[TopicPublisher]] = defaultdict(list)
        self.subscriptions: dict[str, list[Subscription]] = defaultdict(list)
        self.services: dict[str, Callable] = {}
        self.service_types: dict[str, Any] = {}
        self.nodes: dict[str, Node] = {}
        self.recorded: dict[str, list[Record]] = {}
        self.log: list[Line] = []
        self.master_fault = self.turn = ""
        self._parameters: dict = {}
        self._links: list[tuple] = []
        self._last_arrivals: dict[int, int] = {}
        self._senders: dict[tuple[str, str], TopicPublisher] = {}
        self._held: dict[tuple[str, str], Callable[[], None]] = {}
        self._events: list = []
        self.newest_call: Call | None = None
        self._calls: list[Call] = []  # that were not over after the last event
        self._numbers = itertools.count()
        self._handler = _LogHandler(self)
        logger = logging.getLogger("rosout")
        logger.handlers[:] = [self._handler]
        logger.setLevel(logging.DEBUG)
        logger.propagate = False

    @property
    def ros_now(self) -> rospy.Time:
        return rospy.Time(nsecs=self.now_ns + self.ros_ahead_ns)

    # --- nodes and parameters ---

    def add(self, node_class: Callable, name: str, parameters: dict | None = None, remap: dict[str, str] | None = None,
            inbox_limit: int | None = None) -> Node:
        """Start a node.

        Args:
            node_class: called with parameters and inbox.
            name: with its namespace, or one below /.
            parameters: its own, nested as in a YAML file.
            remap: other names of topics and services, by full or relative name.
            inbox_limit: how many messages its inbox holds; ``None`` = as usual.
        """
        name = name if name.startswith("/") else f"/{name}"
        if parameters is not None:
            self.set_parameter(name, parameters)
        self.nodes[name] = node = Node(self, node_class, name, remap or {}, inbox_limit)
        return node

    def parameter(self, name: str, default: Any = None) -> Any:
        value: Any = self._parameters
        for part in filter(None, name.split("/")):
            if not isinstance(value, dict) or part not in value:
                return default
            value = value[part]
        return value

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter by its full name; names with slashes within a dict are namespaces."""
        *parents, last = filter(None, name.split("/"))
        space = self._parameters
        for part in parents:
            space = space.setdefault(part, {})
        space[last] = {} if isinstance(value, dict) else value
        if isinstance(value, dict):
            for key, each in value.items():
                self.set_parameter(f"{name}/{key}", each)

    def drop(self, name: str) -> None:
        """Take all that a node has off the graph."""
        for topic in [*self.publishers]:
            for publisher in [each for each in self.publishers[topic] if each.node == name]:
                publisher.unregister()
        for topic in [*self.subscriptions]:
            for subscription in [each for each in self.subscriptions[topic] if each.node.name == name]:
                subscription.unregister()
        self.services = {service: handler for service, handler in self.services.items()
                         if not service.startswith(f"{name}/")}

    # --- messages ---

    def record(self, *topics: str) -> None:
        """Keep the messages of topics in ``recorded``."""
        for topic in topics:
            self.recorded.setdefault(topic, [])

    def publish(self, topic: str, message: Any, sender: str = "/test") -> None:
        """Publish a message now, as a node of any name."""
        if (topic, sender) not in self._senders:
            self._senders[topic, sender] = TopicPublisher(self, sender, topic, type(message), False, NodeClocks(self))
        self._senders[topic, sender].publish(message)

    def unregister(self, topic: str, sender: str = "/test") -> None:
        self._senders.pop((topic, sender)).unregister()

    def repeat(self, topic: str, message: Callable[[], Any] | Any, rate_hz: float, sender: str = "/test",
               phase_s: float = 0.0) -> Callable[[], None]:
        """Publish a message, or what a function returns, at a rate; return what ends that."""
        is_on = [True]
        period_ns = round(NS_PER_S / rate_hz)

        def tick():
            if is_on:
                self.publish(topic, message() if callable(message) else message, sender)
                self.at(self.now_ns + period_ns, tick)
        self.at(self.now_ns + round(phase_s * NS_PER_S), tick)
        return is_on.clear

    def hold(self, topic: str, message: Callable[[], Any] | Any, rate_hz: float = 50, sender: str = "/test",
             phase_s: float = 0.0) -> None:
        """Have a sender repeat a message, or what a function returns, in place of what it has held before."""
        self.silence(topic, sender=sender)
        self._held[topic, sender] = self.repeat(topic, message, rate_hz, sender, phase_s)

    def silence(self, *topics: str, sender: str = "/test") -> None:
        """End what ``hold`` began."""
        for topic in topics:
            self._held.pop((topic, sender), lambda: None)()

    def repeat_each(self, period_s: float, event: Callable[[], Any]) -> None:
        """Call something now and after each period, for ever."""
        def tick():
            event()
            self.after(period_s, tick)
        tick()

    def flood(self, topic: str, message: Any, count: int, sender: str = "/flood") -> None:
        for _ in range(count):
            self.publish(topic, message, sender)

    def link(self, topic: str = "", sender: str = "", receiver: str = "", delay_s: float = 0.0,
             loses: Callable[[Any], bool] = lambda message: False, copies: int = 1) -> None:
        """Set how messages get through, from now on; the newest rule that fits counts. Empty = any.

        Args:
            delay_s: until each arrives. A shorter delay than before lets it overtake none of its connection, as TCP.
            loses: whether a message, serialised, is lost.
            copies: how often each arrives.
        """
        self._links.append((topic, sender, receiver, delay_s, loses, copies))

    def send(self, connection: Connection, data: bytes, at_ns: int) -> None:
        """Deliver a message to one subscription, as the links say."""
        topic, receiver = connection.publisher.topic, connection.subscription.node
        delay_s, times = 0.0, 1
        for wanted_topic, sender, wanted_receiver, rule_delay_s, loses, copies in reversed(self._links):
            if (wanted_topic in ("", topic) and sender in ("", connection.publisher.node)
                    and wanted_receiver in ("", receiver.name)):
                if loses(data):
                    return
                delay_s, times = rule_delay_s, copies
                break
        arrival_ns = max(at_ns + round(delay_s * NS_PER_S), self._last_arrivals.get(id(connection), 0))
        self._last_arrivals[id(connection)] = arrival_ns
        life = receiver._life
        for _ in range(times):
            self.at(arrival_ns, lambda: receiver.receive(connection, data, life))

    def messages(self, topic: str, since_ns: int = 0) -> list[Any]:
        """Return the recorded messages of a topic since a time."""
        return [record.message for record in self.recorded[topic] if record.at_ns >= since_ns]

    def newest(self, topic: str) -> Any:
        return self.recorded[topic][-1].message

    def report(self, name: str, since_ns: int = 0) -> Report:
        """Return the newest report of a name on /diagnostics, which is recorded."""
        status = next(status for record in reversed(self.recorded["/diagnostics"]) for status in record.message.status
                      if status.name == name and record.at_ns >= since_ns)
        return Report(status.level, status.message, {pair.key: pair.value for pair in status.values})

    def lines(self, node: str = "", since_ns: int = 0, level: int = logging.INFO) -> list[str]:
        return [line.text for line in self.log
                if line.at_ns >= since_ns and line.level >= level and line.node.startswith(node)]

    # --- services ---

    def call(self, service: str, request: Any) -> Any:
        """Call a service; let time go on until it answers; return the answer, or raise what the caller would get."""
        return self.begin_call(service, request).finish()

    def begin_call(self, service: str, request: Any) -> Call:
        """Call a service that answers while time goes on."""
        call = Call(self, self.services[service], request)
        self._calls.append(call)
        return call

    def reconfigure(self, namespace: str, **changes: Any) -> dict:
        """Change values by dynamic_reconfigure; return those that count now."""
        answer = self.call(f"{namespace}/set_parameters", ReconfigureRequest(encode_config(changes)))
        return {each.name: each.value for each in answer.config.ints}

    def readable(self, fd: Any) -> None:
        for node in self.nodes.values():
            if node.is_alive and fd in node.inbox.fds:
                node.inbox.wake()

    # --- time ---

    def at(self, at_ns: int, event: Callable[[], None]) -> None:
        """Call something at a time, after what was planned for that time before."""
        heapq.heappush(self._events, (max(at_ns, self.now_ns), next(self._numbers), event))

    def after(self, delay_s: float, event: Callable[[], None]) -> None:
        self.at(self.now_ns + round(delay_s * NS_PER_S), event)

    def run(self, duration_s: float) -> None:
        self.run_to(self.now_ns + round(duration_s * NS_PER_S))

    def run_to(self, end_ns: int) -> None:
        while self._events and self._events[0][0] <= end_ns:
            self.run_event()
        self.now_ns = end_ns

    def run_until(self, condition: Callable[[], bool], within_s: float = 10.0) -> int:
        """Let time go on until a condition is true, which it must be within a time; return when that was."""
        deadline_ns = self.now_ns + round(within_s * NS_PER_S)
        while not condition():
            assert self._events and self._events[0][0] <= deadline_ns, f"not within {within_s} s"
            self.run_event()
        return self.now_ns

    def run_event(self) -> None:
        self.now_ns, _, event = heapq.heappop(self._events)
        event()
        self._calls = [call for call in self._calls if not call.is_over]  # a call that is answered ends in no time


class _Lookup:
    """What ``ros.command_topics`` finds out about the publishers of a subscription's topic."""

    @staticmethod
    def publishers(subscription: Subscription, listed: Any) -> list[Publisher]:
        return sorted(Publisher(each.node, MACHINE, each.type._type)
                      for each in subscription.graph.publishers[subscription.resolved_name])


class _LogHandler(logging.Handler):
    def __init__(self, graph: Graph):
        super().__init__()
        self._graph = graph

    def emit(self, record):
        self._graph.log.append(Line(self._graph.now_ns, self._graph.turn, record.levelno, record.getMessage()))


def _on_wire(value):
    """A request or answer as it arrives."""
    if not hasattr(value, "serialize"):
        return value
    buffer = io.BytesIO()
    value.serialize(buffer)
    return _message(type(value), buffer.getvalue())


def _message(message_type, data):
    message = message_type()
    message.deserialize(data)
    return message
