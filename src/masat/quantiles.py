"""Quantiles of the chi-squared distribution, by degrees of freedom."""

# What one in ten honest measurements stays below, a quarter and half of them.
TENTH = {1: 0.0158, 2: 0.2107, 3: 0.584, 4: 1.064, 5: 1.610, 6: 2.204}
QUARTER = {1: 0.102, 2: 0.575, 3: 1.213, 4: 1.923, 5: 2.675, 6: 3.455}
MEDIAN = {1: 0.455, 2: 1.386, 3: 2.366, 4: 3.357, 5: 4.351, 6: 5.348}
# What one honest measurement in 100 exceeds, one in 1,000, and one in 100,000.
LOSS_GATE = {1: 6.635, 2: 9.210, 3: 11.345, 4: 13.277, 5: 15.086, 6: 16.812}
GATE = {1: 10.83, 2: 13.82, 3: 16.27, 4: 18.47, 5: 20.52, 6: 22.46}
FAR_GATE = {1: 19.51, 2: 23.03, 3: 25.90, 4: 28.47, 5: 30.86, 6: 33.11}
