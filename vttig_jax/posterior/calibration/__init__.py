"""Calibration: does a nominal 95 % interval hold the truth in 95 % of the rigs?"""
