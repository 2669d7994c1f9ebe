"""Trains and calibrates a ``FallNetwork``."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from zfall.falling.fall_network import FallNetwork
from zfall.falling.trigger.history import History, labels

_BATCH = 128  # trials


def fit(
    history: History,
    measured: Sequence[str],
    control_dt: float,
    *,
    hidden_size: int = 32,
    epochs: int = 40,
    progress: Callable[[int, float], None] = lambda epoch, loss: None,
) -> FallNetwork:
    """Trains on all steps before the first touch, with the binary cross entropy to ``labels``.

    Args:
        history: trials.
        measured: names of what was measured in them, in order.
        control_dt: of the trials [s].
        hidden_size: of the network's GRU.
        epochs: over the trials, with Adam at 3e-3.
        progress: is given the number of epochs done and the mean loss of the last.
    """
    network = FallNetwork(history.measured.shape[-1], hidden_size)
    network.trained_with = {"keys": list(measured), "control_dt": control_dt}
    network.normalizer.update(history.measured[history.live])
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    truth = labels(history)
    for epoch in range(epochs):
        total = 0.0
        for rows in torch.randperm(len(truth)).split(_BATCH):
            logits, _ = network.logits(history.measured[rows])
            live = history.live[rows]
            loss = binary_cross_entropy_with_logits(logits[live], truth[rows][live])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item() * len(rows)
        progress(epoch + 1, total / len(truth))
    return network.eval()


def calibrate(network: FallNetwork, history: History) -> None:
    """Fits slope and offset of the logits on trials that the network has not learned from.

    Source: Platt, "Probabilistic outputs for support vector machines", 1999, eq. 1: the targets
    are not 0 and 1, but fall short of them by as much as so few trials leave open.
    """
    with torch.no_grad():
        logits = network.logits(history.measured)[0][history.live]
    truth = labels(history)[history.live]
    ones = truth.sum()
    truth = torch.where(truth > 0, (ones + 1) / (ones + 2), 1 / (len(truth) - ones + 2))
    scale = torch.tensor([1.0, 0.0], requires_grad=True)
    optimizer = torch.optim.LBFGS([scale], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        value = binary_cross_entropy_with_logits(scale[0] * logits + scale[1], truth)
        value.backward()
        return value

    optimizer.step(loss)
    network.slope.copy_(scale[0].detach())
    network.offset.copy_(scale[1].detach())


@torch.no_grad()
def probabilities(network: FallNetwork, history: History) -> Tensor:
    """Calibrated probability at every step ``(K, T)``."""
    logits, _ = network.logits(history.measured)
    return torch.sigmoid(network.slope * logits + network.offset)
