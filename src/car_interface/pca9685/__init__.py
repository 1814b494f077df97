"""The PCA9685 servo board: a 16-channel, 12-bit PWM chip on I²C (NXP data sheet PCA9685, rev. 4).

Everything but ``i2c_device`` is pure: numbers, bytes and ``now_ns`` in, values out; what opens a bus is passed in.
"""
