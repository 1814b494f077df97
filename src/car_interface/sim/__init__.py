"""The car without hardware: the Teensy's firmware, the car that moves, and the walls that its sonars see.

Everything in here is honest and pure: bytes and numbers in, values out, time passed in as nanoseconds. Nothing is
shared with the parts that are tested against it.
"""
