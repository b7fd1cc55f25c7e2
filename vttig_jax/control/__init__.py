"""Plants, controllers and the scenario file that names them: one simulated reversal, or many."""
