"""Causes for which the car is driven, stopped or limited, one constant each; and the modes: who steers and drives.

A cause is the kind of reason, without numbers. Decisions carry it beside the reason in words; the state message, the
diagnostics, the doctor and the report pass it on unchanged. Programs compare causes and never parse a reason.
"""
from __future__ import annotations

# Motion interlock: emergency stop and deadman.
STARTING = "starting"  # the first e_stop is awaited
E_STOP = "e_stop"
E_STOP_STALE = "e_stop silent"
E_STOP_NEVER_RECEIVED = "e_stop never heard"
HUMAN_STALE = "human silent"
HUMAN_NEVER_RECEIVED = "human never heard"
HUMAN_ABSENT = "human absent"
NOT_REARMED = "not re-armed"  # the deadman must be released and held again

# Steering arbiter.
TELEOP = "teleop"
TELEOP_STALE = "teleop silent"
TELEOP_NOT_FINITE = "teleop not finite"
PLANNER = "planner"
PLANNER_STALE = "planner silent"
PLANNER_NOT_FINITE = "planner not finite"
NO_REQUEST = "no request"  # none was ever received
NO_RADIUS = "no radius"  # the planner requests 0
TWO_REQUESTS = "two requests"  # av_turnrad_req and av_steer_req at the same time
REQUEST_REFUSED = "request refused"  # no car can do what the planner asks for

# Throttle.
DRIVING = "driving"
MODE_STALE = "mode silent"
MODE_UNKNOWN = "mode unknown"
CONVERTING = "converting"  # the converter has a value for the newest command
STEERING_STALE = "steering silent"
STEERING_STOPPED = "steering stopped"
STEERING_NOT_HELD = "steering not held"  # the servo board does not hold what turn_arb commands
BOARD_STALE = "board silent"
BOARD_NEVER_RECEIVED = "board never heard"
COMMAND_STALE = "command silent"
COMMAND_AWAITED = "command awaited"  # the planner asks again, and its first value hasn't come yet
COMMAND_NOT_FINITE = "command not finite"
ODOMETRY_STALE = "odometry silent"
ODOMETRY_NOT_FINITE = "odometry not finite"

# ESC: its action, or why that differs from the request.
ESC_ARMING = "esc arming"
ESC_MOTION = "esc motion"  # the car moved against the ESC's state: a wrong profile, a hill
NO_THROTTLE = "no throttle"  # neutral is requested
BRAKING = "braking"
HOLDING = "holding"  # a brake at standstill
STOPPING = "stopping"
REVERSING = "reversing"
REVERSE_PENDING = "reverse pending"  # the ESC needs a brake or neutral first
REVERSE_REFUSED = "reverse refused"
BRAKE_UNCERTAIN = "brake uncertain"  # the ESC could take it for reverse
AT_STANDSTILL = "at standstill"  # where a brake doesn't become reverse
REQUEST_NOT_FINITE = "request not finite"
CALIBRATION_DRIVE = "calibration drive"  # the ESC gets a person's pulls as they are

# Limits: how a request was changed.
LIMITS_OFF = "limits off"  # no odometry was ever received
TOO_TIGHT = "too tight"  # the wheels can't turn the car so: probably the planner's units
LATERAL_LIMITED = "lateral acceleration"  # the turn is widened
JERK_LIMITED = "lateral jerk"  # it turns in more slowly
SPEED_LIMITED = "max speed"
CURVE_SLOWED = "slowed for the turn"  # it is too fast for the turn that is asked for
SPEED_LATE = "odometry late"  # no push until its next report
ACCELERATION_LIMITED = "max acceleration"
BRAKING_LIMITED = "max braking"
OBSTACLE_SLOWED = "obstacle"  # by a sonar ahead, or behind while it reverses
SONAR_SILENT = "sonar silent"  # one that looks where the car drives

