"""Figures of a trigger show what its table says, and cover nothing."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from zfall.falling.plots import reliability_plot, reliability_table, trigger_plot


@pytest.fixture
def drawn(monkeypatch) -> list[Figure]:
    """Figures that are drawn and written."""
    figures: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, *a, **k: figures.append(self) or save(self, *a, **k)
    )
    return figures


def covered(figure: Figure) -> bool:
    """Whether its legend lies over its axes or beyond its edge."""
    (legend,), (axes,) = figure.legends, figure.axes
    box = legend.get_window_extent()
    return box.overlaps(axes.get_tightbbox()) or box.x0 < 0 or box.x1 > figure.bbox.x1


def test_rules_differ_by_how_long_they_hold_in_marks_and_colours(drawn, tmp_path):
    rows = [("network", p, 1.0, 0.2, share) for p, share in (("0.9", 0.1), ("0.5", 0.5))]
    rows += [
        ("rule", f"{a} rad, 2 rad/s, {hold} s", a + hold, 0.1, 0.3)
        for hold in (0.04, 0.2)
        for a in (0.3, 0.5)
    ]
    columns = ("trigger", "setting", "detected", "lead_s", "false_alarms")
    trigger_plot(pd.DataFrame(rows, columns=columns), tmp_path / "trigger.png")
    (figure,) = drawn
    network, *rules = figure.axes[0].lines
    assert np.asarray(network.get_xdata()) == pytest.approx([10.0, 50.0])  # sorted, in percent
    assert network.get_label() == "network, detects 100 % of the falls"
    assert [line.get_label() for line in rules] == [
        "rule, for 0.04 s, detects 34 to 54 % of the falls",
        "rule, for 0.2 s, detects 50 to 70 % of the falls",
    ]
    assert [text.get_text() for text in figure.axes[0].texts] == ["p > 0.9", "p > 0.5"]
    assert figure.axes[0].get_ylim()[0] == figure.axes[0].get_xlim()[0] == 0.0
    lines = [network, *rules]
    assert len({line.get_color() for line in lines}) == len({x.get_marker() for x in lines}) == 3
    assert not covered(figure)


def test_a_calibrated_prediction_lies_on_the_diagonal(drawn, tmp_path):
    """Of predictions of 0.25 a quarter falls, of 0.75 three quarters."""
    probability = np.repeat(np.float32([0.25, 0.75]), 40)
    truth = np.tile(np.float32([1, 0, 0, 0]), 10), np.tile(np.float32([1, 1, 1, 0]), 10)
    table = reliability_table(probability, np.concatenate(truth))
    assert table["steps"].tolist() == [40, 40]
    reliability_plot(table, tmp_path / "r.png")
    (figure,) = drawn
    assert [text.get_text() for text in figure.axes[0].texts] == ["40", "40"]
    _, line = figure.axes[0].lines
    assert np.asarray(line.get_xydata()) == pytest.approx(np.array([[0.25] * 2, [0.75] * 2]))
    assert figure.axes[0].get_aspect() == 1.0
    assert not covered(figure)
