import numpy as np
import pytest

from masat.study.statistics import fisher, mcnemar, wilson


def test_wilsons_interval_is_the_published_one():
    # Newcombe, Two-sided confidence intervals for the single proportion, 1998, table I.
    assert np.allclose(wilson(81, 263), (0.2553, 0.3662), atol=5e-5)
    assert np.allclose(wilson(15, 148), (0.0624, 0.1605), atol=5e-5)
    assert np.allclose(wilson(0, 20), (0, 0.1611), atol=5e-5)
    assert np.allclose(wilson(1, 29), (0.0061, 0.1718), atol=5e-5)
    assert wilson(50, 50)[1] == 1
    assert wilson(0, 0) == (0, 1)


def test_mcnemars_test_is_the_sign_test_of_the_disagreements():
    assert mcnemar(0, 0) == 1
    assert mcnemar(5, 5) == 1
    assert mcnemar(0, 5) == pytest.approx(2 / 32)
    assert mcnemar(1, 9) == pytest.approx(2 * (1 + 10) / 1024)
    assert mcnemar(9, 1) == mcnemar(1, 9)


def test_fishers_test_of_the_tea_tasting_lady():
    # The Design of Experiments, 1935: three of four cups right is no proof, four of four is.
    assert fisher(3, 4, 1, 4) == pytest.approx(34 / 70)
    assert fisher(4, 4, 0, 4) == pytest.approx(2 / 70)
    assert fisher(49, 50, 50, 50) == 1
