"""What passes between the worlds, on the CPU, and networks that may be on a GPU."""

import copy
import os
from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn


class Transfers:
    """Copies of what networks read to their device, and of what they write back.

    A batch goes through pinned memory, all of its tensors at once, and the CPU goes on meanwhile.
    On the CPU nothing is copied.

    Args:
        device: of networks and learning: ``cpu``, ``cuda`` or ``cuda:NUMBER``. Of several processes
            of a machine each takes another ``cuda``.
        copies: whether tensors are copied; ``None``: unless the device is the CPU.

    Raises:
        ValueError: if torch does not find the device.
    """

    def __init__(self, device: str, copies: bool | None = None):
        found = torch.cuda.device_count() if device.startswith("cuda") else 0
        if device.startswith("cuda") and int(device.partition(":")[2] or 0) >= found:
            raise ValueError(
                f"device must be cpu, or one of {found} GPUs that torch finds here, got {device}."
            )
        if device == "cuda":
            if found < (here := int(os.environ.get("LOCAL_WORLD_SIZE", "1"))):
                raise ValueError(
                    f"launch.ranks must have a GPU each, there are {here} on this machine and "
                    f"{found} GPUs."
                )
            device = f"cuda:{os.environ.get('LOCAL_RANK', '0')}"
        self.device = torch.device(device)
        self._pins = self.device.type == "cuda"
        self._copies = self.device.type != "cpu" if copies is None else copies
        if self._pins:
            torch.cuda.set_device(self.device)

    def place(self, modules: Iterable[Any]) -> None:
        """Moves networks and losses, those of them that are modules, to the device."""
        for module in modules:
            if self._copies and isinstance(module, nn.Module):
                module.to(self.device)

    def there(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A few tensors that networks read in a step, on the device."""
        if not self._copies:
            return tensordict
        return tensordict.to(self.device, non_blocking=self._pins)

    def batch_there(self, batch: TensorDictBase) -> TensorDictBase:
        """A whole batch on the device, through pinned memory."""
        if not self._copies:
            return batch
        return batch.to(self.device, non_blocking_pin=self._pins)

    def back(self, tensordict: TensorDictBase) -> TensorDictBase:
        """What networks wrote, on the CPU."""
        return tensordict.to("cpu") if self._copies else tensordict

    def figures_back(self, figures: dict[str, Tensor]) -> dict[str, Tensor]:
        """Numbers ``()`` by name, in one transfer."""
        if not self._copies:
            return figures
        values = torch.stack([value.float() for value in figures.values()]).cpu()
        return dict(zip(figures, values.unbind(), strict=True))

    def module_back(self, module: nn.Module) -> nn.Module:
        """A network to be run on the CPU; a copy if it is elsewhere."""
        return copy.deepcopy(module).to("cpu") if self._copies else module

    def state_dict(self) -> dict[str, Tensor]:
        """State of the device's own random generator."""
        return {"rng_device": torch.cuda.get_rng_state(self.device)} if self._pins else {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state_dict`` gave; of another device nothing goes on."""
        if self._pins and "rng_device" in state:
            torch.cuda.set_rng_state(state["rng_device"], self.device)
