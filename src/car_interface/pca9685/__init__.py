"""The PCA9685 servo board: a 16-channel, 12-bit PWM chip on I²C (NXP data sheet PCA9685, rev. 4)."""
