"""A synthetic rig: motion, exact kinematics, play and encoders, to an encoder log."""
