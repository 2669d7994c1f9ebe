"""Random numbers of one's own, which a training does not notice."""

from contextlib import AbstractContextManager

import torch


def own_draws() -> AbstractContextManager[None]:
    """What is drawn inside changes no later draw, on the CPU and on the GPU in use."""
    gpus = [torch.cuda.current_device()] if torch.cuda.is_initialized() else []
    return torch.random.fork_rng(devices=gpus)
