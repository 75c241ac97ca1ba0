"""When a trial of a lower minimum is given up."""

import numpy as np
import pytest

from masat.optimality.stopping import StopIfFar, StopIfHopeless
from masat.optimizers import Iteration


def step(chi2, length=1.0):
    return Iteration(chi2, length, 0.0, 0.0)


def test_a_trial_ends_where_the_steps_left_cannot_gain_what_is_missing():
    stop = StopIfHopeless(0.0, 5)
    # Half of what was expected before counts while the steps are short.
    assert [stop(step(chi2)) for chi2 in (100.0, 99.0, 98.9)] == [False, False, True]


def test_a_trial_that_is_low_enough_goes_on():
    stop = StopIfHopeless(50.0, 3)
    assert not any(stop(step(chi2)) for chi2 in (49.9, 49.8, 49.7, 49.69))


@pytest.mark.parametrize(("length", "stops"), [(0.6, False), (0.4, True)])
def test_a_trial_near_a_minimum_ends_where_it_gains_little(length, stops):
    stop = StopIfHopeless(0.0, 30)
    assert not stop(step(50.0, 1.0))
    assert stop(step(49.0, length)) is stops


def test_a_trial_ends_where_it_began():
    home = np.array([[1.0, 2.0, 3.1], [0.0, 0.0, 0.5]])
    stop = StopIfHopeless(0.0, 30, home)
    # The positions follow from the rotations; an angle beyond pi is the same as one before.
    stop.look(home + np.array([5.0, 5.0, 0.15]))
    assert not stop(step(10.0))
    stop.look(home + np.array([5.0, 5.0, 0.05 - 2 * np.pi]))
    assert stop(step(5.0))


def test_all_nodes_are_free_for_few_steps():
    assert [StopIfFar(0.0, 10.0)(step(chi2)) for chi2 in (9.0, 7.0, 11.0)] == [True, False, True]
    assert not StopIfFar(0.0, 10.0)(step(-0.5))
