from dataclasses import dataclass

import numpy as np
import pytest

from tests.posterior.densities import Gaussian, plain
from vttig_jax.base.errors import NoAnswerError
from vttig_jax.posterior.sampling.target import CheckedDensity, Target, starting_points

pytestmark = pytest.mark.smoke


class Bounded(Gaussian):
    """A normal that exists below a bound of the second coordinate only."""

    bound = 0.0

    def log_density(self, points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 1] < self.bound, super().log_density(points), -np.inf)


@dataclass
class Placed(Gaussian):
    """A normal that starts where it is told."""

    places: np.ndarray | None = None

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        assert self.places is not None
        return self.places


def placed(places: np.ndarray, d: int = 2) -> CheckedDensity:
    return CheckedDensity(Placed(np.zeros(d), np.eye(d), places=places))


def begin(density: CheckedDensity, walkers: int = 16) -> tuple[np.ndarray, np.ndarray]:
    return starting_points(density, walkers, np.random.default_rng(0))


def sentence(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text and text.endswith(".")
    return text


def test_the_density_of_the_tests_is_a_target():
    assert isinstance(plain(), Target)
    assert not isinstance(object(), Target)


def test_starts_inside_are_taken_as_they_are():
    points, values = begin(CheckedDensity(plain()))
    np.testing.assert_array_equal(points, plain().starts(16, np.random.default_rng(0)))
    np.testing.assert_array_equal(values, plain().log_density(points))


def test_starts_outside_are_drawn_anew_and_those_inside_kept():
    target = Bounded(np.zeros(2), np.eye(2))
    first = target.starts(16, np.random.default_rng(0))
    points, values = begin(CheckedDensity(target))
    inside = first[:, 1] < 0
    assert 0 < inside.sum() < 16
    assert (points[:, 1] < 0).all() and np.isfinite(values).all()
    np.testing.assert_array_equal(points[inside], first[inside])
    np.testing.assert_array_equal(values, target.log_density(points))
    assert set(target.sizes) == {16}  # one shape: one compilation


def test_starts_that_are_hardly_ever_inside_name_the_coordinate():
    target = Bounded(np.zeros(2), np.eye(2))
    target.bound = -2.6
    with pytest.raises(NoAnswerError, match="mostly because of the coordinate `x1`") as caught:
        begin(CheckedDensity(target), 64)
    assert "walkers start where the density is zero" in sentence(caught.value)


def test_starts_that_are_never_inside_give_one():
    target = Bounded(np.zeros(2), np.eye(2))
    target.bound = -100.0
    with pytest.raises(NoAnswerError, match="16 of 16 walkers start where the density is zero"):
        begin(CheckedDensity(target))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_density_that_is_no_number_names_the_point(value):
    class Broken(Gaussian):
        def log_density(self, points: np.ndarray) -> np.ndarray:
            found = super().log_density(points)
            found[3] = value
            return found

    target = Broken(np.zeros(2), np.eye(2), units=("mm", ""))
    points = np.arange(12.0).reshape(6, 2)
    words = rf"the log density is {value} at x0 = 6 mm, x1 = 7; it must"
    with pytest.raises(NoAnswerError, match=words) as caught:
        CheckedDensity(target)(points)
    sentence(caught.value)


def test_a_density_of_the_wrong_shape_is_a_mistake_in_code():
    class Column(Gaussian):
        def log_density(self, points: np.ndarray) -> np.ndarray:
            return super().log_density(points)[:, None]

    with pytest.raises(ValueError, match=r"one log density per point, but gives shape \(4, 1\)"):
        CheckedDensity(Column(np.zeros(2), np.eye(2)))(np.zeros((4, 2)))


def test_walkers_in_one_place_are_refused():
    places = np.random.default_rng(1).standard_normal((16, 2))
    places[5] = places[2]
    with pytest.raises(NoAnswerError, match="1 of 16 walkers start at the same point as another"):
        begin(placed(places))


def test_a_coordinate_without_spread_is_named():
    places = np.random.default_rng(1).standard_normal((16, 2))
    places[:, 1] = 3.0
    with pytest.raises(NoAnswerError, match="all walkers start at one value of `x1`"):
        begin(placed(places))


def test_walkers_in_a_plane_are_refused_and_almost_in_a_plane_taken():
    places = np.random.default_rng(1).standard_normal((16, 3)) * [1.0, 1e6, 1e-6]
    places[:, 2] = 2e-6 * places[:, 0] + 3e-12 * places[:, 1]
    with pytest.raises(NoAnswerError, match="are a linear combination of those of the other"):
        begin(placed(places, 3))
    places[:, 2] += 1e-11 * np.random.default_rng(2).standard_normal(16)
    begin(placed(places, 3))


def test_starts_that_are_not_finite_name_the_coordinate():
    places = np.random.default_rng(1).standard_normal((16, 2))
    places[3, 1] = np.nan
    with pytest.raises(NoAnswerError, match="not finite in the coordinate `x1`"):
        begin(placed(places))


def test_starts_of_the_wrong_shape_are_a_mistake_in_code():
    with pytest.raises(ValueError, match=r"starts of shape \(16, 2\), but gives \(16, 3\)"):
        begin(placed(np.zeros((16, 3))))
