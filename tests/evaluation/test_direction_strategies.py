"""The table of strategies by direction, of made-up trials."""

import math

import pandas as pd
import pytest

from tests.evaluation.test_strategies import trials
from zfall.evaluation.direction_strategies import DirectionStrategies, direction_table


@pytest.fixture
def table():
    """Unpushed it takes up to 2 steps. Forward 3 and 0 steps, diagonally 1 step and a bent hip."""
    control = trials({"steps": [0, 1, 2, 2]}, impulse=0.0)
    small = trials({"steps": [0, 2]}, impulse=0.2).assign(direction_rad=[0.0, math.pi / 4])
    large = trials({"steps": [3, 0, 1], "hip_rad": [0.0, 0.0, 0.4]}, impulse=0.5)
    large["direction_rad"] = [2 * math.pi, 0.0, 3 * math.pi / 4]
    fallen = trials({"steps": [9]}, impulse=0.5).assign(direction_rad=math.pi, recovered=False)
    return direction_table(pd.concat([control, small, large, fallen])).set_index("strategy")


def test_shares_are_of_the_recovered_trials_of_a_direction(table):
    assert table.loc["stepping", ["forward", "diagonal", "small"]].tolist() == [0.5, 0.0, 0.0]
    assert table.loc["hip", ["forward", "diagonal"]].tolist() == [0.0, 1.0]
    assert table.loc["ankle", ["forward", "diagonal", "small"]].tolist() == [0.5, 0.0, 1.0]
    assert table["side"].isna().sum() == 6  # nobody was pushed there


def test_the_numbers_of_trials_are_told(table):
    assert table.loc["recovered"].tolist() == [2, 0, 1, 0, 2]
    assert table.loc["pushed"].tolist() == [2, 1, 1, 0, 2]


def test_left_and_right_are_one_side():
    left_right = trials({"steps": [5, 0]}, impulse=0.5)
    left_right["direction_rad"] = [math.pi / 2, 3 * math.pi / 2]
    small = trials({"steps": [0]}, impulse=0.2)
    control = trials({"steps": [0]}, impulse=0.0)
    table = DirectionStrategies.summary(pd.concat([control, small, left_right]))
    found = table["strategies_by_direction"].set_index("strategy")["side"]
    assert found["stepping"] == 0.5
    assert found["recovered"] == 2
