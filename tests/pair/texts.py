"""Pair files to start from: the contract's example word for word, and others."""

CONTRACT = """
name = "VTTIG rig"
[pair]
module_mm = 2.0                    # transverse; or normal_module_mm
pressure_angle_deg = 20.0          # transverse; or normal_pressure_angle_deg
centre_distance_mm = 125.12
[driving]
teeth = 45
face_width_mm = 20.0
helix_angle_deg = 3.0              # or helix_left_deg and helix_right_deg; positive: thins towards +z
encoder = { counts_per_rev = 90000, accuracy_arcsec = 18 }   # also modulus, sign = 1
[driven]
teeth = 80
face_width_mm = 20.0
helix_angle_deg = 3.0
encoder = { counts_per_rev = 90000, accuracy_arcsec = 18 }
[log]                              # optional; these are the defaults looked for
time = "time_s"                    # or sample_rate_hz = 2000.0
driving = "driving_counts"         # unit from [unit] or suffix _counts _deg _rad _rev
driven = "driven_counts"           # or transmission_error = "transmission_error_arcsec"
zero = "start"                     # or "reading"
[fit]                              # optional
driving_orders = [1, 2, 3, 4, 5, 6, 7, 8]
driven_orders = [1, 2, 3, 4, 5, 6, 7, 8]
mesh_orders = 1
"""  # noqa: E501

OTHER_KEYS = """
[pair]
normal_module_mm = 2.0
normal_pressure_angle_deg = 20.0
[driving]
teeth = 45
helix_left_deg = 3.0
helix_right_deg = -3.0
encoder = { counts_per_rev = 90000, modulus = 65536, sign = -1 }
[driven]
teeth = 80
helix_left_deg = 3.0
helix_right_deg = -3.0
[log]
sample_rate_hz = 2000.0
driving = "a/motor"
transmission_error = "error"
zero = "reading"
driving_scale = "7/1798"
driven_scale = 0.5
direction = "way"
from = 12.5
to = "80rev"
cut = ["18:21", "3rev:4.5rev"]
missing = "skip"
lead_mm = 5.0
axial_mm = "shift"
torque = "torque"
speed = "motor_rpm"
acceleration = "motor_rad_per_s2"
decimal = ","
delimiter = ";"
encoding = "latin-1"
[unit]
driving = "rev"
transmission_error = "urad"
[fit]
driving_orders = []
driven_orders = [3]
mesh_orders = 0
"""

MINIMAL = """
[pair]
module_mm = 2.0
pressure_angle_deg = 20.0
[driving]
teeth = 45
[driven]
teeth = 80
"""
DRIVE = '[drive]\nratio = "7/1798"\n'
