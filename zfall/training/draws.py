"""Random numbers of many rows, of which a process keeps its own.

What a policy or a loss draws for rows of a batch comes from torch's global generator, in the order
of the rows. Each of several ranks has some of them. It draws the numbers of all and keeps those of
its own rows: the ranks' generators stay in step, and a row gets the same numbers on any of them.

A mode of torch does it, so that networks and losses draw as ever. It costs about a microsecond for
each call of torch within it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

_REFUSED = {
    *(torch.bernoulli, torch.multinomial, torch.poisson, torch.randint, torch.randint_like),
    *(torch.randperm, torch.nn.functional.dropout, torch.dropout),
    *(torch.Tensor.bernoulli_, torch.Tensor.exponential_, torch.Tensor.random_),
    *(torch.Tensor.geometric_, torch.Tensor.log_normal_, torch.Tensor.cauchy_),
    *(torch.Tensor.bernoulli, torch.Tensor.multinomial),
}


class Draw(NamedTuple):
    """Numbers that a row gets: how they are drawn, and the shape of all but the rows' axis.

    Attributes:
        method: of a tensor that fills it, ``normal_`` or ``uniform_``.
        values: its arguments.
        shape: of what is drawn, with 1 in the place of the rows.
        order: of its axes in memory, the slowest first.
        axis: of the rows.
        dtype, device: of the numbers.
    """

    method: str
    values: tuple[Any, ...]
    shape: tuple[int, ...]
    order: tuple[int, ...]
    axis: int
    dtype: torch.dtype
    device: torch.device

    def of(self, rows: int) -> Tensor:
        """The numbers of so many rows."""
        shape = [rows if axis == self.axis else size for axis, size in enumerate(self.shape)]
        laid = torch.empty(
            [shape[axis] for axis in self.order], dtype=self.dtype, device=self.device
        )
        back = sorted(range(len(self.order)), key=self.order.__getitem__)
        return getattr(laid.permute(back), self.method)(*self.values)


class DrawnTogether(TorchFunctionMode):
    """Within it draws for so many rows are made by a function.

    Args:
        rows: at hand, the length of one of the first two axes of what is drawn for them.
        supply: gives the numbers of these rows for a draw.

    Raises:
        ValueError: at its end, if torch's global generator of the CPU has moved by anything else.
    """

    def __init__(self, rows: int, supply: Callable[[Draw], Tensor]):
        super().__init__()
        self.rows, self.supply = rows, supply
        self._state = torch.get_rng_state()

    def __exit__(self, kind: Any, value: Any, traceback: Any) -> None:
        super().__exit__(kind, value, traceback)
        if kind is None:
            self._check_unmoved()

    def _check_unmoved(self) -> None:
        if not torch.equal(self._state, torch.get_rng_state()):
            raise ValueError(
                "launch.ranks must be 1 for a policy or loss whose draws are not for the rows at "
                "hand, each its own, by randn, rand, randn_like, rand_like, normal_, uniform_ or "
                "normal(mean, std) of tensors."
            )

    def __torch_function__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        maker = _MAKERS.get(func)
        if maker is not None:
            return maker(self, func, *args, **kwargs)
        if func in _REFUSED:
            raise ValueError(
                "launch.ranks must be 1 for a policy or loss that draws other than normal and "
                f"uniform numbers, this one calls torch's {func.__name__}."
            )
        return func(*args, **kwargs)

    def numbers(self, like: Tensor, method: str, *values: Any) -> Tensor | None:
        """Numbers in the shape of a tensor; ``None`` if it has no axis of the rows."""
        axis = next((i for i, size in enumerate(like.shape[:2]) if size == self.rows), None)
        if axis is None:
            return None
        shape = tuple(1 if i == axis else size for i, size in enumerate(like.shape))
        order = tuple(sorted(range(like.dim()), key=lambda i: (-like.stride()[i], i)))
        self._check_unmoved()
        drawn = self.supply(Draw(method, values, shape, order, axis, like.dtype, like.device))
        self._state = torch.get_rng_state()
        return drawn


def _like(method: str) -> Callable[..., Any]:
    def make(mode: DrawnTogether, func: Any, like: Tensor, **kwargs: Any) -> Any:
        drawn = None if kwargs else mode.numbers(like, method)
        return func(like, **kwargs) if drawn is None else drawn

    return make


def _sized(method: str) -> Callable[..., Any]:
    def make(mode: DrawnTogether, func: Any, *size: Any, **kwargs: Any) -> Any:
        known = kwargs.keys() <= {"dtype", "device", "size"}
        if not known:
            return func(*size, **kwargs)
        shape = kwargs.get("size", size)
        shape = shape[0] if len(shape) == 1 and not isinstance(shape[0], int) else shape
        kinds = {key: value for key, value in kwargs.items() if key != "size"}
        drawn = mode.numbers(torch.empty(tuple(shape), **kinds), method)
        return func(*size, **kwargs) if drawn is None else drawn

    return make


def _in_place(method: str) -> Callable[..., Any]:
    def make(mode: DrawnTogether, func: Any, filled: Tensor, *values: Any, **kwargs: Any) -> Any:
        drawn = None if kwargs else mode.numbers(filled, method, *values)
        return func(filled, *values, **kwargs) if drawn is None else filled.copy_(drawn)

    return make


def _normal(
    mode: DrawnTogether, func: Any, mean: Any, std: Any = 1.0, *rest: Any, **kw: Any
) -> Any:
    """``torch.normal``: of tensors as torch computes it, from numbers of N(0, 1)."""
    plain = isinstance(mean, Tensor) and isinstance(std, Tensor) and not rest and not kw
    if plain:
        shape = torch.broadcast_shapes(mean.shape, std.shape)
        drawn = mode.numbers(mean.new_empty(shape), "normal_")
        if drawn is not None:
            return drawn.mul_(std).add_(mean)
    return func(mean, std, *rest, **kw)


_MAKERS: dict[Any, Callable[..., Any]] = {
    torch.randn_like: _like("normal_"),
    torch.rand_like: _like("uniform_"),
    torch.randn: _sized("normal_"),
    torch.rand: _sized("uniform_"),
    torch.Tensor.normal_: _in_place("normal_"),
    torch.Tensor.uniform_: _in_place("uniform_"),
    torch.normal: _normal,
}
