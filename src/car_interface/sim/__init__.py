"""The car without hardware: the Teensy's firmware, the car that moves, and the walls that its sonars see.

Everything here is pure: bytes and numbers in, values out, time passed in as nanoseconds. It shares no code with the
parts that are tested against it.
"""
