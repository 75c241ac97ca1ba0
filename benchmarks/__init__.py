"""Measurements, as ratios within one run; `make benchmark` runs them."""
