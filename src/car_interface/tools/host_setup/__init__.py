"""Access to the car's devices: groups, udev rules, the I²C bus."""
