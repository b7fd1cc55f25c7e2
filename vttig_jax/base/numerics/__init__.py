"""Numerical tools: autoregression, rounding of quotients, and sine with cosine."""