# Gamepad. The first four are also the values of /teleop_logi/mode: who steers and who drives while a deadman is held.
MANUAL = "manual"  # the manual deadman: the human steers and drives
AUTONOMOUS = "autonomous"  # the autonomous deadman: the planner steers and drives, a human watches
HUMAN_THROTTLE = "human_throttle"  # the third deadman, and this is its mode: the planner steers, the human drives
HUMAN_STEERING = "human_steering"  # likewise: the human steers, the planner drives
NO_DEADMAN = "no deadman"
JOY_STALE = "joy silent"
JOY_NEVER_RECEIVED = "joy never heard"
JOY_NOT_FINITE = "joy not finite"
JOY_INCOMPLETE = "joy incomplete"  # a configured axis or button is missing
JOY_UNMAPPED = "joy unmapped"  # nobody has said what this gamepad's axes and buttons do
# Its sticks.
OVERRIDE = "override"  # the human has an actuator under a deadman that gives it to the planner
# The planner gets the actuator back when the stick was centered for this long: more than a hand needs from one side of
# the center to the other.
OVERRIDE_HOLD_S = 0.5
OFF_CENTER = "off center"  # since the deadman was pressed: it overrides nothing but by a pull
NOT_AT_REST = "not at rest"  # the axis was not seen at its rest, so it doesn't count

# Publishers of a topic that a node obeys.
WRONG_TYPE = "wrong type"  # its messages aren't received
UNKNOWN_HOST = "unknown host"  # of the publisher: it can't be reached from here
SECOND_PUBLISHER = "second publisher"  # the newest message of either is obeyed

PLANNER_UNHEARD = "planner unheard"  # nobody takes its messages

# A node's start.
PARAMETER_REFUSED = "parameter refused"

# Servo board.
GUARD_ABSENT = "guard absent"  # nothing would make the board safe if its node died
GUARD_BLOCKED = "guard blocked"  # the guard can't reach the board
NODE_STOOD_STILL = "node stood still"  # for too long: messages from that time are no longer obeyed
FOREIGN_WRITE = "foreign write"  # another program wrote to the board
CHANNEL_TIMED_OUT = "channel timed out"  # its commands have stopped, and it is at its timeout value

MODES = (MANUAL, AUTONOMOUS, HUMAN_THROTTLE, HUMAN_STEERING)
HUMAN_DRIVES = frozenset({MANUAL, HUMAN_THROTTLE})
HUMAN_STEERS = frozenset({MANUAL, HUMAN_STEERING})

STEERING_CUTS = frozenset({TOO_TIGHT, LATERAL_LIMITED, JERK_LIMITED})
THROTTLE_CUTS = frozenset({SPEED_LIMITED, CURVE_SLOWED, SPEED_LATE, ACCELERATION_LIMITED, BRAKING_LIMITED,
                           OBSTACLE_SLOWED, SONAR_SILENT})

# The gamepad has to be set right: to let go and hold again doesn't help.
JOY_UNUSABLE = frozenset({JOY_INCOMPLETE, JOY_UNMAPPED, JOY_NOT_FINITE})

LOCKS = frozenset({E_STOP, E_STOP_STALE, E_STOP_NEVER_RECEIVED})
# Causes for which the motion interlock inhibits steering and throttle.
INHIBITS = LOCKS | {STARTING, HUMAN_STALE, HUMAN_NEVER_RECEIVED, HUMAN_ABSENT, NOT_REARMED}
# An input arrived before and has stopped arriving.
STALE = frozenset({E_STOP_STALE, HUMAN_STALE, TELEOP_STALE, PLANNER_STALE, STEERING_STALE, BOARD_STALE, MODE_STALE,
                   COMMAND_STALE, ODOMETRY_STALE, JOY_STALE})
NOT_FINITE = frozenset({TELEOP_NOT_FINITE, PLANNER_NOT_FINITE, COMMAND_NOT_FINITE, ODOMETRY_NOT_FINITE,
                        REQUEST_NOT_FINITE, JOY_NOT_FINITE})
# Something worked and failed, as opposed to an operator who stopped the car or has not started it yet.
LOSSES = STALE | NOT_FINITE | JOY_UNUSABLE | {NOT_REARMED, ESC_MOTION, STEERING_NOT_HELD}
