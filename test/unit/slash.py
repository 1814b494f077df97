"""The calibration of a Traxxas Slash 4x4, as its owner published it; and how another car turns at speed."""
from car_interface.steering.calibration import SteeringCalibration

PARAMETERS = {
    "servo_left": 3800,
    "servo_center": 5100,
    "servo_right": 6700,
    "servo_channel": 0,
    "m_turnrad_axis_servo": [1, 2, 3, 4, 5, 6, 7, 10, 20, 30, 40, 60, 80, 100, 300],
    "k_pwmcmd_left_table_servo": [3800, 3830, 3840, 3850, 3860, 3870, 3880, 3890, 3900, 3950, 4000, 4300, 4600, 4900,
                                  5100],
    "k_pwmcmd_right_table_servo": [6700, 6650, 6600, 6500, 6450, 6400, 6350, 6250, 6150, 6050, 5950, 5900, 5600, 5300,
                                   5100],
}
CENTER = PARAMETERS["servo_center"]
SLASH = SteeringCalibration(*PARAMETERS.values())

# A 3.5 kg F1TENTH car on a skid pad, by motion capture, steady commands, left: the radius (m) that each steering angle
# (rad) drives at each speed (m/s). From the public recordings of Tinker-Twins/F1TENTH-Mocap-Data-Recording-Pipeline.
SKIDPAD = {
    0.312: {0.5: 1.488, 1.0: 1.499, 1.5: 1.529, 2.0: 1.599, 2.5: 1.733},
    0.416: {0.5: 1.097, 1.0: 1.105, 1.5: 1.137, 2.0: 1.194, 2.5: 1.346},
    0.52: {0.5: 0.98, 1.0: 0.987, 1.5: 1.022, 2.0: 1.074, 2.5: 1.25},
}
