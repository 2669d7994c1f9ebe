import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.modules import set_recurrent_mode

from zfall.modules.gru import StackedGRU

SIZE, LAYERS, ROWS, STEPS = 5, 3, 6, 9


@pytest.fixture
def module() -> StackedGRU:
    torch.manual_seed(0)
    return StackedGRU(SIZE, LAYERS, "features", "out", "memory").double()


@pytest.fixture
def batch() -> TensorDict:
    """Sequences within which episodes begin, of one row in every step and of another in none."""
    torch.manual_seed(1)
    begins = torch.rand(ROWS, STEPS, 1) < 0.25
    begins[0], begins[1] = True, False
    return TensorDict(
        {
            "features": torch.randn(ROWS, STEPS, SIZE, dtype=torch.float64),
            "memory": torch.randn(ROWS, STEPS, LAYERS, SIZE, dtype=torch.float64),
            "is_init": begins,
        },
        [ROWS, STEPS],
    )


def by_torch(module: StackedGRU, batch: TensorDict) -> tuple[torch.Tensor, ...]:
    """Features, and memories after each step, of ``torch.nn.GRU`` one row and step at a time."""
    outs, afters = [], []
    for row in batch:
        memory = row["memory"][0]
        for step in row:
            if step["is_init"]:
                memory = torch.zeros_like(memory)
            out, memory = module.gru(step["features"][None], memory)
            outs.append(out[0])
            afters.append(memory)
    return tuple(torch.stack(x).unflatten(0, (ROWS, STEPS)) for x in (outs, afters))


def test_sequences_and_their_gradients_are_those_of_torch(module, batch):
    """Gradients by all that comes out: features, and memories of every layer and step."""
    weight = torch.randn(2, ROWS, STEPS, LAYERS, SIZE, dtype=torch.float64)
    results = []
    for ours in (True, False):
        data = batch.clone()
        features = data["features"].requires_grad_()
        if ours:
            with set_recurrent_mode(True):
                out = module(data)
            out, after = out["out"], out["next", "memory"]
        else:
            out, after = by_torch(module, data)
        module.zero_grad()
        (out * weight[0, :, :, 0]).sum().add((after.sin() * weight[1]).sum()).backward()
        gradients = [p.grad.clone() for p in module.parameters()]
        results.append([out, after, features.grad, *gradients])
    for ours, theirs in zip(*results, strict=True):
        assert theirs.abs().max() > 0.1
        assert_close(ours, theirs, atol=1e-12, rtol=1e-12)


def test_sequences_that_name_another_are_seen_with_its_memory(module, batch):
    """One step of ``torch.nn.GRU`` from the memory that the other has there, and all gradients."""
    lenders = [4, 1, 4, 0]  # one twice, one that begins in each step
    seen = torch.randn(len(lenders), STEPS, SIZE, dtype=torch.float64)
    weight = torch.randn(ROWS + len(lenders), STEPS, SIZE, dtype=torch.float64)

    def theirs(seen):
        """Of the batch, then of the others."""
        out, after = by_torch(module, batch)
        before = torch.cat([batch["memory"][:, :1], after[:, :-1]], 1)
        before = torch.where(batch["is_init"][..., None], 0.0, before)[lenders].flatten(0, 1)
        asked, _ = module.gru(seen.reshape(-1, 1, SIZE), before.transpose(0, 1).contiguous())
        return torch.cat([out, asked.view(seen.shape)])

    def ours(seen):
        more = batch[lenders].set("features", seen)  # of whose own memories nothing is to be seen
        more["memory"], more["is_init"] = torch.randn_like(more["memory"]), ~more["is_init"]
        more["memory_of"] = torch.tensor(lenders)[:, None].expand(-1, STEPS)
        own = batch.copy().set("memory_of", torch.full(batch.shape, -1))
        with set_recurrent_mode(True):
            return module(torch.cat([own, more]))["out"]

    results = []
    for function in (ours, theirs):
        module.zero_grad()
        batch["features"] = batch["features"].detach().clone().requires_grad_()
        given = seen.clone().requires_grad_()
        out = function(given)
        (out * weight).sum().backward()
        gradients = [p.grad.clone() for p in module.parameters()]
        results.append([out, given.grad, batch["features"].grad, *gradients])
    for found, expected in zip(*results, strict=True):
        assert expected.abs().max() > 0.05
        assert_close(found, expected, atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize(
    "named", [[-1, -1, -1, -1, -1, 5], [-1, -1, -1, 1, -1, -1], [-1, -1, -1, -1, -1, 9]]
)
def test_a_memory_that_nobody_has_is_refused(module, batch, named):
    """One's own, borrowed in the midst, and one that is not there; or another at each step."""
    batch["memory_of"] = torch.tensor(named)[:, None].expand(batch.shape)
    with set_recurrent_mode(True), pytest.raises(ValueError, match="memory_of must be the same"):
        module(batch)
    batch["memory_of"] = torch.full(batch.shape, -1)
    batch["memory_of"][-1] = torch.arange(STEPS) % 2
    with set_recurrent_mode(True), pytest.raises(ValueError, match="memory_of must be the same"):
        module(batch)


@pytest.mark.parametrize("shape", [(STEPS,), (2, 3, STEPS)])
def test_any_number_of_axes_in_front_of_time(module, batch, shape):
    rows = batch[1:2] if len(shape) == 1 else batch
    with set_recurrent_mode(True):
        expected = module(rows.clone())
        out = module(rows.reshape(shape))
    for key, size in (("out", (SIZE,)), (("next", "memory"), (LAYERS, SIZE))):
        assert out[key].shape == (*shape, *size)
        assert_close(out[key].reshape(-1, STEPS, *size), expected[key])


def test_steps_follow_sequences(module, batch):
    """One step after the other, as when data are collected, whatever is stored at beginnings."""
    with set_recurrent_mode(True):
        expected = module(batch.clone())
    memory = batch["memory"][:, 0]
    for step in range(STEPS):
        now = batch[:, step].set("memory", memory)
        with set_recurrent_mode(False):
            now = module(now)
        memory = now["next", "memory"]
        assert_close(now["out"], expected["out"][:, step])
        assert_close(memory, expected["next", "memory"][:, step])


@pytest.mark.parametrize("shape", [(), (ROWS,), (2, 3)])
def test_one_step_is_that_of_torch(module, batch, shape):
    """From the memory given, or from 0 where an episode begins; other keys are left alone."""
    step = batch[:, 4].clone()
    step["is_init"] = torch.arange(ROWS)[:, None] % 2 == 0
    step["other"] = torch.arange(ROWS)
    step = step[3] if shape == () else step.reshape(shape)
    out = module(step.clone())
    assert set(out.keys(True, True)) == {*step.keys(), "out", ("next", "memory")}
    assert torch.equal(out["other"], step["other"])
    for row, given in zip(out.reshape(-1), step.reshape(-1), strict=True):
        memory = torch.zeros_like(given["memory"]) if given["is_init"] else given["memory"]
        expected, after = module.gru(given["features"][None], memory)
        assert_close(row["out"], expected[0])
        assert_close(row["next", "memory"], after)
