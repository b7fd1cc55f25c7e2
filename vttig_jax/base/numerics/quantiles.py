"""Quantiles of distributions that bound intervals."""

NORMAL_95 = 1.959963984540054  # 97.5 % quantile of the standard normal distribution
