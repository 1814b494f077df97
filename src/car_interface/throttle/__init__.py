"""The throttle: from a speed or an acceleration to the converter's value, and from value or stick to the ESC's duty.

``speed_control`` and ``converter`` turn a planner's speed into a value. ``control`` turns that value, or the stick,
into the duty that the ESC gets; begin to read there.
"""
