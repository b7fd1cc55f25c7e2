"""Parameters, orders, checks and notes of a fit."""
