"""Tests of a log before any fit: sampling, ratio, slips and orders."""
