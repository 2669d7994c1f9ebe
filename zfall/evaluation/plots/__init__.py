"""Figures of batteries and of training, for a screen and for a two-column paper."""

import logging

import matplotlib as mpl

mpl.use("Agg")
logging.getLogger("fontTools").setLevel(logging.WARNING)  # tells of every font in a pdf
mpl.rcParams |= {"pdf.fonttype": 42, "ps.fonttype": 42}  # fonts that journals take

from zfall.evaluation.plots.curves import learning_bands, learning_curves  # noqa: E402
from zfall.evaluation.plots.envelope import envelope_plot  # noqa: E402
from zfall.evaluation.plots.fits import fit_plot  # noqa: E402
from zfall.evaluation.plots.heat import withstood_map  # noqa: E402
from zfall.evaluation.plots.polar import overlay, success_map  # noqa: E402
from zfall.evaluation.plots.profiles import profiles_plot  # noqa: E402
from zfall.evaluation.plots.thirds import thirds_plot  # noqa: E402
from zfall.evaluation.plots.traces import trace_plot  # noqa: E402

__all__ = [
    "envelope_plot",
    "fit_plot",
    "learning_bands",
    "learning_curves",
    "overlay",
    "profiles_plot",
    "success_map",
    "thirds_plot",
    "trace_plot",
    "withstood_map",
]
