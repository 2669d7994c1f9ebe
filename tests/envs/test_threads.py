import pytest
import torch

from zfall.envs.threads import physics_first


def test_torch_gets_its_threads_back_even_after_an_error():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with pytest.raises(RuntimeError, match="had 1 thread"), physics_first():
            raise RuntimeError(f"had {torch.get_num_threads()} thread")
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
