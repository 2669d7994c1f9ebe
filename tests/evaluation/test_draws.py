"""What was drawn in trials, and what of it explains failures, by hand."""

import numpy as np
import pandas as pd
import pytest
import torch
from matplotlib.figure import Figure
from scipy.stats import fisher_exact
from tensordict import TensorDict

from tests.evaluation.moments import ENDED, moment
from zfall.evaluation.draws import Draws, success_by_draw
from zfall.evaluation.plots import thirds_plot


def trials(drawn: list[float], recovered: list[bool], **more: list[float]) -> pd.DataFrame:
    columns = {f"drawn/{name}": values for name, values in more.items()}
    table = {"impulse": 0.3, "drawn/latency": drawn, "recovered": recovered, **columns}
    return pd.DataFrame(table)


def test_a_trial_keeps_what_it_begins_with(make_base):
    draws = Draws(make_base(num_envs=1))
    for step in range(2):  # the second is a later draw
        params = {
            "foot_friction": torch.tensor([[0.5 + step]]),
            "com_offset": torch.tensor([[3.0, 4.0, 0.0, 0.0]]) + step,
        }
        draws.before(TensorDict({"params": params}, [1]), moment([True], -1.0))
    table = draws.table(ENDED)
    assert table["drawn/foot_friction"].item() == 0.5
    assert table["drawn/com_offset"].item() == pytest.approx((25 / 4) ** 0.5)


def test_without_draws_there_is_no_table(make_base):
    draws = Draws(make_base(num_envs=1))
    draws.before(TensorDict({}, [1]), moment([True], -1.0))
    assert draws.table(ENDED) == {}
    assert Draws.summary(pd.DataFrame({"impulse": [0.1], "recovered": [True]})) == {}


def test_success_is_that_of_thirds_of_the_pushed_trials():
    """Nine trials, of which those with the largest values fail; a tenth was not pushed."""
    table = trials([*range(9), 100.0], [True] * 5 + [False, True, False, False, False])
    table["impulse"] = [0.3] * 9 + [0.0]
    (row,) = success_by_draw(table).to_dict("records")
    assert row["parameter"] == "latency"
    assert (row["smallest"], row["largest"]) == (0.0, 8.0)
    assert (row["low"], row["middle"], row["high"]) == pytest.approx((1.0, 2 / 3, 1 / 3))


def test_what_explains_failures_comes_first():
    rng = np.random.default_rng(0)
    latency, friction = rng.random((2, 600))
    table = trials(latency.tolist(), (latency < 0.5).tolist(), friction=friction.tolist())
    found = success_by_draw(table)
    assert found["parameter"].tolist() == ["latency", "friction"]
    assert found["p"][0] < 1e-6 < 0.01 < found["p"][1]
    assert found["low"][0] == 1.0
    assert found["high"][0] == 0.0


def test_equal_values_leave_a_third_empty_and_a_constant_has_no_row():
    table = trials([0.0] * 20 + [1.0] * 20, [True] * 10 + [False] * 30, same=[2.0] * 40)
    (row,) = success_by_draw(table).to_dict("records")
    assert (row["low"], row["high"]) == (0.5, 0.0)
    assert np.isnan(row["middle"])
    assert row["p"] == pytest.approx(fisher_exact([[10, 0], [10, 20]]).pvalue, abs=2e-3)


def test_where_all_trials_end_alike_nothing_explains_it():
    assert success_by_draw(trials([*range(9)], [True] * 9))["p"].tolist() == [1.0]


def test_the_plot_shows_success_of_the_thirds_and_what_explains_most_on_top(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(
        Figure, "savefig", lambda self, path, **settings: figures.append((path.name, self))
    )
    rng = np.random.default_rng(0)
    latency, friction = rng.random((2, 600))
    table = trials(latency.tolist(), (latency < 0.5).tolist(), friction=friction.tolist())
    assert Draws.figures(table, tmp_path, "mine") == ["draws.png", "draws.pdf"]
    assert [name for name, _ in figures] == ["draws.png", "draws.pdf"]
    (axes,) = figures[0][1].axes
    assert figures[0][1].get_suptitle() == "mine"
    shown = [label.get_text().split(",")[0] for label in axes.get_yticklabels()]
    assert shown == ["latency", "friction"]
    assert axes.yaxis_inverted()
    found = success_by_draw(table)
    bars, thirds = axes.collections[::2], axes.collections[1::2]
    for part, drawn, interval in zip(("low", "middle", "high"), thirds, bars, strict=True):
        np.testing.assert_allclose(drawn.get_offsets()[:, 0], 100 * found[part])
        # Latency explains, friction does not.
        assert drawn.get_facecolor()[:, 3].tolist() == [1.0, 0.3]
        for share, n, segment in zip(
            found[part], found[f"n_{part}"], interval.get_segments(), strict=True
        ):
            # Wilson's interval in closed form, z = 1.96.
            z, middle = 1.959964, (share + 1.959964**2 / (2 * n)) / (1 + 1.959964**2 / n)
            half = z * np.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2) / (1 + z**2 / n)
            np.testing.assert_allclose(
                segment[:, 0] / 100, [middle - half, middle + half], atol=1e-6
            )


def test_the_plot_shows_the_five_that_explain_most_and_counts_the_others(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **settings: figures.append(self))
    rows = [
        {"parameter": f"x{k}", "smallest": 0.0, "largest": 1.0, "low": 0.5, "middle": 0.4,
         "high": 0.3, "p": 10.0 ** (k - 6), "n_low": 20, "n_middle": 20, "n_high": 20}
        for k in range(7)
    ]  # fmt: skip
    for last in (1.0, 0.04):
        rows[5]["p"] = last
        thirds_plot(pd.DataFrame(rows), tmp_path / "draws.png", title="mine")
    for figure, words in zip(figures, ("no effect", "smaller effects or none"), strict=True):
        (axes,) = figure.axes
        assert len(axes.get_yticklabels()) == 5
        assert axes.get_xlabel().endswith(f"\n2 others: {words}")


def test_the_plot_names_ranges_with_their_units_and_cuts_off_no_mark(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **settings: figures.append(self))
    columns = {"parameter": ["command_latency", "foot_friction"], "smallest": [0.012, 0.4]}
    shares = {"low": [0.52, 0.5], "middle": [0.5, 0.5], "high": [0.44, 0.5]}
    table = pd.DataFrame({**columns, "largest": [0.036, 1.2], **shares, "p": [0.001, 0.9]})
    table = table.assign(n_low=900, n_middle=900, n_high=900)
    thirds_plot(table, tmp_path / "draws.png", title="mine")
    (axes,) = figures[0].axes
    texts = [label.get_text().replace("\n", " ") for label in axes.get_yticklabels()]
    assert texts == ["command latency, 0.012 to 0.036 s", "foot friction, 0.4 to 1.2"]
    low, high = axes.get_xlim()
    assert low < 44 - 3  # Wilson's interval goes on for 3.2 %
    assert high > 52 + 3


def test_without_draws_there_is_no_plot(tmp_path):
    table = pd.DataFrame({"impulse": [0.1], "recovered": [True]})
    assert Draws.figures(table, tmp_path, "mine") == []
    assert list(tmp_path.iterdir()) == []
