"""Intervals and tests for success rates."""

from __future__ import annotations

from math import comb, sqrt


def wilson(successes: int, trials: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return Wilson's score interval (low, high) of a success rate.

    Parameters
    ----------
    successes, trials : int
        Number of successes and of all trials.
    z : float
        Quantile of the normal distribution; the default gives the 95 % interval.

    Notes
    -----
    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    if trials == 0:
        return 0.0, 1.0
    p = successes / trials
    middle = p + z * z / (2 * trials)
    half = z * sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    # At the ends the formula gives 0 and 1 up to rounding.
    low = 0.0 if successes == 0 else (middle - half) / scale
    high = 1.0 if successes == trials else (middle + half) / scale
    return low, high


def mcnemar(only_one: int, only_other: int) -> float:
    """Return the two-sided p-value of McNemar's exact test that two methods succeed equally often.

    Parameters
    ----------
    only_one, only_other : int
        Number of instances on which only the one method succeeds, and only the other.

    Notes
    -----
    Source: McNemar, Note on the sampling error of the difference between correlated proportions,
    1947, with the binomial distribution instead of its limit.
    """
    n, few = only_one + only_other, min(only_one, only_other)
    tail = sum(comb(n, k) for k in range(few + 1))
    return min(1.0, float(2 * tail / 2**n))


def fisher(k: int, n: int, other_k: int, other_n: int) -> float:
    """Return the two-sided p-value of Fisher's exact test that two samples have the same rate.

    Parameters
    ----------
    k, n : int
        Number of successes and of trials in the one sample.
    other_k, other_n : int
        The same of the other sample.

    Notes
    -----
    Source: Fisher, The logic of inductive inference, 1935: the sum over all tables with the same
    margins that are no more likely.
    """
    total = k + other_k
    ways = [comb(n, i) * comb(other_n, total - i) for i in range(total + 1)]
    return sum(w for w in ways if w <= ways[k]) / sum(ways)
